"""Candidate points: the fused extraction against slow numpy, depth planes, patches, and what a keyframe holds."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from rendered import Film

from idrgbdo_torch.config import Config, Mode
from idrgbdo_torch.definitions.camera import Pinhole
from idrgbdo_torch.definitions.image import gradient, sample_with_gradient
from idrgbdo_torch.frame import Frame, RgbdFrame, prepare
from idrgbdo_torch.kernels import candidates as fused
from idrgbdo_torch.measurement import COMPACT, PATTERNS, WEAKEST, WIDE, kernel_noise
from idrgbdo_torch.odometry import Status, run
from idrgbdo_torch.synthetic.disturbance import with_holes
from idrgbdo_torch.tracker.backends import backend_named
from idrgbdo_torch.tracker.candidates import (
    BLOCK,
    BORDER,
    CANNY,
    PLANE_RADIUS,
    STRONG,
    THRESHOLD_OFFSET,
    extract_candidates,
    spread_out,
    without_speckles,
)
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo
from idrgbdo_torch.tracker.keyframe import make_keyframe

FUSED = backend_named("fused")
SIGMA = 0.004  # 1/m


@pytest.fixture(scope="module")
def frame(desk: Film) -> Frame:
    return prepare(desk.frames[0])


def with_mode(mode: Mode, **values: object) -> Config:
    return replace(Config(), selection=replace(Config().selection, mode=mode, **values))  # type: ignore[arg-type]


def slow_thresholds(g2: np.ndarray) -> np.ndarray:
    rows, cols = (-(-n // BLOCK) for n in g2.shape)
    raw = np.empty((rows, cols))
    for r, c in np.ndindex(rows, cols):
        block = g2[r * BLOCK : (r + 1) * BLOCK : 2, c * BLOCK : (c + 1) * BLOCK : 2]
        size = np.minimum(63, np.floor(np.sqrt(block))).ravel()
        raw[r, c] = np.sort(size)[len(size) // 2] + THRESHOLD_OFFSET
    smooth = [[raw[max(0, r - 1) : r + 2, max(0, c - 1) : c + 2].mean() for c in range(cols)] for r in range(rows)]
    return np.square(smooth)


def slow_plane(depth: np.ndarray, u: int, v: int) -> float | None:
    """Inverse depth at (u, v) of the least-squares plane; None where there is a hole, a jump or a curve."""
    R = PLANE_RADIUS
    if u < R or v < R or u >= depth.shape[1] - R or v >= depth.shape[0] - R or depth[v, u] == 0:
        return None
    z = depth[v - R : v + R + 1, u - R : u + R + 1].astype(np.float64)
    dv, du = np.mgrid[-R : R + 1, -R : R + 1]
    known = z > 0
    if not known[1:-1, 1:-1].all() or known.sum() < (2 * R + 1) ** 2 * 3 // 4:
        return None
    d = 1 / z[known] - 1 / z[R, R]
    if np.abs(d).max() > max(5 * SIGMA, 0.06 / z[R, R]):
        return None
    J = np.column_stack([np.ones_like(d), du[known], dv[known]])
    fit, *_ = np.linalg.lstsq(J, d, rcond=None)
    if np.mean((d - J @ fit) ** 2) > (2 * SIGMA) ** 2:
        return None
    return float(fit[0] + 1 / z[R, R])


def test_gradients_and_thresholds(frame: Frame) -> None:
    image = frame.images[0]
    g2 = fused.gradient_squared(image)
    expected = gradient(torch.from_numpy(image)).square().sum(0)
    torch.testing.assert_close(torch.from_numpy(g2), expected, rtol=1e-5, atol=1e-5)
    assert g2[0].max() == g2[-1].max() == g2[:, 0].max() == g2[:, -1].max() == 0 < g2.max()
    for part in (g2, g2[:75, :100]):  # blocks that do not fill the last row and column
        np.testing.assert_allclose(fused.block_thresholds(part, BLOCK, THRESHOLD_OFFSET), slow_thresholds(part))


def test_a_depth_plane_is_a_least_squares_fit(frame: Frame) -> None:
    uv = np.random.default_rng(0).integers(0, [320, 240], (1500, 2)).astype(np.float64)
    valid, inv_depth, _ = fused.planes_at(frame.depth, uv, PLANE_RADIUS, SIGMA)
    slow = [slow_plane(frame.depth, int(u), int(v)) for u, v in uv]
    assert valid.tolist() == [d is not None for d in slow]
    assert 0.4 < valid.mean() < 0.95
    np.testing.assert_allclose(inv_depth[valid], [d for d in slow if d is not None], rtol=1e-12)


def test_the_plane_is_exact_on_a_slanted_wall_and_beats_one_reading() -> None:
    rng = np.random.default_rng(0)
    v, u = np.mgrid[:60, :80]
    wall = 0.5 + 0.002 * u - 0.001 * v
    uv = np.column_stack([x.ravel() for x in np.meshgrid(np.arange(5, 75, 5.0), np.arange(5, 55, 5.0))])
    truth = 0.5 + 0.002 * uv[:, 0] - 0.001 * uv[:, 1]
    valid, exact, slope = fused.planes_at((1 / wall).astype(np.float32), uv, PLANE_RADIUS, SIGMA)
    assert valid.all() and np.abs(exact - truth).max() < 1e-6 and np.abs(slope - [0.002, -0.001]).max() < 1e-6
    noisy = (1 / (wall + 0.8 * SIGMA * rng.standard_normal(wall.shape))).astype(np.float32)
    valid, fitted, _ = fused.planes_at(noisy, uv, PLANE_RADIUS, SIGMA)
    assert valid.mean() > 0.9
    assert np.std((fitted - truth)[valid]) < 0.25 * 0.8 * SIGMA  # 1 / 7 for 49 independent readings


def test_a_plane_needs_no_hole_and_no_jump_near_by() -> None:
    depth = np.full((21, 21), 2.0, dtype=np.float32)
    depth[10, 12] = 0.0  # a hole
    depth[:, 18:] = 2.6  # a jump
    at = lambda u, v: bool(fused.planes_at(depth, np.array([[float(u), float(v)]]), PLANE_RADIUS, SIGMA)[0][0])
    assert not at(10, 10) and not at(12, 8) and at(9, 10) and at(12, 7)
    assert not at(15, 4) and at(14, 4)
    assert not at(2, 8) and not at(10, 18)
    depth[5, 3] = 1 / (0.5 + 0.035)  # one reading off by more than noise or a slope could
    assert not at(5, 6) and not at(6, 5) and at(7, 6)


def test_one_candidate_a_cell_the_strongest_of_its_best_tier(frame: Frame) -> None:
    cell = 24
    g2 = fused.gradient_squared(frame.images[0])
    thresholds = fused.block_thresholds(g2, BLOCK, THRESHOLD_OFFSET)
    edges = cv2.Canny(frame.images[0].astype(np.uint8), *CANNY, L2gradient=True)
    scores = fused.candidate_scores(g2, thresholds, BLOCK, edges, frame.depth)
    uv, inv_depth, tier = fused.grid_candidates(scores, frame.depth, cell, BORDER, PLANE_RADIUS, SIGMA)
    limit = np.kron(thresholds, np.ones((BLOCK, BLOCK)))[: g2.shape[0], : g2.shape[1]]
    tiers = np.where(g2 > limit, np.where(edges, 2, 1), np.where(g2 > WEAKEST**2 * limit, 0, -1))
    tiers[frame.depth <= 0] = -1
    height, width = g2.shape
    expected = []
    for v0 in range(BORDER, height - BORDER, cell):
        for u0 in range(BORDER, width - BORDER, cell):
            vs, us = np.mgrid[v0 : min(v0 + cell, height - BORDER), u0 : min(u0 + cell, width - BORDER)]
            order = sorted(
                zip(us.ravel(), vs.ravel(), strict=True), key=lambda p: (-tiers[p[1], p[0]], -g2[p[1], p[0]])
            )
            for u, v in [p for p in order if tiers[p[1], p[0]] >= 0][:6]:  # six tries a cell
                d = slow_plane(frame.depth, u, v)
                if d is not None:
                    expected.append((u, v, d, tiers[v, u]))
                    break
    assert len(expected) > 60
    np.testing.assert_allclose(np.column_stack([uv, inv_depth, tier]), expected, rtol=1e-12)
    assert set(tier) == {0, 1, 2}


def test_where_there_is_enough_strong_texture_no_weak_one_is_taken(frame: Frame) -> None:
    g2 = fused.gradient_squared(frame.images[0])
    thresholds = fused.block_thresholds(g2, BLOCK, THRESHOLD_OFFSET)
    few, many = (
        extract_candidates(
            frame,
            replace(Config(), selection=replace(Config().selection, candidates=count)),
            np.random.default_rng(0),
            FUSED,
        )
        for count in (600, 6000)
    )
    for (uv, *_), weak in ((few, False), (many, True)):  # 6000 are more than there are
        u, v = uv.astype(int).T
        assert (g2[v, u] <= STRONG**2 * thresholds[v // BLOCK, u // BLOCK]).any() == weak


def test_where_there_is_little_texture_weak_texture_is_taken() -> None:
    """On a bare wall the threshold is 7 gray levels a px: faint smears of 2 are all there is, noise of 1 is nothing."""
    u = np.arange(320) % 64
    smears = np.tile(2.2 * np.minimum(np.minimum(u, 16 - u).clip(0), 8), (240, 1)).astype(np.float32)
    wall, camera = torch.full((240, 320), 2.0), Pinhole(width=320, height=240, fx=262.5, fy=262.5, cx=159.5, cy=119.5)
    for size, found in ((1.0, True), (0.5, False)):
        gray = torch.from_numpy(100 + np.float32(size) * smears)
        frame = prepare(RgbdFrame(0.0, gray, wall, camera))
        uv, *_ = extract_candidates(frame, Config(), np.random.default_rng(0), FUSED)
        assert (len(uv) > 50) == found
        assert not found or (u[uv[:, 0].astype(int)] < 17).all()


def test_patches_are_samples_of_every_level(frame: Frame) -> None:
    uv = np.random.default_rng(0).uniform([60, 60], [260, 180], (40, 2))
    patch, g = np.zeros((4, 40, 8), np.float32), np.zeros((4, 40, 8, 2), np.float32)
    fused.sample_patches(frame.images, uv, np.arange(40), 0, 4, WIDE, patch, g)
    for level in range(4):
        at = ((uv + 0.5) * 0.5**level - 0.5)[:, None] + PATTERNS[COMPACT if level else WIDE]
        value, slope, valid = sample_with_gradient(torch.from_numpy(frame.images[level]), torch.from_numpy(at))
        assert valid.all()
        torch.testing.assert_close(torch.from_numpy(patch[level]), value.float())
        torch.testing.assert_close(torch.from_numpy(g[level]), slope.float(), rtol=1e-5, atol=1e-4)
    corner, g = np.zeros((6, 1, 8), np.float32), np.zeros((6, 1, 8, 2), np.float32)
    fused.sample_patches(frame.images, np.array([[4.0, 4.0]]), np.arange(1), 0, 6, WIDE, corner, g)
    assert np.isfinite(corner).all() and (corner > 0).all()


@pytest.mark.parametrize("mode", ["rand", "grid", "inf", "inf+grid"])
def test_what_a_keyframe_holds(frame: Frame, mode: Mode) -> None:
    config = with_mode(mode, candidates=600)
    keyframe = make_keyframe(frame, config, np.random.default_rng(0), FUSED)
    points, n = keyframe.points, len(keyframe.points.uv)
    assert (300 < n <= 600) if mode == "rand" else n > 150
    u, v = points.uv.T
    assert u.min() >= BORDER and v.min() >= BORDER and u.max() < 320 - BORDER and v.max() < 240 - BORDER
    assert len(np.unique(points.uv, axis=0)) == n
    assert keyframe.radius.min() >= 0 and keyframe.radius.max() == pytest.approx(1)
    measured = frame.depth[v.astype(int), u.astype(int)]
    assert np.abs(points.inv_depth * measured - 1).max() < 0.06
    assert np.array_equal(points.inv_depth, keyframe.measured)  # not refined yet
    np.testing.assert_allclose(points.var_inv_depth, kernel_noise(config.noise).var_depth)
    coarse = keyframe.coarse
    assert len(np.unique(coarse)) == len(coarse) <= config.tracking.points_coarse
    again = make_keyframe(frame, config, np.random.default_rng(0), FUSED)
    assert np.array_equal(again.points.uv, points.uv) and np.array_equal(again.coarse, coarse)
    other = make_keyframe(frame, config, np.random.default_rng(1), FUSED)
    assert np.array_equal(other.points.uv, points.uv) == (mode != "rand")


def test_inf_has_the_most_to_choose_from(frame: Frame) -> None:
    counts = {}
    for mode in ("grid", "inf", "inf+grid"):
        keyframe = make_keyframe(frame, with_mode(mode, candidates=300), np.random.default_rng(0), FUSED)
        counts[mode] = len(keyframe.points.uv)
    assert counts["grid"] == counts["inf+grid"] < 0.5 * counts["inf"]


def test_spreading_out_covers_the_image() -> None:
    rng = np.random.default_rng(0)
    uv = np.concatenate([rng.uniform(0, 40, (900, 2)), rng.uniform([0, 0], [320, 240], (300, 2))])
    chosen = spread_out(uv, 100, 320, 240, FUSED)
    assert len(np.unique(chosen)) == 100
    in_corner = (uv[chosen] < 40).all(axis=1).mean()
    assert in_corner < 0.25  # the corner holds three quarters of the points, a fiftieth of the image
    assert spread_out(uv[:50], 100, 320, 240, FUSED).tolist() == list(range(50))


def test_an_image_without_depth_has_no_candidates(frame: Frame) -> None:
    for mode in ("rand", "inf+grid"):
        blind = replace(frame, depth=np.zeros_like(frame.depth))
        keyframe = make_keyframe(blind, with_mode(mode), np.random.default_rng(0), FUSED)
        assert len(keyframe.points.uv) == len(keyframe.coarse) == 0


@pytest.mark.parametrize("share", [0.2, 0.3])
def test_holes_by_chance_leave_enough_to_track(desk: Film, share: float) -> None:
    """Stereo sensors lack the depth of one pixel in five; no 7 x 7 pixels are whole then."""
    rng = np.random.default_rng(0)
    done = run(IdRgbdo(), [with_holes(frame, share, rng) for frame in desk.frames[:12]])
    assert done.statuses == (Status.OK,) * 12
    assert float((done.records[-1].result.T_world_cam[:3, 3] - desk.T(0, 11)[:3, 3]).norm()) < 0.005


def test_only_depth_with_many_small_holes_is_closed() -> None:
    depth = np.full((60, 80), 2.0, np.float32)
    depth[:, 40:] = 3.0
    depth[10:30, 10:20] = 0.0
    assert without_speckles(depth) is depth
    holes = np.random.default_rng(0).random(depth.shape) < 0.2
    closed = without_speckles(np.where(holes, np.float32(0.0), depth))
    assert (closed[10:30, 10:20] == 0.0).mean() > 0.6  # a shadow stays
    small = holes & (depth > 0.0)
    small[:, 38:42] = small[8:32, 8:22] = False
    assert (closed[small] > 0.0).mean() > 0.9 and np.abs(closed - depth)[small & (closed > 0.0)].max() < 1e-6


def test_holes_are_counted_that_stand_alone() -> None:
    depth = np.full((9, 12), 2.0, np.float32)
    depth[1, 3] = depth[5, 1] = depth[5, 10] = depth[2, 6] = 0.0  # the last in a row that is not looked at
    depth[5, 5:7] = 0.0  # two are a shadow, as is what touches one
    assert fused.isolated_holes(depth, 4) == 3 / (2 * 10)
    assert fused.isolated_holes(depth, 1) == 4 / (7 * 10)
    assert fused.isolated_holes(np.zeros((2, 12), np.float32), 4) == 0.0
