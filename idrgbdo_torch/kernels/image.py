"""Image sampling for the fused kernels (twin of image.sample_with_gradient, Eq. 9)."""

from __future__ import annotations

from math import floor

import numpy as np

from .compiled import exact_kernel


@exact_kernel
def sample(image, u, v):
    """Bilinear value and central-difference gradient, (valid, value, g_u, g_v), at pixel (u, v)."""
    height, width = image.shape
    if not (u >= 1.0 and v >= 1.0 and u < width - 2.0 and v < height - 2.0):
        return False, 0.0, 0.0, 0.0
    iu = np.uint64(u)  # unsigned: no check for negative indices
    iv = np.uint64(v)
    fu = u - np.float64(iu)
    fv = v - np.float64(iv)
    one = np.uint64(1)
    two = np.uint64(2)
    i00 = np.float64(image[iv, iu])
    i01 = np.float64(image[iv, iu + one])
    i10 = np.float64(image[iv + one, iu])
    i11 = np.float64(image[iv + one, iu + one])
    left = (np.float64(image[iv, iu - one]), np.float64(image[iv + one, iu - one]))
    right = (np.float64(image[iv, iu + two]), np.float64(image[iv + one, iu + two]))
    up = (np.float64(image[iv - one, iu]), np.float64(image[iv - one, iu + one]))
    down = (np.float64(image[iv + two, iu]), np.float64(image[iv + two, iu + one]))
    value, g_u, g_v = interpolate((i00, i01, i10, i11, *left, *right, *up, *down), fu, fv)
    return True, value, g_u, g_v


@exact_kernel
def interpolate(around, fu, fv):
    """Bilinear value and gradient from twelve pixels: the four of the cell, then two left, right, above and below it.

    The gradient is half the difference of the bilinear samples one pixel to either side.
    """
    i00, i01, i10, i11, left0, left1, right0, right1, up0, up1, down0, down1 = around
    top = i00 + fu * (i01 - i00)
    bottom = i10 + fu * (i11 - i10)
    value = top + fv * (bottom - top)
    g_top = (1.0 - fu) * (i01 - left0) + fu * (right0 - i00)
    g_bottom = (1.0 - fu) * (i11 - left1) + fu * (right1 - i10)
    g_u = 0.5 * (g_top + fv * (g_bottom - g_top))
    g_left = (1.0 - fv) * (i10 - up0) + fv * (down0 - i00)
    g_right = (1.0 - fv) * (i11 - up1) + fv * (down1 - i01)
    g_v = 0.5 * (g_left + fu * (g_right - g_left))
    return value, g_u, g_v


@exact_kernel
def sample_inverse_depth(depth, u, v, agreement):
    """Bilinear inverse depth and its gradient, (valid, d, g_u, g_v); valid where the four neighbours agree."""
    height, width = depth.shape
    if not (u >= 0.0 and v >= 0.0 and u < width - 1.0 and v < height - 1.0):
        return False, 0.0, 0.0, 0.0
    iu = floor(u)
    iv = floor(v)
    z00 = np.float64(depth[iv, iu])
    z01 = np.float64(depth[iv, iu + 1])
    z10 = np.float64(depth[iv + 1, iu])
    z11 = np.float64(depth[iv + 1, iu + 1])
    lowest = min(min(z00, z01), min(z10, z11))
    highest = max(max(z00, z01), max(z10, z11))
    if lowest <= 0.0 or highest - lowest > agreement * lowest:
        return False, 0.0, 0.0, 0.0
    fu = u - iu
    fv = v - iv
    d00 = 1.0 / z00
    d01 = 1.0 / z01
    d10 = 1.0 / z10
    d11 = 1.0 / z11
    top = d00 + fu * (d01 - d00)
    bottom = d10 + fu * (d11 - d10)
    g_u = (1.0 - fv) * (d01 - d00) + fv * (d11 - d10)
    g_v = (1.0 - fu) * (d10 - d00) + fu * (d11 - d01)
    return True, top + fv * (bottom - top), g_u, g_v
