"""ROS 1 bags and ROS 2 bags (mcap, sqlite3), raw or compressed images, read with rosbags; no ROS is needed."""

from __future__ import annotations

import re
import weakref
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import IdRgbdoError
from ..text.files import is_named
from ..text.plain import plain, shown
from .bag_files import check_files, damage, repair
from .bags.reader import Connection, Reader
from .builder import RawPair
from .calibration import Calibration, find_calibration
from .pairing import out_of_time, pair_by_time, unpaired_warning
from .recording import Options, Recording
from .ros_camera import calibration_of_info
from .ros_images import DEPTH_HEADER, color_image, depth_image, is_deep
from .ros_times import Shot, Shots, Stamp, in_time
from .ros_topics import Topic, choose_topics, namespace_of
from .usual import LOOK_AT

DEPTH_SCALE = 1000.0  # REP 118
IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
INFO_TYPE = "sensor_msgs/msg/CameraInfo"


def recognise(path: Path) -> bool:
    """Whether the file's or folder's name says so; recordings that were interrupted have no metadata.yaml."""
    if path.suffix in (".bag", ".mcap", ".db3") or is_named(path / "metadata.yaml"):
        return True
    own = re.compile(re.escape(path.name) + r"(_\d+)?\.(mcap|db3)")
    with suppress(OSError):  # of a folder that may not be listed
        return path.is_dir() and any(own.fullmatch(file.name) for file in path.iterdir())
    return False


def read(path: Path, options: Options) -> Recording:
    """Choose the topics, pair their images by the times of their headers, and find the camera.

    The whole recording is passed through once for the times. Raises IdRgbdoError without rosbags, or for a recording
    that cannot be read or lacks a topic.
    """
    bag = _Bag(path)
    beside = path.with_suffix(".toml")  # as `idrgbdo live --record` leaves it
    options = replace(options, camera=beside) if options.camera is None and beside.is_file() else options
    color, depth, ambiguous = bag.topics(options)
    color_shots, depth_shots = bag.shots(color), bag.shots(depth)
    if bag.reader.revised():  # with what looking for depth has found
        color_shots = bag.shots(color)
    of_color, of_depth, repeats = in_time(color_shots, depth_shots, path)
    frames = pair_by_time(of_color, of_depth, options.association_limit_s, path)
    paired = {stamp for _, *both in frames for stamp in both}
    bag.timeless |= {stamp for images in (of_color, of_depth) for stamp in out_of_time(images, paired)}

    def read_pair(index: int) -> RawPair:
        _, color_stamp, depth_stamp = frames[index]
        where = f"{path}, frame {index}"
        with _damage_named(where):
            return (
                color_image(bag.message(color, color_stamp), f"{where}, {color.topic}"),
                depth_image(bag.message(depth, depth_stamp), f"{where}, {depth.topic}"),
            )

    return Recording(
        name=path.stem if path.is_file() else path.resolve().name,
        title=f"ROS {2 if bag.reader.is2 else 1} recording, {color.topic} and {depth.topic}",
        timestamps=[time for time, _, _ in frames],
        read=read_pair,
        any_thread=False,  # SQLite's rule
        calibration=bag.calibration(color.topic) if options.camera is None else find_calibration(path, options.camera),
        depth_scale=DEPTH_SCALE,
        warnings=(
            *ambiguous,
            *repeats,
            *unpaired_warning(of_color, of_depth, len(frames), options.association_limit_s),
            *bag.warnings(),
            *(bag.frame_warnings(color, frames[0][1], depth, frames[0][2]) if options.camera is None else ()),
        ),
    )


