"""What all kernels share: the patch pattern, the noise, the points, and the variance of a residual."""

from __future__ import annotations

from math import exp
from typing import NamedTuple

import numpy as np

from .compiled import kernel

PATTERN_U = np.array([0.0, 0.0, -1.0, 1.0, -2.0, 2.0, -1.0, 0.0])
PATTERN_V = np.array([0.0, -2.0, -1.0, -1.0, 0.0, 0.0, 1.0, 2.0])


class Noise(NamedTuple):
    """What the kernels need of NoiseConfig, as plain numbers."""

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
    """Struct of arrays of reference points."""

    uv: np.ndarray  # (N, 2) float64 px, level 0
    inv_depth: np.ndarray  # (N,) float64 1/m
    var_inv_depth: np.ndarray  # (N,) float64 (1/m)^2
    patch: np.ndarray  # (L, N, P) float32 gray levels
    gradient: np.ndarray  # (L, N, P, 2) float32 gray levels/px of the reference


@kernel
def photometric_variance(gu, gv, du_dd, dv_dd, var_d, noise):
    """Twin of photometric.photometric_variance (Eq. 8)."""
    if noise.paper_variance:
        return noise.var_intensity + ((gu * du_dd) ** 2 + (gv * dv_dd) ** 2) * var_d
    along = (gu * du_dd + gv * dv_dd) ** 2
    return noise.var_intensity + noise.var_pixel * (gu * gu + gv * gv) + noise.shared * along * var_d


@kernel
def distortion_weight(area, c_h):
    """Twin of photometric.distortion_weight (Eq. 7)."""
    return exp(min(c_h * (area - 1.0) ** 2, 4.0))
