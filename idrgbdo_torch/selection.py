"""Which points to track (section 4.1): candidates of a keyframe, the four modes, Algorithm 1."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from .config import Config
from .frame import Frame, Keyframe
from .kernels import candidates as fused
from .kernels import choice
from .kernels.alignment import Noise, Points

Array = NDArray[np.float64]
Index = NDArray[np.int64]

BLOCK = 32  # px, region of the adaptive threshold (DSO)
THRESHOLD_OFFSET = 7.0  # gray levels above the region's median gradient (DSO)
CANNY = (50, 200)  # gray levels (RGBDTAM)
PLANE_RADIUS = 3  # px, neighbourhood of a point's inverse depth
BORDER = 4  # px, room for the patch and its gradients


def make_keyframe(frame: Frame, config: Config, rng: Generator) -> Keyframe:
    """Extract the candidates of a frame (steps 1 and 2) and everything that tracking needs of them."""
    uv, inv_depth, tier = extract_candidates(frame, config, rng)
    sigma = config.noise.sigma_disparity / config.noise.focal_baseline
    patch, gradient = fused.sample_patches(frame.images, uv, choice.PIXELS)
    camera = frame.camera
    radius = np.hypot(uv[:, 0] - camera.cx, uv[:, 1] - camera.cy)
    radius /= max(radius.max(initial=0.0), 1.0)
    var = np.full(len(uv), (config.noise.point_depth * sigma) ** 2)
    points = Points(uv, inv_depth, var, patch, gradient)
    coarse = spread_out(uv, config.tracking.points_coarse, camera.width, camera.height)
    return Keyframe(frame, points, radius, tier, coarse)


def extract_candidates(frame: Frame, config: Config, rng: Generator) -> tuple[Array, Array, Index]:
    """uv (N, 2), inverse depth (N,), tier (N,) of the pixels worth choosing from."""
    mode = config.selection.mode
    sigma = config.noise.sigma_disparity / config.noise.focal_baseline
    height, width = frame.depth.shape
    if mode == "rand":
        tries = 2 * config.selection.candidates
        uv = np.column_stack(
            [rng.integers(BORDER, width - BORDER, tries), rng.integers(BORDER, height - BORDER, tries)]
        ).astype(np.float64)
        valid, inv_depth = fused.planes_at(frame.depth, uv, PLANE_RADIUS, sigma)
        keep = np.flatnonzero(valid)[: config.selection.candidates]
        return uv[keep], inv_depth[keep], np.zeros(len(keep), dtype=np.int64)
    gradient2 = fused.gradient_squared(frame.images[0])
    thresholds = fused.block_thresholds(gradient2, BLOCK, THRESHOLD_OFFSET)
    gray = frame.images[0].astype(np.uint8)
    edges = cv2.Canny(gray, *CANNY, L2gradient=True) > 0
    cell = 4 if mode == "inf" else max(4, round(float(np.sqrt(width * height / config.selection.candidates))))
    return fused.grid_candidates(gradient2, thresholds, BLOCK, edges, frame.depth, cell, BORDER, PLANE_RADIUS, sigma)


def spread_out(uv: Array, count: int, width: int, height: int) -> Index:
    """About `count` indices spread evenly over the image, deterministic."""
    if len(uv) <= count:
        return np.arange(len(uv))
    cell = float(np.sqrt(width * height / count))
    keys = (uv[:, 1] // cell).astype(np.int64) * 10_000 + (uv[:, 0] // cell).astype(np.int64)
    order = np.random.default_rng(0).permutation(len(uv))
    _, first = np.unique(keys[order], return_index=True)
    chosen = order[first]
    rest = np.setdiff1d(order, chosen, assume_unique=True)
    return np.sort(np.concatenate([chosen, rest[: max(0, count - len(chosen))]])[:count])


def select_points(
    keyframe: Keyframe, T_frame_kf: Array, config: Config, noise: Noise, information: Array, rng: Generator, m: int
) -> Index:
    """At most m candidate indices for the predicted pose, by the configured mode."""
    camera = keyframe.frame.camera
    everyone = np.arange(len(keyframe.points.uv))
    A, seen, where = choice.whitened_rows(
        keyframe.frame.intrinsics[0], camera.width, camera.height, config.selection.margin,
        keyframe.points, everyone, T_frame_kf, noise,
    )  # fmt: skip
    mode = config.selection.mode
    if mode == "rand":
        visible = np.flatnonzero(seen)
        return np.sort(rng.permutation(visible)[:m])
    if mode == "grid":
        return grid_choice(where, seen, keyframe, m)
    return choice.select(
        A, seen, where, keyframe.radius, m, information, config.selection.spread, 25.0, config.selection.distance
    )


def grid_choice(where: Array, seen: NDArray[np.bool_], keyframe: Keyframe, m: int) -> Index:
    """The strongest visible gradient of each of m grid cells, then the strongest of the rest."""
    visible = np.flatnonzero(seen)
    camera = keyframe.frame.camera
    cell = float(np.sqrt(camera.width * camera.height / max(m, 1)))
    keys = (where[visible, 1] // cell).astype(np.int64) * 10_000 + (where[visible, 0] // cell).astype(np.int64)
    strength = (keyframe.points.gradient[0, visible, 0] ** 2).sum(axis=1)
    order = visible[np.argsort(-strength, kind="stable")]
    _, first = np.unique(keys[np.argsort(-strength, kind="stable")], return_index=True)
    cells = order[np.sort(first)]
    rest = order[~np.isin(order, cells)]
    return np.concatenate([cells, rest])[:m]
