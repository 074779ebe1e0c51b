"""Does one scene stand still before a camera that moves? Cuts, a camera at rest, and things that move on their own."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..definitions.camera import Pinhole
from .tracks import Array, Pair

FEWEST = 15  # corners of a motion of its own
RANSAC_PX, RANSAC_ROUNDS, SEED = 3.0, 200, 0


@dataclass(frozen=True)
class TwoMotions:
    """How the corners of a pair of frames moved."""

    first: float  # share of the corners with depth that moved as one rigid scene
    second: float  # share that did as another


def two_motions(pair: Pair, camera: Pinhole) -> TwoMotions | None:
    """Fit one rigid motion to a pair's corners, then another to those that it does not explain; None for too few."""
    known = pair.depth_first > 0
    uv, uv_second, depth = pair.uv_first[known], pair.uv_second[known], pair.depth_first[known]
    if len(uv) < 2 * FEWEST:
        return None
    P = np.column_stack([(uv - [camera.cx, camera.cy]) / [camera.fx, camera.fy] * depth[:, None], depth])
    first = _agreeing(P, uv_second, camera)
    second = _agreeing(P[~first], uv_second[~first], camera)
    return TwoMotions(float(first.mean()), float(second.sum() / len(uv)) if second.sum() >= FEWEST else 0.0)


def _agreeing(points: Array, uv: Array, camera: Pinhole) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """(N,) which of the points (N, 3) come to lie at (N, 2) px by one motion."""
    out = np.zeros(len(points), dtype=np.bool_)
    if len(points) >= FEWEST:
        cv2.setRNGSeed(SEED)
        found, _, _, agreeing = cv2.solvePnPRansac(
            points, uv, camera.matrix().numpy(), None, reprojectionError=RANSAC_PX, iterationsCount=RANSAC_ROUNDS
        )
        if found and agreeing is not None:
            out[agreeing[:, 0]] = True
    return out
