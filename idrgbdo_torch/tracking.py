"""Pose of a frame against its keyframe (section 4.2): prediction, prior, alignment, verification."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .config import Config, NoiseConfig
from .frame import Frame, Keyframe
from .kernels import alignment, choice
from .kernels.alignment import Noise
from .kernels.lie import inverse, log_se3, retract

Array = NDArray[np.float64]
Index = NDArray[np.int64]

STEPS = np.array([8, 10, 12, 12, 12, 12])  # most iterations per level, finest first


def kernel_noise(config: NoiseConfig) -> Noise:
    """NoiseConfig as the plain numbers that the kernels read."""
    shared = float(choice.PIXELS)
    return Noise(
        var_intensity=config.sigma_intensity**2,
        var_pixel=shared * config.sigma_pixel**2,
        var_depth=(config.sigma_disparity / config.focal_baseline) ** 2,
        shared=shared,
        c_h=config.c_h,
        huber=config.huber / config.sigma_intensity,
        outlier=config.outlier,
        use_depth=config.depth_residual,
        paper_variance=config.variance == "paper",
        blend=config.blend,
    )


@dataclass(frozen=True)
class Tracked:
    """One alignment to a keyframe."""

    T_frame_kf: Array  # (4, 4)
    affine: Array  # (2,) a, b of the frame relative to the keyframe
    information: Array  # (6, 6) of a left increment of T_frame_kf, brightness marginalised, prior excluded
    points: int  # used
    kept: float  # share of the chosen points within the outlier limit
    iterations: int
    scale: float  # robust scale of the whitened residuals
    index: Index  # chosen candidates
    rms: Array  # whitened residual of each, -1 unseen


def track_frame(
    frame: Frame, keyframe: Keyframe, T0: Array, affine0: Array, index: Index, coarse: Index, prior: Array, config: Config,
    noise: Noise, T_prior: Array | None = None,
) -> Tracked:  # fmt: skip
    """Align a frame to a keyframe from the guess T0 with the motion prior's information (6, 6) about T_prior."""
    steps = STEPS[: len(frame.images)]
    T_prior = T0 if T_prior is None else T_prior
    T, affine, H, rms, scale, iterations, seen, kept, _change = alignment.align(
        frame.images, frame.depth, keyframe.frame.intrinsics, keyframe.points, coarse, index,
        T0, affine0, prior, inverse(T_prior), AFFINE_PRIOR, noise, steps,
    )  # fmt: skip
    return Tracked(
        T, affine, pose_information(H), int(kept), kept / max(len(index), 1), int(iterations), float(scale), index, rms
    )


AFFINE_PRIOR = np.array([1.0 / 0.1**2, 1.0 / 10.0**2])  # of the brightness about the previous frame's: gain, gray levels


def pose_information(H: Array) -> Array:
    """(6, 6): brightness (last two) marginalised from the (8, 8) normal matrix."""
    corner = H[6:, 6:] + np.diag([1e-6, 1e-9])
    out: Array = H[:6, :6] - H[:6, 6:] @ np.linalg.solve(corner, H[6:, :6])
    return 0.5 * (out + out.T)


def predict(T_a: Array, T_b: Array, ratio: float) -> Array:
    """Constant velocity: the motion from b to a (both T_cam_world-like), times ratio, applied to a."""
    return retract(ratio * log_se3(T_a @ inverse(T_b)), T_a)
