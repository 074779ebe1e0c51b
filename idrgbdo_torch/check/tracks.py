"""Corners followed from frame to frame (pyramidal Lucas-Kanade): how far the image moves, and matches with depth."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from .samples import Bytes, Floats, Sample

Array = NDArray[np.float64]

CORNERS = 300
QUALITY = 0.005  # of the strongest corner
SPAN = 12  # frames between the two of a pair
FEWEST = 40  # matches of a pair
WINDOW, LEVELS = (15, 15), 4
RETURN = 0.7  # px by which a corner followed forth and back may miss
SMOOTH = 1.05  # ratio of depths around a point, above which its depth is not used


@dataclass(frozen=True)
class Pair:
    """Matches between two frames."""

    first: float  # s
    second: float
    uv_first: Array  # (N, 2) px
    uv_second: Array
    depth_first: Array  # (N,) m, 0 where unknown
    depth_second: Array


@dataclass
class Tracks:
    """What following the corners gave so far."""

    pairs: list[Pair] = field(default_factory=list)
    flow: list[float] = field(default_factory=list)  # px, median between neighbouring frames
    kept: list[float] = field(default_factory=list)  # share of corners found again in the next frame
    found_at: list[int] = field(default_factory=list)  # number of that next frame, for each of `kept`

    def add(self, run: list[Sample]) -> None:
        """Follow corners through a run of neighbouring frames; anew once too few are left, or after SPAN frames."""
        start: Sample | None = None
        uv_start = uv = np.zeros((0, 2), np.float32)
        for number, sample in enumerate(run):
            if start is not None:
                moved, found = follow(run[number - 1].gray, sample.gray, uv)
                if len(found):
                    self.kept.append(float(found.mean()))
                    self.found_at.append(sample.index)
                if found.any():
                    self.flow.append(float(np.median(np.linalg.norm(moved - uv, axis=1)[found])))
                uv_start, uv = uv_start[found], moved[found]
                if sample.index - start.index >= SPAN or len(uv) < 2 * FEWEST or number == len(run) - 1:
                    if len(uv) >= FEWEST:
                        depths = smooth_depth(start.depth, uv_start), smooth_depth(sample.depth, uv)
                        times = start.timestamp, sample.timestamp
                        self.pairs.append(Pair(*times, uv_start.astype(float), uv.astype(float), *depths))
                    start = None
            if start is None:
                start, uv = sample, corners(sample.gray)
                uv_start = uv


def corners(gray: Bytes) -> Floats:
    """(N, 2) px of the strongest corners, spread."""
    found = cv2.goodFeaturesToTrack(gray, CORNERS, QUALITY, max(5.0, gray.shape[1] / 60))
    return np.zeros((0, 2), np.float32) if found is None else np.asarray(found[:, 0], np.float32)


def follow(first: Bytes, second: Bytes, uv: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """(N, 2) px of the points in the second image, and which were found: back again they end where they began."""
    if len(uv) == 0:
        return uv, np.zeros(0, dtype=np.bool_)
    moved, forth, _ = cv2.calcOpticalFlowPyrLK(first, second, uv[:, None], None, winSize=WINDOW, maxLevel=LEVELS)
    again, back, _ = cv2.calcOpticalFlowPyrLK(second, first, moved, None, winSize=WINDOW, maxLevel=LEVELS)
    miss = np.linalg.norm(again[:, 0] - uv, axis=1)
    return moved[:, 0], (forth[:, 0] > 0) & (back[:, 0] > 0) & (miss < RETURN)


def smooth_depth(depth: Floats, uv: Floats) -> Array:
    """(N,) bilinear depth (m) at (N, 2) px; 0 at holes, jumps and the border."""
    height, width = depth.shape
    column, row = np.floor(uv).astype(np.int64).T
    inside = (column >= 2) & (row >= 2) & (column < width - 3) & (row < height - 3)
    column, row = np.where(inside, column, 2), np.where(inside, row, 2)
    around = np.stack([depth[row + dv, column + du] for dv in (-2, 0, 1, 3) for du in (-2, 0, 1, 3)])
    u, v = uv[:, 0] - column, uv[:, 1] - row
    weights = {(0, 0): (1 - u) * (1 - v), (1, 0): u * (1 - v), (0, 1): (1 - u) * v, (1, 1): u * v}
    value = sum(weight * depth[row + dv, column + du] for (du, dv), weight in weights.items())
    good = inside & (around.min(axis=0) > 0) & (around.max(axis=0) < SMOOTH * around.min(axis=0))
    return np.where(good, value, 0.0).astype(np.float64)
