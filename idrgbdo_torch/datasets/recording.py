"""What all formats share: which frames are taken, the camera, warnings, and broken files that cost one frame each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ..definitions.camera import Pinhole
from ..definitions.given import place
from ..errors import IdRgbdoError
from ..frame import BrokenFrame, RgbdFrame
from ..trajectory import Trajectory
from .builder import FrameBuilder, RawPair, unreadable_named, with_swapped_bytes
from .calibration import Calibration
from .depth_scale import depth_reading
from .prefetch import AHEAD, prefetch
from .usual import usual_pair

AHEAD_BYTES = 256 << 20  # of the frames that are decoded ahead, about; frames of the usual size are few MB


LEAST_SCALE, MOST_SCALE = 1e-3, 1e9  # depth values per metre


@dataclass(frozen=True)
class Options:
    """What a user may say about reading a recording; see open_sequence."""

    camera: Path | None = None
    associations: Path | None = None
    depth_scale: float | None = None
    association_limit_s: float = 0.02
    color_topic: str | None = None
    depth_topic: str | None = None
    start: int = 0
    every: int = 1
    max_frames: int | None = None

    def __post_init__(self) -> None:
        for name, value, least in (
            ("start", self.start, 0),
            ("every", self.every, 1),
            ("max_frames", self.max_frames, 1),
        ):
            if value is not None and value < least:
                raise IdRgbdoError(f"{name}: expected at least {least}, got {value}; change it")
        if self.depth_scale is not None and not LEAST_SCALE <= self.depth_scale <= MOST_SCALE:
            raise IdRgbdoError(
                f"depth_scale: expected depth values per metre, above 0 (from {LEAST_SCALE:g} to {MOST_SCALE:g}), "
                f"got {self.depth_scale}; change it"
            )
        if not 0 <= self.association_limit_s < float("inf"):
            raise IdRgbdoError(
                f"association_limit_s: expected seconds, at least 0, got {self.association_limit_s}; change it"
            )

    def choose(self, frames: int) -> range:
        """The numbers of the chosen frames. Raises IdRgbdoError where none is left."""
        chosen = range(frames)[self.start :: self.every][: self.max_frames]
        if not chosen:
            raise IdRgbdoError(f"start: expected less than the sequence's {frames} frames, got {self.start}; lower it")
        return chosen


@dataclass(frozen=True)
class Recording:
    """What a format finds out about a recording; the images are decoded when asked for."""

    name: str
    title: str  # what was recognised, for people
    timestamps: Sequence[float]  # s, increasing, of all frames
    read: Callable[[int], RawPair]  # the images of a frame; raises IdRgbdoError for a broken one
    calibration: Calibration
    depth_scale: float  # values per metre of depth in integers, unless the user or the camera file says otherwise
    groundtruth: Trajectory | None = None
    warnings: tuple[str, ...] = ()
    any_thread: bool = True  # `read` may be called in any thread, and in several at once


class RecordedSequence:
    """A recording as frames. They are decoded a few ahead of their turn, so memory does not grow with its length."""

    def __init__(self, recording: Recording, options: Options) -> None:
        """Choose the frames and read some of them, most of which tell the image size.

        Raises IdRgbdoError where no frame is left or none can be read.
        """
        self._recording = recording = replace(recording, read=unreadable_named(recording.read))
        self.reopen: tuple[Any, ...] | None = None  # a function that opens it again, and its arguments
        self._chosen = options.choose(len(recording.timestamps))
        self.name = recording.name
        self.timestamps = [recording.timestamps[index] for index in self._chosen]  # s, of the colour images
        self.groundtruth: Trajectory | None = recording.groundtruth
        stated = recording.calibration.height, recording.calibration.width
        _, (color, depth) = usual_pair(recording.read, self._chosen, stated)
        if with_swapped_bytes(depth) and all(map(with_swapped_bytes, self._later_depths())):
            raise IdRgbdoError(with_swapped_bytes(depth))
        in_file = recording.calibration.depth_scale
        reading = depth_reading(depth, self._later_depths, options.depth_scale, in_file, recording.depth_scale)
        self.depth_scale = reading.scale
        self._assumed = options.depth_scale is None and in_file is None
        self._builder = FrameBuilder(
            recording.calibration, color, reading.scale, reading.unknown, depth.dtype.kind == "f"
        )
        self.camera: Pinhole = self._builder.camera
        built = self._builder.frame_or_reason(0.0, lambda: (color, depth))
        if isinstance(built, BrokenFrame):  # colour and depth must fit each other
            raise IdRgbdoError(built.reason)
        size = self.camera.width, self.camera.height
        doubts = recording.calibration.size_doubt(*size), recording.calibration.distortion_doubt(*size)
        self.warnings = [*recording.warnings, *reading.warnings, *filter(None, doubts)]

    @property
    def recognised(self) -> str:
        """What this was taken for, in one line."""
        c = self.camera
        truth = "with ground truth" if self.groundtruth is not None else "no ground truth"
        depth = "depth in metres" if self.depth_scale == 1 else f"{self.depth_scale:g} depth values per metre"
        depth += " (the format's default)" if self._assumed and self.depth_scale != 1 else ""
        origin = self._recording.calibration.origin
        about = f"{len(self)} frames of {c.width}x{c.height}, {depth}, {truth}"
        return f"{self._recording.title}: {about}{', ' if origin else ''}{origin}"

    def __len__(self) -> int:
        return len(self._chosen)

    def __iter__(self) -> Iterator[RgbdFrame | BrokenFrame]:
        return self.frames()

    def frames(self, first: int = 0) -> Iterator[RgbdFrame | BrokenFrame]:
        """The frames from number `first` on, decoded ahead where the format allows it."""
        numbers = range(first, len(self))
        if not self._recording.any_thread:
            return map(self.read, numbers)
        ahead = AHEAD_BYTES // (11 * self.camera.width * self.camera.height)  # gray, depth and colour of a frame
        return prefetch(self.read, numbers, ahead=min(AHEAD, max(ahead, 1)))

    def __getitem__(self, index: int) -> RgbdFrame | BrokenFrame:
        """Frame number `index`, from the end where it is negative, so that a torch DataLoader takes a sequence."""
        return self.read(place(index, len(self)))

    def __reduce__(self) -> tuple[Callable[..., RecordedSequence], tuple[object, ...]]:
        """Pickled as what it was opened from, and opened anew: readers of bags share no file between processes."""
        if self.reopen is None:
            raise IdRgbdoError(f"sequence: '{self.name}' cannot be pickled; open it with open_sequence")
        function, *arguments = self.reopen
        return function, tuple(arguments)

    def read(self, index: int) -> RgbdFrame | BrokenFrame:
        """Frame number `index`; a BrokenFrame with the reason where a file is missing, damaged or of another size."""
        number = self._chosen[index]
        return self._builder.frame_or_reason(self.timestamps[index], partial(self._recording.read, number))

    def _later_depths(self) -> Iterator[NDArray[Any]]:
        """The raw depth of the frames in the middle and at the end, where they can be read."""
        for index in {self._chosen[len(self) // 2], self._chosen[-1]}:
            try:
                yield self._recording.read(index)[1]
            except IdRgbdoError:
                continue
