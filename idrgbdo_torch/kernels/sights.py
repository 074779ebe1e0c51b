"""What a sight saw where points of another frame would be: they themselves, nothing, or something else."""

from __future__ import annotations

from math import floor

import numpy as np

from ..measurement import IN_FRONT
from .compiled import exact_kernel
from .photometric import moved

NEAREST_M = 1e-3
MOST_AROUND = 3  # of five pixels around, of which none may say the contrary


@exact_kernel
def look(uv, inv_depth, intrinsics, T, depth, intrinsics_other, reach, gray, intrinsics_gray):
    """Of points (N, 2) px and (N,) 1/m of a frame: (foreign, same, value), (N,) each.

    foreign: the sight went through to something farther there, or met what is not of the world, all around (within
    reach px). same: it saw that depth. value: its gray level there, 0 where gray (h, w) is empty.
    T: (4, 4) to the sight. depth: (h, w) m, 0 unknown, negative where not of the world.
    """
    count = uv.shape[0]
    foreign, same = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    value = np.zeros(count, np.float32)
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    gx, gy, hx, hy = intrinsics_other[0], intrinsics_other[1], intrinsics_other[2], intrinsics_other[3]
    height, width = depth.shape
    for n in range(count):
        d = inv_depth[n]
        if d <= 0.0:
            continue
        x, y, z = moved(T, (uv[n, 0] - cx) / fx, (uv[n, 1] - cy) / fy, d)
        if z < NEAREST_M * d:
            continue
        x, y, z = x / z, y / z, z / d
        u, v = floor(gx * x + hx + 0.5), floor(gy * y + hy + 0.5)
        if u < 0 or v < 0 or u >= width or v >= height:
            continue
        there = np.float64(depth[v, u])
        same[n] = abs(there - z) < IN_FRONT * z
        if not 0.0 < there <= z * (1.0 + IN_FRONT):
            foreign[n] = looked_through(depth, u, v, z, reach)
        if same[n] and gray.size > 0:
            value[n] = between(
                gray, intrinsics_gray[0] * x + intrinsics_gray[2], intrinsics_gray[1] * y + intrinsics_gray[3]
            )
    return foreign, same, value


@exact_kernel
def looked_through(depth, u, v, z, reach):
    """Whether a pixel and its neighbours at a distance say that nothing of the world stands there, z m away."""
    height, width = depth.shape
    against = 0
    for du, dv in ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)):
        there = np.float64(depth[min(max(v + reach * dv, 0), height - 1), min(max(u + reach * du, 0), width - 1)])
        if there > z * (1.0 + IN_FRONT) or (there < 0.0 and z < -there * (1.0 + IN_FRONT)):
            against += 1
        elif there > 0.0:
            return False
    return against >= MOST_AROUND


@exact_kernel
def between(image, u, v):
    """An image at a place in px, between its pixels; its border's beyond it."""
    height, width = image.shape
    u, v = min(max(u, 0.0), width - 1.0), min(max(v, 0.0), height - 1.0)
    left, top = min(int(u), max(width - 2, 0)), min(int(v), max(height - 2, 0))
    right, below = min(left + 1, width - 1), min(top + 1, height - 1)
    across, down = u - left, v - top
    above = (1.0 - across) * image[top, left] + across * image[top, right]
    return (1.0 - down) * above + down * ((1.0 - across) * image[below, left] + across * image[below, right])


@exact_kernel
def sampled(image, uv, scale, shift):
    """(N,) of an image at places (N, 2) px times scale plus shift, as between()."""
    out = np.zeros(uv.shape[0], np.float32)
    for n in range(uv.shape[0]):
        out[n] = between(image, uv[n, 0] * scale + shift, uv[n, 1] * scale + shift)
    return out