class _Bag:
    """An open recording."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.reader = _open(path)
        self.timeless: set[object] = set()  # images without a time of this recording, or of another topic
        weakref.finalize(self, self.reader.close)

    def warnings(self) -> tuple[str, ...]:
        """What is damaged, and what else is to be said of the files."""
        damaged = self.reader.damaged()
        first = f" ({shown(plain(damaged[0]), quoted=False)})" if damaged else ""
        count = len(damaged) + len(self.timeless)
        left_out = f"{count} damaged images, or places in the recording, are left out{first}"
        return (*self.reader.said(), *((left_out,) if count else ()))

    def topics(self, options: Options) -> tuple[Connection, Connection, tuple[str, ...]]:
        """The connections of colour and depth, and warnings. Raises IdRgbdoError where they cannot be told."""
        images = [c for c in self.reader.connections if c.msgtype in IMAGE_TYPES]
        topics = [self._topic(c) for c in images]
        named = options.color_topic, options.depth_topic
        color, depth, warnings = choose_topics(topics, *named, self._frame_id, str(self._path))
        return color.connection, depth.connection, warnings

    def _topic(self, connection: Connection) -> Topic[Connection]:
        """A topic by the first of its messages that is more than a header; damage is for later to tell."""
        raw, filled = connection.msgtype == IMAGE_TYPES[0], False
        for _, data in islice(self._messages(connection), LOOK_AT):
            try:
                message = self._decode(data, connection)
            except IdRgbdoError:
                filled = True
                continue
            if len(message.data) > DEPTH_HEADER.size:
                return Topic(connection.topic, raw, True, connection, is_deep(message))
        return Topic(connection.topic, raw, filled, connection)

    def _frame_id(self, topic: Topic[Connection]) -> str:
        """The frame that the header of the topic's first message names."""
        for _, data in islice(self._messages(topic.connection), LOOK_AT):
            try:
                return str(self._decode(data, topic.connection).header.frame_id)
            except IdRgbdoError:
                continue
        return ""

    def shots(self, connection: Connection) -> Shots:
        """The images of a topic with the time of their headers, or that of their recording where headers have none.

        Raises IdRgbdoError for a recording that has none.
        """
        images: list[tuple[Shot, bool]] = []
        clock = self._camera_clock(connection)
        for recorded, data in self._messages(connection):
            try:
                message = self._decode(data, connection)
                stamp = self._stamp(message)
            except IdRgbdoError:
                self.timeless.add((connection.topic, recorded))
                continue
            time = clock.get(recorded) or (stamp if stamp > 0 else recorded / 1e9)
            images.append((Shot(time, (stamp, recorded), zlib.crc32(message.data)), is_deep(message)))
        usual = 2 * sum(deep for _, deep in images) >= len(images)
        self.timeless |= {(connection.topic, shot.stamp) for shot, deep in images if deep != usual}
        if not images:
            damaged = self.reader.damaged()
            why = f" (damaged: {damaged[0]})" if damaged else ""
            raise IdRgbdoError(
                f"{self._path}: expected images in '{connection.topic}', got none{why}; name another topic"
            )
        return Shots(connection.topic, [shot for shot, deep in images if deep == usual])

    def _camera_clock(self, connection: Connection) -> dict[int, float]:
        """Times by the camera's own clock (s) of images by that of their recording (ns), as pyrealsense2 leaves them.

        Its headers have the times at which the images arrived.
        """
        beside = f"{connection.topic.split('/data')[0]}/metadata"
        times: dict[int, float] = {}
        for other in self.reader.connections:
            if other.topic == beside and other.msgtype == "std_msgs/msg/String":
                for recorded, data in self._messages(other):
                    said = re.search(rb"\btimestamp=([\d.]+);", data)
                    times.update({recorded: float(said[1]) * 1e-3} if said else {})
        return times

    def message(self, connection: Connection, which: Stamp) -> Any:
        """The message of that time."""
        stamp, recorded = which
        for _, data in self._messages(connection, recorded, recorded + 1):
            message = self._decode(data, connection)
            if self._stamp(message) == stamp:
                return message
        raise IdRgbdoError(f"{self._path}: the image of {stamp:.6f} s is gone; was the file changed?")

    def calibration(self, color_topic: str) -> Calibration:
        """From the camera_info beside the colour topic. Raises IdRgbdoError without one."""
        namespace = namespace_of(color_topic)
        first_error: IdRgbdoError | None = None
        infos = [c for c in self.reader.connections if c.msgtype == INFO_TYPE]
        own = [c for c in infos if namespace_of(c.topic) == namespace and any(self._messages(c))]
        for connection in own or self._astray(infos, color_topic):
            where = f"{self._path}, {connection.topic}"
            for _, data in islice(self._messages(connection), LOOK_AT):
                try:
                    with _damage_named(where):
                        return calibration_of_info(self._decode(data, connection), "rect" in color_topic, where)
                except IdRgbdoError as error:
                    first_error = first_error or error
        if first_error is not None:
            raise first_error
        raise IdRgbdoError(
            f"{self._path}: expected '{namespace}/camera_info', found {', '.join(c.topic for c in infos) or 'none'}; "
            "pass --camera F.toml with fx, fy, cx, cy"
        )

    def _astray(self, infos: list[Connection], color_topic: str) -> list[Connection]:
        """The camera_info beside no images that is of the frame and size of these, as where a name is damaged.

        None where there are several.
        """
        images = [c for c in self.reader.connections if c.msgtype in IMAGE_TYPES]
        beside = {namespace_of(c.topic) for c in images if any(self._messages(c))}
        sides = {side for c in images if c.topic == color_topic for side in self._sides(c)}
        found = [c for c in infos if namespace_of(c.topic) not in beside and sides & self._sides(c)]
        if len(found) != 1:
            return []
        note = f"no camera_info stands beside {color_topic}; {found[0].topic}, of the same frame and size, is taken"
        self.reader.notes += [note] if note not in self.reader.notes else []
        return found

    def _sides(self, connection: Connection) -> set[tuple[str, int, int]]:
        """Frame, width and height that its first messages name; 0 where images are packed, and besides."""
        found: set[tuple[str, int, int]] = set()
        for _, data in islice(self._messages(connection), LOOK_AT):
            with suppress(IdRgbdoError):
                message = self._decode(data, connection)
                frame = str(message.header.frame_id)
                packed = connection.msgtype == IMAGE_TYPES[1]
                found |= {(frame, 0, 0)} if packed else {(frame, message.width, message.height)}
                found |= {(frame, 0, 0)} if connection.msgtype == INFO_TYPE else set()
        return found

    def frame_warnings(self, color: Connection, a: Stamp, depth: Connection, b: Stamp) -> tuple[str, ...]:
        """A sentence where the two images come from different cameras, by their headers or by their intrinsics."""
        try:
            of_color, of_depth = (self.message(c, s).header.frame_id for c, s in ((color, a), (depth, b)))
        except IdRgbdoError:  # the first images can be damaged
            return ()
        if of_color != of_depth and of_color and of_depth:
            apart = f"colour is in the frame '{of_color}', depth in '{of_depth}'"
        else:
            try:
                of_colors, of_depths = (self.calibration(c.topic) for c in (color, depth))
            except IdRgbdoError:
                return ()
            K, k = ((c.fx, c.fy, c.cx, c.cy) for c in (of_colors, of_depths))
            if np.allclose(K, k, rtol=0.01):
                return ()
            apart = f"the camera_info of depth says fx={k[0]:.1f}, cx={k[2]:.1f}, colour's fx={K[0]:.1f}, cx={K[2]:.1f}"
        return (
            f"{apart}: if depth is not registered to colour, name a "
            "registered topic with --depth-topic, or describe the depth camera in a camera file under [depth]",
        )

    def _messages(
        self, connection: Connection, start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[int, bytes]]:
        """Time of recording (ns) and data of a topic's messages, those that can be read."""
        with _damage_named(str(self._path)):
            yield from self.reader.messages(connection, start, stop)

    def _decode(self, data: bytes, connection: Connection) -> Any:
        with _damage_named(f"{self._path}, {connection.topic}"):
            return self.reader.deserialize(data, connection.msgtype)

    def _stamp(self, message: Any) -> float:
        with _damage_named(str(self._path)):
            stamp = message.header.stamp
            return float(stamp.sec + stamp.nanosec * 1e-9)


def _open(path: Path) -> Reader:
    try:
        import_module("rosbags.typesys")
    except ImportError as error:
        raise IdRgbdoError(
            f'{path}: reading ROS recordings needs rosbags ({error}); run `pip install "idrgbdo_torch[ros]"`'
        ) from error
    check_files(path)
    with _damage_named(f"{path}: cannot read this as a ROS recording", repair(path)):
        return Reader(path)


@contextmanager
def _damage_named(where: str, advice: str = "repair or record it again") -> Iterator[None]:
    """Raises IdRgbdoError for whatever rosbags says of damaged content."""
    try:
        yield
    except IdRgbdoError:
        raise
    except damage() as error:
        said = shown(" ".join(str(error).split()) or type(error).__name__, quoted=False)
        raise IdRgbdoError(f"{where}: the recording is damaged ({said}); {advice}") from error
