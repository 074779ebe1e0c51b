"""The loops of registration give numpy's bits: they only do in one call what took twenty."""

from __future__ import annotations

import cv2
import numpy as np

from idrgbdo_torch.datasets.rectify import SURFACE, sampled
from idrgbdo_torch.datasets.reproject import reproject

RNG = np.random.default_rng(5)
HEIGHT, WIDTH = 48, 64  # of the image that depth is carried into


def depth_image(height: int, width: int) -> np.ndarray:
    """Two walls, noise on both, holes."""
    depth = np.where(np.arange(width) < width // 2, 1.2, 2.5) * np.ones((height, 1))
    depth = depth + 0.004 * RNG.standard_normal((height, width))
    depth[RNG.random((height, width)) < 0.1] = 0
    return depth.astype(np.float32)


def test_the_nearest_depth_of_each_pixel_is_seen() -> None:
    depth = depth_image(60, 80)
    v, u = np.indices(depth.shape)
    rays = np.stack([(u - 40) / 60, (v - 30) / 60, np.ones(depth.shape)]).astype(np.float32)
    t, intrinsics = np.array([0.11, -0.03, -1.21], np.float32), np.array([20, 21, 31.5, 23.5], np.float32)
    seen = np.zeros((HEIGHT, WIDTH), np.float32)
    reproject(depth, rays, t, intrinsics, seen)

    x, y, z = (rays * depth + t[:, None, None]).reshape(3, -1)
    ahead = (depth.ravel() > 0) & (z > 0)
    assert np.count_nonzero(depth.ravel() > 0) - np.count_nonzero(ahead) > 0  # some end up behind the camera
    x, y, z = x[ahead], y[ahead], z[ahead]
    fx, fy, cx, cy = intrinsics
    column, row = np.rint(fx * x / z + cx), np.rint(fy * y / z + cy)
    inside = (column >= 0) & (column < WIDTH) & (row >= 0) & (row < HEIGHT)
    nearest = np.full((HEIGHT, WIDTH), np.inf, np.float32)
    np.minimum.at(nearest, (row[inside].astype(int), column[inside].astype(int)), z[inside])
    np.testing.assert_array_equal(seen, np.where(np.isfinite(nearest), nearest, 0))
    assert 0 < np.count_nonzero(seen) < np.count_nonzero(inside)  # several fell on one pixel


def test_depth_is_interpolated_within_a_surface_only() -> None:
    depth = depth_image(24, 32)
    map_u = np.linspace(-2, 34, WIDTH, dtype=np.float32) * np.ones((HEIGHT, 1), np.float32)
    map_v = np.linspace(-2, 26, HEIGHT, dtype=np.float32)[:, None] * np.ones((1, WIDTH), np.float32)
    nearest = cv2.remap(depth, map_u, map_v, cv2.INTER_NEAREST)
    between = cv2.remap(depth, map_u, map_v, cv2.INTER_LINEAR)
    blocks = np.lib.stride_tricks.sliding_window_view(depth, (2, 2)).reshape(23, 31, 4)
    smooth = (blocks.min(-1) > 0) & (blocks.max(-1) < np.float32(SURFACE) * blocks.min(-1))
    u, v = np.floor(map_u).astype(int), np.floor(map_v).astype(int)
    inside = (u >= 0) & (v >= 0) & (u < 31) & (v < 23)
    surface = inside & smooth[v.clip(0, 22), u.clip(0, 30)]
    assert 0 < np.count_nonzero(surface) < np.count_nonzero(inside)
    np.testing.assert_array_equal(sampled(depth, map_u, map_v, smooth=True), np.where(surface, between, nearest))
    np.testing.assert_array_equal(sampled(depth, map_u, map_v, smooth=False), nearest)
