"""Candidate points of a keyframe (section 4.1, steps 1 and 2): high gradient, on a grid, Canny edges first."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from ..config import Config
from ..frame import Frame
from ..kernels.candidates import isolated_holes
from ..measurement import inverse_depth_sigma
from .backends import Backend
from .selection import grid_cells

Array = NDArray[np.float64]
Index = NDArray[np.int64]

BLOCK = 32  # px, region of the adaptive threshold (DSO)
THRESHOLD_OFFSET = 7.0  # gray levels above the region's median gradient (DSO)
CANNY = (50, 200)  # gray levels (RGBDTAM)
STRONG = 0.5  # share of the threshold's gradient that a candidate has
ENOUGH = 0.5  # share of the candidates that are wanted, under which weaker ones are taken too
PLANE_RADIUS = 3  # px, neighbourhood that a point's inverse depth is fitted to
BORDER = 4  # px, room for the patch and its gradients
EVERYWHERE = 8  # px, side of a grid cell in mode "inf": as good as no grid, without patches on top of each other
LEAST = 3  # px, the smallest
SPECKLED = 0.02  # share of pixels that are holes of one pixel, from which on such holes are closed
LOOK = 4  # every so many rows are looked at for them
AROUND = 4  # of the eight neighbours that must have depth, and agree,
STEP_SHARE = 0.05  # by this share of it
ROWS = 15  # of such cells at least, which small images get by smaller ones


def extract_candidates(frame: Frame, config: Config, rng: Generator, backend: Backend) -> tuple[Array, Array, Array]:
    """uv (N, 2), inverse depth (N,) of the pixels worth choosing from, and its slope (N, 2) where that is asked.

    rand takes any pixel with depth.
    """
    mode = config.selection.mode
    sigma = inverse_depth_sigma(config.noise.focal_baseline, config.noise.sigma_disparity)
    depth = without_speckles(frame.depth)
    height, width = depth.shape
    if mode == "rand":
        tries = 2 * config.candidates
        u = rng.integers(BORDER, width - BORDER, tries)
        v = rng.integers(BORDER, height - BORDER, tries)
        uv: Array = rng.permutation(np.unique(np.column_stack([u, v]), axis=0)).astype(np.float64)
        valid, inv_depth, slope = backend.planes_at(depth, uv, PLANE_RADIUS, sigma)
        keep = np.flatnonzero(valid)[: config.candidates]
        return uv[keep], inv_depth[keep], slope[keep] * config.tracking.slant
    gradient2 = backend.gradient_squared(frame.images[0])
    thresholds = backend.block_thresholds(gradient2, BLOCK, THRESHOLD_OFFSET)
    with np.errstate(invalid="ignore"):  # of pixels that are no numbers
        pixels = frame.images[0].astype(np.uint8)
    edges = cv2.Canny(pixels, *CANNY, L2gradient=True)
    everywhere = max(LEAST, min(EVERYWHERE, min(width, height) // ROWS))
    grid = max(everywhere, round(float(np.sqrt(width * height / config.candidates))))
    cell = everywhere if mode == "inf" else grid
    scores = backend.candidate_scores(gradient2, thresholds, BLOCK, edges, depth)
    uv, inv_depth, _ = backend.grid_candidates(scores, depth, cell, BORDER, PLANE_RADIUS, sigma)
    u, v = uv.astype(np.int64).T
    strong = gradient2[v, u] > STRONG**2 * thresholds[v // BLOCK, u // BLOCK]
    enough = strong.sum() >= ENOUGH * config.candidates
    if enough:
        uv, inv_depth = uv[strong], inv_depth[strong]
    slanted = config.tracking.slant
    slope = backend.planes_at(depth, uv, PLANE_RADIUS, sigma)[2] if slanted else np.zeros((len(uv), 2))
    return uv, inv_depth, slope


def without_speckles(depth: Array) -> Array:
    """A depth image (H, W) whose holes of one pixel are closed where they are so many that they leave no whole
    neighbourhood to fit a plane to, as with stereo sensors; any other is given back as it is.
    """
    if not isolated_holes(depth, LOOK) > SPECKLED:
        return depth
    hole = depth <= 0.0
    count = cv2.boxFilter((~hole).astype(np.float32), -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    total = cv2.boxFilter(depth, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    nearest = cv2.erode(np.where(hole, np.float32(np.inf), depth), np.ones((3, 3), np.uint8))
    flat = cv2.dilate(depth, np.ones((3, 3), np.uint8)) - nearest < STEP_SHARE * nearest
    closed = hole & (count >= AROUND) & flat
    return np.where(closed, total / np.maximum(count, 1.0), depth)


def spread_out(uv: Array, count: int, width: int, height: int, backend: Backend) -> Index:
    """About `count` indices spread evenly over the image, always the same ones."""
    if len(uv) <= count:
        return np.arange(len(uv))
    order = np.random.default_rng(0).permutation(len(uv))
    return backend.first_of_cells(grid_cells(uv, count, width, height), order, count)
