"""Writes a rendered film as a ROS 1 bag or a ROS 2 recording with rosbags."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rendered import Film
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

IMAGE, COMPRESSED, INFO = (f"sensor_msgs/msg/{name}" for name in ("Image", "CompressedImage", "CameraInfo"))
START = 1_700_000_000  # s; recordings have the time of day
Encode = Callable[["Messages", int, np.ndarray], tuple[str, Any]]  # message type and message of an image


class Messages:
    """Builds messages of either ROS."""

    def __init__(self, version: int) -> None:
        self.version = version
        self.store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)

    def header(self, nanoseconds: int, frame_id: str) -> Any:
        types = self.store.types
        time = types["builtin_interfaces/msg/Time"](nanoseconds // 10**9, nanoseconds % 10**9)
        number = {"seq": 0} if self.version == 1 else {}
        return types["std_msgs/msg/Header"](stamp=time, frame_id=frame_id, **number)

    def raw(self, stamp: int, image: np.ndarray, encoding: str, padding: int = 0, big: bool = False) -> tuple[str, Any]:
        rows = image.astype(image.dtype.newbyteorder(">")) if big else image
        data = rows.reshape(len(image), -1).view(np.uint8)
        data = np.pad(data, ((0, 0), (0, padding)))
        message = self.store.types[IMAGE](
            self.header(stamp, "camera"), *image.shape[:2], encoding, int(big), data.shape[1], data.ravel()
        )
        return IMAGE, message

    def compressed(self, stamp: int, data: bytes, format: str) -> tuple[str, Any]:
        array = np.frombuffer(data, np.uint8)
        return COMPRESSED, self.store.types[COMPRESSED](self.header(stamp, "camera"), format, array)

    def info(self, stamp: int, film: Film) -> tuple[str, Any]:
        c = film.frames[0].camera
        K = np.array([c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1])
        P = np.array([c.fx, 0, c.cx, 0, 0, c.fy, c.cy, 0, 0, 0, 1, 0])
        roi = self.store.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        message = self.store.types[INFO](
            *(self.header(stamp, "camera"), c.height, c.width, "plumb_bob"),
            *(np.zeros(5), K, np.eye(3).ravel(), P, 0, 0, roi),
        )
        return INFO, message

    def bytes(self, kind: str, message: Any) -> Any:
        write = self.store.serialize_ros1 if self.version == 1 else self.store.serialize_cdr
        return write(message, kind)


def rgb8(messages: Messages, stamp: int, image: np.ndarray) -> tuple[str, Any]:
    return messages.raw(stamp, image, "rgb8")


def metres(messages: Messages, stamp: int, depth: np.ndarray) -> tuple[str, Any]:
    """32FC1, as TUM's own bags have it."""
    return messages.raw(stamp, depth, "32FC1")


def millimetres(messages: Messages, stamp: int, depth: np.ndarray) -> tuple[str, Any]:
    return messages.raw(stamp, np.round(1000 * depth).astype(np.uint16), "16UC1")


def png(messages: Messages, stamp: int, image: np.ndarray) -> tuple[str, Any]:
    data = cv2.imencode(".png", np.ascontiguousarray(image[..., ::-1]))[1].tobytes()
    return messages.compressed(stamp, data, "rgb8; png compressed bgr8")


def compressed_depth(messages: Messages, stamp: int, depth: np.ndarray) -> tuple[str, Any]:
    data = cv2.imencode(".png", np.round(1000 * depth).astype(np.uint16))[1].tobytes()
    return messages.compressed(stamp, bytes(12) + data, "16UC1; compressedDepth png")


def write_bag(
    film: Film,
    path: Path,
    version: int = 1,
    plugin: StoragePlugin = StoragePlugin.MCAP,
    color: Encode = rgb8,
    depth: Encode = metres,
    topics: tuple[str, str] = ("/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw"),
    delay_s: float = 0.004,
    burst: bool = False,
    prepare: Callable[[Any], object] = id,
) -> Path:
    """The film as a recording at `path`; depth comes delay_s later and is recorded before its colour image.

    burst: everything was recorded at one time, as on a machine that was busy. prepare: what is done with the writer
    before it opens its file.
    """
    messages = Messages(version)
    writer = Writer1(path) if version == 1 else Writer2(path, version=9, storage_plugin=plugin)
    prepare(writer)
    with writer:
        connections: dict[str, Any] = {}

        def add(topic: str, at: int, made: tuple[str, Any]) -> None:
            kind, message = made
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=messages.store)
            writer.write(connections[topic], START * 10**9 if burst else at, messages.bytes(kind, message))

        for frame in film.frames:
            stamp = START * 10**9 + round(frame.timestamp * 1e6) * 1000
            assert frame.color is not None
            later = stamp + round(delay_s * 1e9)
            add(
                topics[0].removesuffix("/compressed").rsplit("/", 1)[0] + "/camera_info",
                stamp,
                messages.info(stamp, film),
            )
            add(topics[1], stamp + 20_000_000, depth(messages, later, frame.depth.numpy()))
            add(topics[0], stamp + 30_000_000, color(messages, stamp, frame.color.numpy()))
    return path
