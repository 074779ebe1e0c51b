"""What a point, its patch and their noise are: the ground that definitions/ and kernels/ share.

Every number that both of them need stands here once; neither imports the other.
"""

from __future__ import annotations

from math import dist
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .config import NoiseConfig

Array = NDArray[Any]

PATTERN = np.array(  # (8, 2) px, the residual pattern of DSO, centre first, so that its first pixel is a point alone
    [[0, 0], [0, -2], [-1, -1], [1, -1], [-2, 0], [2, 0], [-1, 1], [0, 2]], dtype=np.float64
)
PATTERN_U, PATTERN_V = np.ascontiguousarray(PATTERN[:, 0]), np.ascontiguousarray(PATTERN[:, 1])
PIXELS = len(PATTERN)
LEVELS = 6  # of every pyramid; tracking starts at its configured one, recovery at the coarsest
COARSE_BLUR = 1.2  # px, standard deviation of the blur of the coarse levels
TIER = 65536.0  # what a candidate's tier is worth: above every squared gradient of an 8-bit image
GRADIENT_NOISE = 0.25  # squared gradient of pure noise over var_intensity, the sensor's share of which is a quarter
RATE = 30.0  # Hz, at which the motion prior and the speed of an image are given


class Noise(NamedTuple):
    """NoiseConfig as the plain numbers that residuals are weighted with."""

    var_intensity: float  # gray levels^2
    var_pixel: float  # px^2, times the number of patch pixels that share it
    var_depth: float  # (1/m)^2, one sensor reading
    shared: float  # number of patch pixels that share one depth error
    c_h: float
    huber: float  # whitened
    outlier: float  # limit of a point's whitened residual, in robust standard deviations
    use_depth: bool
    paper_variance: bool
    gradient_blend: float  # share of the reference gradient in the Jacobian


class Points(NamedTuple):
    """Reference points of one keyframe, a struct of arrays."""

    uv: Array  # (N, 2) float64 px, level 0
    inv_depth: Array  # (N,) float64 1/m
    var_inv_depth: Array  # (N,) float64 (1/m)^2
    patch: Array  # (L, N, P) float32 gray levels
    gradient: Array  # (L, N, P, 2) float32 gray levels/px of the reference


class WindowPoints(NamedTuple):
    """Points of all keyframes, padded to the same number a keyframe."""

    uv: Array  # (K, N, 2) float64 px
    patch: Array  # (K, N, P) float32 gray levels
    gradient: Array  # (K, N, P, 2) float32
    measured: Array  # (K, N) float64 1/m, the sensor's inverse depth
    variance: Array  # (K, N) float64 (1/m)^2 of it
    valid: Array  # (K, N) bool


def kernel_noise(config: NoiseConfig, patch: int = PIXELS) -> Noise:
    """NoiseConfig as plain numbers, for points of so many pixels."""
    shared = float(patch)
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
        gradient_blend=config.gradient_blend,
    )


def with_blur(noise: Noise, config: NoiseConfig, focal: float, turn: Array, turn_kf: Array) -> Noise:
    """The noise of a frame that turns (3,) rad/s against a keyframe that turned otherwise.

    Both images are smeared along their own motion; an edge smeared differently seems to lie elsewhere.
    """
    speed = focal * dist(turn, turn_kf) / RATE  # px a frame
    return noise._replace(var_pixel=noise.var_pixel + noise.shared * (config.blur * speed) ** 2)
