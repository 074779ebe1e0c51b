"""nav_msgs/Odometry, nav_msgs/Path and /tf as a ROS 1 bag or a ROS 2 recording, written with rosbags; no ROS needed."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ..datasets.bag_files import damage
from ..errors import IdRgbdoError
from ..text.files import is_plain_file
from ..trajectory import quaternion_from_rotation
from .axes import R_BODY_OPTICAL, Axes, Motion, in_axes, motion_of
from .tracked import TrackedRun

Array = NDArray[np.float64]

ODOMETRY, PATH, TF = "nav_msgs/msg/Odometry", "nav_msgs/msg/Path", "tf2_msgs/msg/TFMessage"
STAMPED, TRANSFORM = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TransformStamped"
TF_DEFINITION = "geometry_msgs/TransformStamped[] transforms"


@dataclass(frozen=True)
class Names:
    """Of frames and topics."""

    axes: Axes = "optical"
    world: str = "odom"
    child: str = ""  # base_link for a body, else camera_optical_frame
    camera: str = "camera_optical_frame"  # for a body: where the images are, also given in /tf
    odometry: str = "/odom"
    path: str = "/path"

    @property
    def moving(self) -> str:
        """The frame whose pose is given."""
        return self.child or ("base_link" if self.axes == "body" else self.camera)


def write_bag(
    path: Path, version: int, run: TrackedRun, frames: Sequence[int], believed: Collection[int], names: Names
) -> None:
    """Write the frames' poses. A path that ends in .mcap becomes that one file, any other of ROS 2 a folder.

    version: 1 or 2, of ROS. believed: frames that a velocity may begin at. What was written there before is replaced.
    Raises IdRgbdoError as check_place, or where the recording cannot be written.
    """
    check_place(path, names)
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent) as part:
            whole = Path(part) / path.name
            made: Any = Writer1(whole) if version == 1 else Writer2(whole, version=9, storage_plugin=StoragePlugin.MCAP)
            with made as writer:
                _fill(writer, _Messages(version), run, frames, believed, names)
            if version == 2 and path.suffix == ".mcap":
                whole = next(whole.glob("*.mcap"))
            if path.is_dir():
                shutil.rmtree(path)
            whole.replace(path)
    except OSError as error:
        raise IdRgbdoError(f"out: cannot write '{path}': {error.strerror}; pass another --out") from error


def check_place(path: Path, names: Names | None = None, option: str = "out") -> None:
    """Find out, before any work is done, whether write_bag may write there.

    option: by which the path was given. Raises IdRgbdoError without rosbags, and where something lies that write_bag
    did not write: a recording of a camera, say.
    """
    try:
        import rosbags.rosbag1
        import rosbags.rosbag2  # noqa: F401
    except ImportError as error:
        raise IdRgbdoError(
            f'{path}: writing ROS recordings needs rosbags ({error}); run `pip install "idrgbdo_torch[ros]"`'
        ) from error
    if os.path.lexists(path) and not _is_own(path, names or Names()):
        flag = option.replace("_", "-")
        raise IdRgbdoError(
            f"{option}: expected a new path, or poses that were written before, got '{path}' with something else; "
            f"pass another --{flag}"
        )


def _is_own(path: Path, names: Names) -> bool:
    """Whether there is what write_bag writes and nothing besides: its three topics, the whole path in one message."""
    from rosbags.highlevel import AnyReader, AnyReaderError

    unreadable: tuple[type[Exception], ...] = (AnyReaderError, *damage())
    try:
        files = list(path.iterdir()) if path.is_dir() else [path]
        if not files:
            return True
        if not all(is_plain_file(file) and file.name.endswith((".bag", ".mcap", "metadata.yaml")) for file in files):
            return False
        with AnyReader([path]) as reader:
            found = {name: topic.msgtype for name, topic in reader.topics.items()}
            return found == _topics(names) and reader.topics[names.path].msgcount == 1
    except unreadable:  # so it is not ours
        return False


def _topics(names: Names) -> dict[str, str]:
    """The types of all topics that are written."""
    return {names.path: PATH, names.odometry: ODOMETRY, "/tf": TF}


def _fill(
    writer: Any, messages: _Messages, run: TrackedRun, frames: Sequence[int], believed: Collection[int], names: Names
) -> None:
    """All messages in the order of time; the path, whole, with the first of them, so that a viewer shows it at once."""
    connections = {
        topic: writer.add_connection(topic, kind, typestore=messages.store) for topic, kind in _topics(names).items()
    }
    motions = [in_axes(motion_of(run, number, believed), names.axes) for number in frames]
    stamps = [round(float(run.times[number]) * 1e6) * 1000 for number in frames]
    path = messages.path(stamps, motions, names)
    writer.write(connections[names.path], stamps[0], messages.bytes(PATH, path))
    for stamp, motion in zip(stamps, motions, strict=True):
        odometry, transforms = messages.odometry(stamp, motion, names), messages.transforms(stamp, motion, names)
        writer.write(connections[names.odometry], stamp, messages.bytes(ODOMETRY, odometry))
        writer.write(connections["/tf"], stamp, messages.bytes(TF, transforms))


class _Messages:
    """Builds messages of either ROS."""

    def __init__(self, version: int) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.version = version
        self.store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
        if TF not in self.store.types:  # rosbags has it for ROS 2 alone
            self.store.register(get_types_from_msg(TF_DEFINITION, TF))

    def bytes(self, kind: str, message: Any) -> Any:
        """A message as a recording holds it."""
        write = self.store.serialize_ros1 if self.version == 1 else self.store.serialize_cdr
        return write(message, kind)

    def odometry(self, stamp: int, motion: Motion, names: Names) -> Any:
        """nav_msgs/Odometry."""
        linear, angular = (
            self._make("geometry_msgs/msg/Vector3", *part.tolist()) for part in np.split(motion.twist, 2)
        )
        twist = self._make("geometry_msgs/msg/Twist", linear, angular)
        return self._make(
            ODOMETRY,
            self._header(stamp, names.world),
            names.moving,
            self._make(
                "geometry_msgs/msg/PoseWithCovariance", self._pose(motion), motion.pose_covariance.ravel().copy()
            ),
            self._make("geometry_msgs/msg/TwistWithCovariance", twist, motion.twist_covariance.ravel().copy()),
        )

    def path(self, stamps: Sequence[int], motions: Sequence[Motion], names: Names) -> Any:
        """nav_msgs/Path."""
        poses = [
            self._make(STAMPED, self._header(stamp, names.world), self._pose(motion))
            for stamp, motion in zip(stamps, motions, strict=True)
        ]
        return self._make(PATH, self._header(stamps[0], names.world), poses)

    def transforms(self, stamp: int, motion: Motion, names: Names) -> Any:
        """tf2_msgs/TFMessage: the moving frame in the world, and the camera in a body."""
        given = [(names.world, names.moving, motion.T_world_child)]
        if names.axes == "body":
            T_body_optical = np.eye(4)
            T_body_optical[:3, :3] = R_BODY_OPTICAL
            given.append((names.moving, names.camera, T_body_optical))
        return self._make(TF, [self._transform(stamp, *one) for one in given])

    def _transform(self, stamp: int, parent: str, child: str, T: Array) -> Any:
        position = self._make("geometry_msgs/msg/Vector3", *T[:3, 3].tolist())
        transform = self._make("geometry_msgs/msg/Transform", position, self._rotation(T))
        return self._make(TRANSFORM, self._header(stamp, parent), child, transform)

    def _pose(self, motion: Motion) -> Any:
        T = motion.T_world_child
        position = self._make("geometry_msgs/msg/Point", *T[:3, 3].tolist())
        return self._make("geometry_msgs/msg/Pose", position, self._rotation(T))

    def _rotation(self, T: Array) -> Any:
        rotation = torch.from_numpy(np.ascontiguousarray(T[:3, :3]))
        return self._make("geometry_msgs/msg/Quaternion", *quaternion_from_rotation(rotation).tolist())

    def _header(self, stamp: int, frame_id: str) -> Any:
        time = self._make("builtin_interfaces/msg/Time", stamp // 10**9, stamp % 10**9)
        number = (0,) if self.version == 1 else ()
        return self._make("std_msgs/msg/Header", *number, time, frame_id)

    def _make(self, kind: str, *values: Any) -> Any:
        return self.store.types[kind](*values)
