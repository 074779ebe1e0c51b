"""Recorded sequences; one file a format, all give RgbdFrame."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from ..camera import Pinhole
from ..frame import BrokenFrame, RgbdFrame
from ..trajectory import Trajectory
from .tum import TumSequence


class RgbdSequence(Protocol):
    """What every format offers: frames in the order of time, read lazily."""

    name: str
    camera: Pinhole
    timestamps: list[float]  # s
    groundtruth: Trajectory | None
    warnings: list[str]  # sentences that a user should see

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[RgbdFrame | BrokenFrame]: ...

    def read(self, index: int) -> RgbdFrame | BrokenFrame:
        """One frame, decoded now."""


def open_sequence(
    path: Path | str,
    *,
    camera: Path | None = None,
    associations: Path | None = None,
    depth_scale: float | None = None,
    association_limit_s: float = 0.02,
    start: int = 0,
    every: int = 1,
    max_frames: int | None = None,
) -> RgbdSequence:
    """The sequence in a folder (today of the TUM layout). Raises IdRgbdoError where there is none; see TumSequence."""
    return TumSequence(
        Path(path),
        camera=camera,
        associations=associations,
        depth_scale=depth_scale,
        association_limit_s=association_limit_s,
        start=start,
        every=every,
        max_frames=max_frames,
    )
