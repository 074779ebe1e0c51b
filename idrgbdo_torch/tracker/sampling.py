"""Bilinear samples of many points at once in numpy, for what is not worth a kernel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

AGREEMENT = 0.05  # relative spread of four neighbouring inverse depths that count as one surface
AROUND = (
    (0, 0),
    (1, 0),
    (0, 1),
    (1, 1),
    (-1, 0),
    (-1, 1),
    (2, 0),
    (2, 1),
    (0, -1),
    (1, -1),
    (0, 2),
    (1, 2),
)  # [right, down] of pixels that a value and its gradients need


def sampled(image: NDArray[np.float32], u: Array, v: Array) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Bilinear values, gradients right and down, and where they can be had; image (H, W), all else of one shape."""
    height, width = image.shape
    inside = (u >= 1.0) & (v >= 1.0) & (u < width - 2.0) & (v < height - 2.0)
    u, v = np.where(inside, u, 1.0), np.where(inside, v, 1.0)
    column, row = u.astype(np.int64), v.astype(np.int64)
    a, b = u - column, v - row
    at = row * width + column
    flat = image.ravel()
    p00, p10, p01, p11, l0, l1, r0, r1, t0, t1, b0, b1 = (
        flat[at + (down * width + right)].astype(np.float64) for right, down in AROUND
    )
    middle, next_, before, after = p00 + b * (p01 - p00), p10 + b * (p11 - p10), l0 + b * (l1 - l0), r0 + b * (r1 - r0)
    value = middle + a * (next_ - middle)
    right = 0.5 * (next_ + a * (after - next_) - before - a * (middle - before))
    upper, lower = p00 + a * (p10 - p00), p01 + a * (p11 - p01)
    above, below = t0 + a * (t1 - t0), b0 + a * (b1 - b0)
    down = 0.5 * (lower + b * (below - lower) - above - b * (upper - above))
    return value, right, down, inside


def sampled_surface(depth: NDArray[np.float32], u: Array, v: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Bilinear inverse depths (N,) at pixels, and where their four neighbours are of one surface."""
    height, width = depth.shape
    inside = (u >= 0.0) & (v >= 0.0) & (u < width - 1.0) & (v < height - 1.0)
    u, v = np.where(inside, u, 0.0), np.where(inside, v, 0.0)
    column, row = u.astype(np.int64), v.astype(np.int64)
    cells = np.stack([depth[row + down, column + right] for right, down in AROUND[:4]]).astype(np.float64)
    near, far = cells.min(0), cells.max(0)
    good = inside & (near > 0.0) & (far <= (1.0 + AGREEMENT) * near)
    d = 1.0 / np.where(good, cells, 1.0)
    a, b = u - column, v - row
    upper, lower = d[0] + a * (d[1] - d[0]), d[2] + a * (d[3] - d[2])
    return upper + b * (lower - upper), good
