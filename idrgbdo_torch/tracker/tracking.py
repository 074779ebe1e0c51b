"""Pose of a frame against its keyframe (section 4.2): prediction, prior, alignment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from ..config import Config
from ..frame import Frame, Keyframe
from ..kernels.se3 import inverse, log_se3, retract
from ..measurement import RATE, Noise
from .backends import FUSED, Backend

Array = NDArray[np.float64]
Index = NDArray[np.int64]

STEPS = np.array([8, 10, 12, 12, 12, 12])  # most iterations per level, finest first
AFFINE_PRIOR = np.diag([1.0 / 0.1**2, 1.0 / 10.0**2])  # of gain and gray levels, about the previous frame's


def motion_prior_terms(xi_frame: Tensor, xi_predicted: Tensor, information: Tensor) -> tuple[Tensor, Tensor]:
    """Eq. (19). What the motion prior adds to the normal equations: Sigma_m^-1 and Sigma_m^-1 (x_{t-1} - x_t^(k)).

    xi_frame (..., 6): the frame's motion at this iteration, xi_predicted (..., 6): the previous frame's motion (both
    log(T_t T_{t-1}^-1), constant velocity), information (6, 6): Sigma_m^-1. The prior belongs to the cost that a step
    must lower, not to the entropy that is reported.
    """
    return information, (information @ (xi_predicted - xi_frame)[..., None])[..., 0]


def motion_information(config: Config, dt: float) -> Array:
    """Sigma_m^-1 (6, 6) for a gap of dt seconds: a change of velocity moves the camera by its size times dt."""
    growth = (RATE * dt) * dt
    sigma_v = config.tracking.sigma_velocity * growth
    sigma_w = config.tracking.sigma_turn * growth
    information = np.zeros((6, 6))
    information.flat[::7] = (1.0 / sigma_v**2,) * 3 + (1.0 / sigma_w**2,) * 3
    return information


def turn_rate(T_new: Array, T_old: Array, dt: float) -> Array:
    """Angular velocity (3,) rad/s between two cam_world poses dt seconds apart."""
    turn: Array = log_se3(T_new @ inverse(T_old))[3:] / dt
    return turn


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


def predict(T_a: Array, T_b: Array, ratio: float) -> Array:
    """Constant velocity: the motion from T_b to T_a (cam_world poses), times ratio, once more from T_a."""
    T: Array = retract(ratio * log_se3(T_a @ inverse(T_b)), T_a)
    return T


def track_frame(
    frame: Frame, keyframe: Keyframe, T_guess: Array, affine: Array, index: Index, coarse: Index, prior: Array,
    noise: Noise, levels: int, pixels: int | None = None, backend: Backend = FUSED,
) -> Tracked:  # fmt: skip
    """Align a frame to a keyframe from a guess of T_frame_kf, with the motion prior's information (6, 6) about it.

    index: the points of the finest level; coarse: those of the others, with so many pixels of their patches or all.
    """
    pixels = keyframe.points.patch.shape[2] if pixels is None else pixels
    T, affine, H, rms, _scale, iterations, _seen, kept, _change = backend.alignment.align(
        frame.images, frame.depth, keyframe.frame.intrinsics, keyframe.points, coarse, pixels, index,
        T_guess, affine, prior, inverse(T_guess), AFFINE_PRIOR, noise, STEPS[:levels],
    )  # fmt: skip
    return Tracked(T, affine, pose_information(H), int(kept), int(iterations), index, rms)


def pose_information(H: Array) -> Array:
    """(6, 6): brightness (last two) marginalised from the (8, 8) normal matrix."""
    # their 2x2 block is inverted by hand: a call of LAPACK costs more than the alignment of a level
    (p, q), (_, r) = H[6:, 6:].tolist()
    across = H[:6, 6:]
    solved = across @ (np.array([[r, -q], [-q, p]]) / (p * r - q * q))
    out: Array = H[:6, :6] - solved @ across.T
    return 0.5 * (out + out.T)
