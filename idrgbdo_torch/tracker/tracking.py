"""Pose of a frame against its keyframe (section 4.2): what is known beforehand, and one alignment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..config import Config
from ..frame import Frame, Keyframe
from ..kernels.se3 import inverse
from ..measurement import LEVELS, RATE, WIDE, MotionPrior, Noise, State, Subset
from .backends import Backend

Array = NDArray[np.float64]
Index = NDArray[np.int64]

STEPS = np.array([8, 10, 12, 12, 12, 12])  # most iterations per level, finest first
KEYFRAME_GAP = 1.0 / 30.0  # s, gap of the motion prior that a new keyframe's points are chosen with
FREE = np.diag([1e-2] * 6)  # information of a prior that holds nothing
ROUGH_STRIDE, ROUGH_PIXELS = 2, 1  # every second spread-out point, and one pixel of its patch
CLOSE = 3  # levels that it takes from a pose nearby
AFFINE_PRIOR = np.diag([1.0 / 0.1**2, 1.0 / 10.0**2])  # of gain and gray levels, about the previous frame's


@dataclass(frozen=True)
class Pair:
    """A frame (target) to be aligned to a keyframe (host), what its residuals are trusted with, and by whom."""

    frame: Frame
    keyframe: Keyframe
    noise: Noise
    backend: Backend


@dataclass(frozen=True)
class Tracked:
    """One alignment to a keyframe."""

    T_frame_kf: Array  # (4, 4)
    affine: Array  # (2,) a, b of the frame relative to the keyframe
    information: Array  # (6, 6) of a left increment of T_frame_kf, brightness marginalised, prior excluded
    points: int  # used
    iterations: int
    index: Index  # chosen candidates
    rms: Array  # whitened residual of each, -1 unseen
    wide: bool = False  # whether the patches of the finest level were


def motion_information(config: Config, dt: float) -> Array:
    """Sigma_m^-1 (6, 6) of Eq. 19 over dt seconds: a change of velocity moves the camera by its size times dt."""
    growth = (RATE * dt) * dt
    sigma_v = config.tracking.sigma_velocity * growth
    sigma_w = config.tracking.sigma_turn * growth
    information = np.zeros((6, 6))
    information.flat[::7] = (1.0 / sigma_v**2,) * 3 + (1.0 / sigma_w**2,) * 3
    return information


def track_frame(pair: Pair, start: State, index: Index, coarse: Subset, information: Array, levels: int) -> Tracked:
    """Align a frame to a keyframe from a guess, with the motion prior's information (6, 6) about that guess.

    index: the points of the finest level, with whole patches; coarse: those of the others.
    """
    fine = Subset(index, pair.keyframe.points.patch.shape[2])
    prior = MotionPrior(inverse(start.T), information, AFFINE_PRIOR)
    found = pair.backend.align(
        pair.frame.view, pair.keyframe.points, coarse, fine, start, prior, pair.noise, STEPS[:levels]
    )
    return Tracked(
        found.T, found.affine, pose_information(found.H), int(found.kept), int(found.iterations), index, found.rms,
        pair.noise.pattern == WIDE,
    )  # fmt: skip


def track_roughly(pair: Pair, start: State) -> Tracked:
    """Align a frame with few measurements and nothing held, to see whether there is anything to find from a guess.

    A guess that leads nowhere takes as many steps as there are; so they should be cheap.
    """
    few = np.ascontiguousarray(pair.keyframe.coarse[::ROUGH_STRIDE])
    return track_frame(pair, start, few, Subset(few, ROUGH_PIXELS), FREE, LEVELS)


def track_closely(pair: Pair, tracked: Tracked, information: Array) -> Tracked:
    """Align a frame once more from where it was found, with all spread-out points on the finest levels.

    information: (6, 6) by which that pose holds.
    """
    coarse, start = pair.keyframe.coarse, State(tracked.T_frame_kf, tracked.affine)
    return track_frame(pair, start, coarse, Subset(coarse, pair.keyframe.points.patch.shape[2]), information, CLOSE)


def pose_information(H: Array) -> Array:
    """(6, 6): brightness (last two) marginalised from the (8, 8) normal matrix."""
    # their 2x2 block is inverted by hand: a call of LAPACK costs more than the alignment of a level
    (p, q), (_, r) = H[6:, 6:].tolist()
    across = H[:6, 6:]
    solved = across @ (np.array([[r, -q], [-q, p]]) / (p * r - q * q))
    out: Array = H[:6, :6] - solved @ across.T
    return 0.5 * (out + out.T)
