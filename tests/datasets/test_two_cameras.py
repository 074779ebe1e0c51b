"""Recordings with several cameras or several forms of an image: colour and depth of one camera, or a question."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from bag_writer import COMPRESSED, IMAGE, INFO, Messages
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2

from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.datasets.ros_topics import Topic, choose_topics
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.frame import RgbdFrame


def chosen(names: str, color: str | None = None, depth: str | None = None, **frames: str) -> tuple[str, str, int]:
    topics = [Topic(name, not name.endswith(("compressed", "Depth")), True, None) for name in names.split()]
    a, b, warnings = choose_topics(topics, color, depth, lambda topic: frames.get(topic.camera[0], ""), "bag")
    return a.name, b.name, len(warnings)


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        ("/camera/color/image_raw /camera/aligned_depth_to_color/image_raw", (0, 1, 0)),
        ("/camera/camera/depth/image_rect_raw /camera/camera/color/image_raw", (1, 0, 0)),
        ("/camera/depth/image_raw /camera/rgb/image_color /camera/depth_registered/image_raw", (1, 2, 0)),
        ("/rgb/image_raw /depth/image_raw /depth_to_rgb/image_raw", (0, 2, 0)),
        ("/k4a/rgb/image_raw /k4a/rgb_to_depth/image_raw /k4a/depth/image_raw", (1, 2, 0)),
        ("/left/image_mono /stereo/depth", (0, 1, 0)),
        ("/zed/zed_node/right/image_rect_color /zed/zed_node/rgb/image_rect_color /zed/zed_node/depth/depth_registered",
         (1, 2, 0)),
        ("/left/color/image_raw /right/aligned_depth_to_color/image_raw /right/color/image_raw", (2, 1, 0)),
        ("/cam2/color/image_raw /cam1/aligned_depth_to_color/image_raw /cam1/color/image_raw"
         " /cam2/aligned_depth_to_color/image_raw", (2, 1, 1)),
        ("/front_color /back_depth /back_color /front_depth", (2, 1, 1)),
        ("/left/color/image_raw /left/depth/image_rect_raw /right/color/image_raw"
         " /right/aligned_depth_to_color/image_raw", (2, 3, 1)),
        ("/camera/color/image_raw/compressed /camera/aligned_depth_to_color/image_raw/compressedDepth", (0, 1, 0)),
        ("/usb_cam/image_raw /camera/color/image_raw /camera/aligned_depth_to_color/image_raw", (1, 2, 0)),
    ],
)  # fmt: skip
def test_colour_and_depth_are_of_one_camera(names: str, expected: tuple[int, int, int]) -> None:
    split = names.split()
    assert chosen(names) == (split[expected[0]], split[expected[1]], expected[2])


def test_the_camera_of_the_topic_that_the_user_names() -> None:
    both = " ".join(f"/{side}/{kind}/image_raw" for side in ("left", "right") for kind in ("color", "depth_registered"))
    assert chosen(both, color="/right/color/image_raw")[:2] == (
        "/right/color/image_raw",
        "/right/depth_registered/image_raw",
    )
    assert chosen(both, depth="/right/depth_registered/image_raw")[0] == "/right/color/image_raw"
    mixed = chosen(both, "/right/color/image_raw", "/left/depth_registered/image_raw")
    assert mixed == ("/right/color/image_raw", "/left/depth_registered/image_raw", 0)  # as the user says


LONELY = "/left/color/image_raw /right/color/image_raw /right/depth/image_raw"
NEITHER = "/one/image_raw /two/image_raw /stereo_pair/depth"


def test_what_cannot_be_told_is_asked_with_a_list() -> None:
    with pytest.raises(IdRgbdoError, match=r"of one camera: colour /left.*; depth /right/depth/image_raw; name one"):
        chosen(LONELY, color="/left/color/image_raw")
    with pytest.raises(IdRgbdoError, match=r"colour /one/image_raw, /two/image_raw; depth /stereo_pair/depth"):
        chosen(NEITHER)
    assert chosen(NEITHER, two="optical", pair="optical", one="elsewhere")[0] == "/two/image_raw"
    with pytest.raises(IdRgbdoError, match="of one camera"):
        chosen(NEITHER, two="camera", pair="camera", one="camera")  # two drivers with the same default names


def camera_info(messages: Messages, fx: float, D: list[float], model: str, size: tuple[int, int]) -> Any:
    K = np.array([fx, 0, size[0] / 2, 0, fx, size[1] / 2, 0, 0, 1.0])
    P = np.array([fx, 0, size[0] / 2, 0, 0, fx, size[1] / 2, 0, 0, 0, 1.0, 0])
    roi = messages.store.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    header = messages.header(10**18, "camera")
    return messages.store.types[INFO](
        header, size[1], size[0], model, np.array(D, float), K, np.eye(3).ravel(), P, 0, 0, roi
    )


def write(path: Path, version: int, topics: dict[str, list[tuple[str, Any]]], messages: Messages) -> Path:
    """A recording with these messages (type, message) in these topics."""
    writer = Writer1(path) if version == 1 else Writer2(path, version=9, storage_plugin=StoragePlugin.MCAP)
    with writer as bag:
        for topic, content in topics.items():
            kind = content[0][0] if content else IMAGE
            connection = bag.add_connection(topic, kind, typestore=messages.store)
            for number, (_, message) in enumerate(content):
                bag.write(connection, 10**18 + number * 33_000_000, messages.bytes(kind, message))
    return path


@pytest.mark.parametrize("version", [1, 2])
def test_two_cameras_in_one_recording(tmp_path: Path, version: int) -> None:
    """Each of left and right has its own gray level and depth; the depth topics stand crosswise."""
    messages = Messages(version)
    stamps = [10**18 + k * 33_000_000 for k in range(3)]
    topics: dict[str, list[tuple[str, Any]]] = {}
    for side, value in (("right", 200), ("left", 50)):
        info = (INFO, camera_info(messages, float(value), [], "plumb_bob", (32, 24)))
        color, depth = np.full((24, 32, 3), value, np.uint8), np.full((24, 32), 10 * value, np.uint16)
        other = "left" if side == "right" else "right"
        topics[f"/{other}/color/camera_info"] = [
            (INFO, camera_info(messages, 250.0 - value, [], "plumb_bob", (32, 24)))
        ]
        topics[f"/{side}/color/image_raw"] = [messages.raw(stamp, color, "bgr8") for stamp in stamps]
        topics[f"/{side}/color/camera_info"] = [info]
        topics[f"/{side}/aligned_depth_to_color/image_raw"] = [messages.raw(stamp, depth, "16UC1") for stamp in stamps]
    path = write(tmp_path / ("a.bag" if version == 1 else "a"), version, topics, messages)
    for flags, value in (({}, 50), ({"color_topic": "/right/color/image_raw"}, 200)):
        sequence = open_sequence(path, **flags)
        frame = sequence.read(1)
        assert isinstance(frame, RgbdFrame)
        assert (float(frame.gray[0, 0]), frame.camera.fx) == (value, value)
        assert float(frame.depth[0, 0]) == pytest.approx(value / 100)
        assert len(sequence.warnings) == (0 if flags else 1)


def test_the_form_that_has_images_is_taken(tmp_path: Path) -> None:
    messages = Messages(2)
    color, depth = np.full((24, 32, 3), 90, np.uint8), np.full((24, 32), 1500, np.uint16)
    data = struct.pack("<iff", 0, 0, 0) + cv2.imencode(".png", depth)[1].tobytes()
    raw, png = messages.raw(10**18, color, "bgr8"), messages.compressed(10**18, data, "16UC1; compressedDepth png")
    empty = messages.compressed(10**18, b"", "16UC1; jpeg compressed mono8")
    info = (INFO, camera_info(messages, 30.0, [], "plumb_bob", (32, 24)))
    base = "/camera/aligned_depth_to_color/image_raw"
    forms = {"/camera/color/image_raw": [raw], "/camera/color/camera_info": [info], base: []}
    path = write(
        tmp_path / "a", 2, {**forms, f"{base}/compressed": [empty], f"{base}/compressedDepth": [png]}, messages
    )
    sequence = open_sequence(path)
    assert f"{base}/compressedDepth" in sequence.recognised
    frame = sequence.read(0)
    assert isinstance(frame, RgbdFrame)
    assert float(frame.depth[0, 0]) == 1.5
    only = write(tmp_path / "b", 2, {**forms, f"{base}/compressed": [empty]}, messages)
    with pytest.raises(IdRgbdoError, match=rf"the messages of {base}, {base}/compressed are empty"):
        open_sequence(only)
    assert empty[0] == COMPRESSED


def test_depth_of_other_intrinsics_is_not_registered(tmp_path: Path) -> None:
    messages = Messages(1)
    color, depth = np.full((24, 32, 3), 90, np.uint8), np.full((24, 32), 1500, np.uint16)
    topics = {
        "/camera/color/image_raw": [messages.raw(10**18, color, "bgr8")],
        "/camera/color/camera_info": [(INFO, camera_info(messages, 30.0, [], "plumb_bob", (32, 24)))],
        "/camera/depth/image_raw": [messages.raw(10**18, depth, "16UC1")],
        "/camera/depth/camera_info": [(INFO, camera_info(messages, 22.0, [], "plumb_bob", (32, 24)))],
    }
    (warning,) = open_sequence(write(tmp_path / "a.bag", 1, topics, messages)).warnings
    assert "depth says fx=22.0, cx=16.0, colour's fx=30.0, cx=16.0: if depth is not registered" in warning


RATIONAL = [0.78, -2.98, 0.00075, 0.00006, 1.70, 0.657, -2.81, 1.63]  # of an Azure Kinect


PLUMB_BOB = [0.05, -0.02, 0.001, 0.0005, 0.01]


@pytest.mark.parametrize("D", [RATIONAL, PLUMB_BOB, PLUMB_BOB[:4], [], [0.0] * 12, [*RATIONAL, 0.0, 0.0, 0.0, 0.0]])
def test_up_to_eight_distortion_coefficients_of_a_camera_info_count(tmp_path: Path, D: list[float]) -> None:
    """A pattern, distorted by OpenCV's own model, becomes the pattern that the pinhole sees."""
    messages = Messages(1)
    size = (160, 120)
    K = np.array([[131.0, 0, 80], [0, 131.0, 60], [0, 0, 1]])
    v, u = np.indices((120, 160), np.float32)
    seen = cv2.undistortPoints(np.stack([u, v], -1).reshape(-1, 1, 2), K, np.array(D), None, K) if D else None
    x, y = (u, v) if seen is None else (seen[:, 0, 0].reshape(120, 160), seen[:, 0, 1].reshape(120, 160))
    pattern = [128 + 60 * np.sin(a / 7) + 50 * np.cos(b / 9) for a, b in ((x, y), (u, v))]
    color = np.dstack([np.round(pattern[0]).astype(np.uint8)] * 3)
    topics = {
        "/rgb/image_raw": [messages.raw(10**18, color, "bgr8")],
        "/rgb/camera_info": [(INFO, camera_info(messages, 131.0, D, "rational_polynomial", size))],
        "/depth_to_rgb/image_raw": [messages.raw(10**18, np.full((120, 160), 1500, np.uint16), "16UC1")],
    }
    frame = open_sequence(write(tmp_path / "a.bag", 1, topics, messages)).read(0)
    assert isinstance(frame, RgbdFrame)
    inner = np.s_[12:-12, 12:-12]
    assert np.abs(frame.gray.numpy() - pattern[1])[inner].max() < 2.5


def test_more_than_eight_coefficients_and_other_lenses_are_refused(tmp_path: Path) -> None:
    messages = Messages(1)
    color, depth = np.full((24, 32, 3), 90, np.uint8), np.full((24, 32), 1500, np.uint16)
    for name, D, model in (("a", [*RATIONAL, 0.1, 0, 0, 0], "rational_polynomial"), ("b", [0.1] * 4, "equidistant")):
        topics = {
            "/rgb/image_raw": [messages.raw(10**18, color, "bgr8")],
            "/rgb/camera_info": [(INFO, camera_info(messages, 30.0, D, model, (32, 24)))],
            "/depth/image_raw": [messages.raw(10**18, depth, "16UC1")],
        }
        with pytest.raises(IdRgbdoError, match=rf"up to 8 coefficients, got {model} of {len(D)}"):
            open_sequence(write(tmp_path / f"{name}.bag", 1, topics, messages))
