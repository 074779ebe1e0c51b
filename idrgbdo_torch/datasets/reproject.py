"""The loops that carry depth into another camera, each in one call that does not hold Python's lock."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..kernels.compiled import exact_kernel


@exact_kernel
def reproject(depth: Any, rays: Any, t: Any, intrinsics: Any, seen: Any) -> None:
    """Put the nearest depth that falls on each pixel into seen, (H, W) float32 m, all 0 before.

    depth: (h, w) float32 m. rays: (3, h, w) float32, points at depth 1, turned as the other camera. t: (3,) float32 m,
    where the first camera is in the other. intrinsics: (4,) float32 fx fy cx cy of the other.
    """
    height, width = seen.shape
    for row in range(depth.shape[0]):
        for column in range(depth.shape[1]):
            d = depth[row, column]
            z = rays[2, row, column] * d + t[2]
            if not (d > 0 and z > 0):
                continue
            u = np.rint(intrinsics[0] * (rays[0, row, column] * d + t[0]) / z + intrinsics[2])
            v = np.rint(intrinsics[1] * (rays[1, row, column] * d + t[1]) / z + intrinsics[3])
            if u >= 0 and u < width and v >= 0 and v < height:
                at = np.int64(v), np.int64(u)
                if seen[at] == 0 or z < seen[at]:
                    seen[at] = z


@exact_kernel
def interpolate_surfaces(depth: Any, map_u: Any, map_v: Any, most: Any, between: Any, sampled: Any) -> None:
    """Take `between` instead of `sampled`, both (H, W) float32 m, where the four pixels around are of one surface.

    depth: (h, w) float32 m. map_u, map_v: (H, W) float32 places in it. most: what the largest of four depths may be
    times the smallest.
    """
    height, width = depth.shape
    for row in range(sampled.shape[0]):
        for column in range(sampled.shape[1]):
            u = map_u[row, column]
            v = map_v[row, column]
            if not (u >= 0 and v >= 0 and u < width - 1 and v < height - 1):
                continue
            left = np.int64(u)
            top = np.int64(v)
            a = depth[top, left]
            b = depth[top, left + 1]
            c = depth[top + 1, left]
            d = depth[top + 1, left + 1]
            low = min(min(a, b), min(c, d))
            if low > 0 and max(max(a, b), max(c, d)) < most * low:
                sampled[row, column] = between[row, column]
