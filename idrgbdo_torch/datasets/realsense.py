"""Recordings of a RealSense camera (.bag), played through Open3D's reader, which registers depth to colour."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from ..definitions.camera import Pinhole
from ..definitions.given import place
from ..errors import IdRgbdoError
from ..frame import BrokenFrame, RgbdFrame
from ..tracker.open3d_loader import load_open3d
from ..trajectory import Trajectory
from .bag_files import index_head
from .builder import FrameBuilder
from .depth_scale import depth_warnings
from .open3d_images import calibration_of, open3d_speaks, raw_pair
from .recording import Options


def is_realsense(path: Path) -> bool:
    """Whether a .bag has the topics of Intel's own recorder. Any other file is none."""
    return path.suffix == ".bag" and b"/device_0/sensor_0/" in index_head(path)


class RealSenseRecording:
    """Frames in the order in which they are played; only Open3D knows how many, so length and times are estimates.

    `timestamps` holds the nominal times until a frame has been read, then its own. Going back is not possible.
    """

    groundtruth: Trajectory | None = None

    def __init__(self, path: Path, options: Options, reader: Any = None) -> None:
        """reader: an object like Open3D's RSBagReader, for tests. Raises IdRgbdoError for a file it cannot play."""
        self._path = path
        with open3d_speaks(f"reading {path}"):
            self._reader = load_open3d().t.io.RSBagReader() if reader is None else reader
            opened = self._reader.open(str(path))
        if not opened:
            raise IdRgbdoError(f"{path}: expected a RealSense recording, Open3D cannot open it; record it again")
        metadata = self._reader.metadata
        total = max(1, round(metadata.stream_length_usec * 1e-6 * metadata.fps))
        self._chosen = options.choose(total)
        self._next = 0  # frame number that the reader gives next
        self._read = 0  # chosen frames that were read
        self.name = path.stem
        self.timestamps = [index / metadata.fps for index in self._chosen]
        calibration = calibration_of(metadata.intrinsics, options.camera)
        first = self._skip_to(self._chosen[0])
        if first is None:
            raise IdRgbdoError(f"{path}: expected frames, the recording ends before the first; record it again")
        self._waiting: tuple[float, Any] | None = first
        color, depth = raw_pair(first[1])
        self.depth_scale: float = options.depth_scale or calibration.depth_scale or metadata.depth_scale
        self._builder = FrameBuilder(calibration, color, self.depth_scale)
        self.camera: Pinhole = self._builder.camera
        self.warnings = depth_warnings(depth, self.depth_scale)

    @property
    def recognised(self) -> str:
        """What this was taken for, in one line."""
        c = self.camera
        return f"RealSense recording, played once: about {len(self)} frames of {c.width}x{c.height}"

    def __len__(self) -> int:
        return len(self._chosen)

    def __iter__(self) -> Iterator[RgbdFrame | BrokenFrame]:
        while (frame := self._advance()) is not None:
            yield frame

    def __getitem__(self, index: int) -> RgbdFrame | BrokenFrame:
        """Frame number `index`, from the end where it is negative."""
        return self.read(place(index, len(self)))

    def read(self, index: int) -> RgbdFrame | BrokenFrame:
        """Frame number `index`, which must be the next one; a BrokenFrame after the end.

        Raises IdRgbdoError for any other.
        """
        if index != self._read:
            raise IdRgbdoError(
                f"{self._path}: frames of a RealSense recording come in order, next is {self._read}, not {index}; "
                "convert it to a folder first (Open3D: RGBDVideoReader.save_frames)"
            )
        frame = self._advance()
        return frame if frame is not None else BrokenFrame(self.timestamps[index], "the recording has ended")

    def _advance(self) -> RgbdFrame | BrokenFrame | None:
        """The next chosen frame; None at the end."""
        if self._read >= len(self._chosen):
            return None
        played = self._waiting or self._skip_to(self._chosen[self._read])
        self._waiting = None
        if played is None:
            return None
        timestamp, image = played
        self.timestamps[self._read] = timestamp
        self._read += 1
        return self._builder.frame_or_reason(timestamp, partial(raw_pair, image))

    def _skip_to(self, number: int) -> tuple[float, Any] | None:
        """Time and image of frame `number`; None where the recording ends before."""
        while True:
            with open3d_speaks(f"reading {self._path}"):
                image = self._reader.next_frame()
            if image.is_empty():
                return None
            self._next += 1
            if self._next > number:
                return self._reader.get_timestamp() * 1e-6, image
