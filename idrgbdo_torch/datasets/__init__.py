"""Recorded sequences; one file a format, all give RgbdFrame."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from ..definitions.camera import Pinhole
from ..definitions.given import given_path
from ..frame import BrokenFrame, RgbdFrame
from ..trajectory import Trajectory
from .formats import FORMATS, guess, read_recording
from .realsense import RealSenseRecording, is_realsense
from .recording import Options, RecordedSequence

__all__ = ["FORMATS", "RecordedSequence", "RgbdSequence", "guess", "open_sequence"]


class RgbdSequence(Protocol):
    """What every format offers: frames in the order of time, read lazily."""

    name: str
    groundtruth: Trajectory | None
    timestamps: list[float]  # s
    warnings: list[str]  # sentences that a user should see

    @property
    def camera(self) -> Pinhole:
        """The undistorted pinhole of all frames."""

    @property
    def recognised(self) -> str:
        """What the recording was taken for, in one line."""

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[RgbdFrame | BrokenFrame]: ...

    def __getitem__(self, index: int) -> RgbdFrame | BrokenFrame:
        """One frame by its number, negative ones from the end.

        Raises IndexError after the last, IdRgbdoError for a slice or what else is no number.
        """

    def read(self, index: int) -> RgbdFrame | BrokenFrame:
        """One frame, decoded now."""


def open_sequence(
    path: Path | str,
    *,
    format: str | None = None,
    camera: Path | None = None,
    associations: Path | None = None,
    depth_scale: float | None = None,
    association_limit_s: float = 0.02,
    color_topic: str | None = None,
    depth_topic: str | None = None,
    start: int = 0,
    every: int = 1,
    max_frames: int | None = None,
) -> RgbdSequence:
    """The recording in a folder or file, of any of FORMATS; `recognised` tells which.

    format: one of FORMATS; by default the one that the path looks like. camera: a file with the intrinsics, see
    find_calibration. depth_scale: values per metre, by default what the camera file says, else the format's usual.
    associations: a list `timestamp colour timestamp depth` instead of pairing by time. association_limit_s: between
    the two images of a frame. color_topic, depth_topic: of a ROS bag. start, every, max_frames: leave out the first
    frames, take each n-th of the others, stop after so many.
    Raises IdRgbdoError, saying what is missing, for anything that cannot be read.
    """
    options = Options(
        camera, associations, depth_scale, association_limit_s, color_topic, depth_topic, start, every, max_frames
    )
    where = given_path("path", path)
    if format is None and is_realsense(where):
        return RealSenseRecording(where, options)
    return _recorded(where, options, format)


def _recorded(path: Path, options: Options, format: str | None) -> RecordedSequence:
    sequence = RecordedSequence(read_recording(path, options, format), options)
    sequence.reopen = (_recorded, path.resolve(), options, format)
    return sequence
