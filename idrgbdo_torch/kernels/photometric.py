"""What all kernels share of a point in a target: where it falls, how that changes, what its residual is trusted with.

A point is m = (mx, my, 1), its pixel in units of the focal length, with the inverse depth d; T is T_target_host. Twins
of photometric.py for one point.
"""

from __future__ import annotations

from math import exp

from .compiled import exact_kernel


@exact_kernel
def photometric_variance(gu, gv, du_dd, dv_dd, var_d, noise):
    """Twin of photometric.photometric_variance (Eq. 8)."""
    if noise.paper_variance:
        return noise.var_intensity + ((gu * du_dd) ** 2 + (gv * dv_dd) ** 2) * var_d
    along = (gu * du_dd + gv * dv_dd) ** 2
    return noise.var_intensity + noise.var_pixel * (gu * gu + gv * gv) + noise.shared * along * var_d


@exact_kernel
def distortion_weight(area, c_h):
    """Twin of photometric.distortion_weight (Eq. 7)."""
    return exp(min(c_h * (area - 1.0) ** 2, 4.0))


@exact_kernel
def moved(T, mx, my, d):
    """R m + t d (3 numbers): the point in the target's axes, times its inverse depth in the host."""
    return (
        T[0, 0] * mx + T[0, 1] * my + T[0, 2] + T[0, 3] * d,
        T[1, 0] * mx + T[1, 1] * my + T[1, 2] + T[1, 3] * d,
        T[2, 0] * mx + T[2, 1] * my + T[2, 2] + T[2, 3] * d,
    )


@exact_kernel
def distortion(T, x, y, iz, fx, fy):
    """dp_target / dp_host at fixed inverse depth, row by row, and its determinant; (x, y, 1) = moved(...) * iz."""
    a00 = (T[0, 0] - x * T[2, 0]) * iz
    a01 = (T[0, 1] - x * T[2, 1]) * iz * fx / fy
    a10 = (T[1, 0] - y * T[2, 0]) * iz * fy / fx
    a11 = (T[1, 1] - y * T[2, 1]) * iz
    return a00, a01, a10, a11, a00 * a11 - a01 * a10


@exact_kernel
def along_depth(T, x, y, iz, fx, fy):
    """(du/dd, dv/dd) in px m: how the pixel moves with the host's inverse depth."""
    return fx * (T[0, 3] - x * T[2, 3]) * iz, fy * (T[1, 3] - y * T[2, 3]) * iz


@exact_kernel
def pose_jacobian(fx, fy, x, y, rho, J):
    """Fill the first six columns of J (2, ...) with duv/d[v, w] of a left increment; rho: inverse depth there."""
    J[0, 0] = fx * rho
    J[0, 1] = 0.0
    J[0, 2] = -fx * rho * x
    J[0, 3] = -fx * x * y
    J[0, 4] = fx * (1.0 + x * x)
    J[0, 5] = -fx * y
    J[1, 0] = 0.0
    J[1, 1] = fy * rho
    J[1, 2] = -fy * rho * y
    J[1, 3] = -fy * (1.0 + y * y)
    J[1, 4] = fy * x * y
    J[1, 5] = fy * x
