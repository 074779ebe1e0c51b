"""Frame rate, gaps, and how colour and depth were paired."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..text.files import MOST_TEXT, is_plain_file, read_bytes

Array = NDArray[np.float64]

PAUSE_S, PAUSE_FRAMES = 5.0, 20  # a gap that is longer than both: no disk is as slow, somebody paused the recording


@dataclass(frozen=True)
class Timing:
    """Of the frames' time stamps."""

    period_s: float  # between neighbours where none is missing
    intervals_s: Array  # (N - 1,)
    missing: int  # frames that the gaps would have held, pauses left out
    longest_s: float  # gap
    pauses_s: tuple[float, ...] = ()  # gaps in which the camera was paused

    @property
    def missing_share(self) -> float:
        """Of the frames there should be."""
        return self.missing / (self.missing + len(self.intervals_s) + 1)


def timing(timestamps: list[float]) -> Timing | None:
    """None for less than three frames. The period is the median of the short intervals, so half may be missing."""
    intervals = np.diff(np.array(timestamps, dtype=np.float64))
    if len(intervals) < 2:
        return None
    short = intervals[intervals <= 1.5 * np.percentile(intervals, 20)]
    period = float(np.median(short))
    paused = intervals > max(PAUSE_S, PAUSE_FRAMES * period)
    steps = np.maximum(np.rint(intervals[~paused] / period), 1.0)
    pauses = tuple(intervals[paused].tolist())
    return Timing(period, intervals, int((steps - 1).sum()), float(intervals.max()), pauses)


@dataclass(frozen=True)
class Lists:
    """How many images the folder's lists name, and how far their times are apart."""

    color: int
    depth: int
    delay_s: float  # median, of the depth image nearest to a colour image


def lists(folder: Path) -> Lists | None:
    """From rgb.txt and depth.txt; None where the folder has no such lists."""
    color, depth = (_times(folder / name) for name in ("rgb.txt", "depth.txt"))
    if len(color) == 0 or len(depth) == 0:
        return None
    index = np.searchsorted(depth, color)
    before = depth[np.maximum(index - 1, 0)] - color
    after = depth[np.minimum(index, len(depth) - 1)] - color
    delay = np.where(np.abs(before) < np.abs(after), before, after)
    return Lists(len(color), len(depth), float(np.median(delay)))


def _times(path: Path) -> Array:
    """The sorted times (s) of a list `timestamp file`; none where there is no such list."""
    if not is_plain_file(path):
        return np.zeros(0)
    lines = [
        line.split()[0]
        for line in read_bytes(path, MOST_TEXT).decode("utf-8", errors="replace").splitlines()
        if line.strip()
    ]
    times = np.array([float(first) for first in lines if first.replace(".", "", 1).isdecimal()])
    return np.unique(times[np.isfinite(times)])
