"""The torch backend against the fused kernels: function by function, then a whole sequence."""

from __future__ import annotations

import inspect
import pickle
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numba
import numpy as np
import pytest
import torch
from plane_scene import close
from rendered import SMALL, Film, film
from tracking_cases import CONFIG, NOISE, PRIOR, Case, make_cases
from window_cases import Desk, make_desk

from idrgbdo_torch import IdRgbdo, Status, kernels, run, torch_backend
from idrgbdo_torch.config import Config, Mode
from idrgbdo_torch.definitions import candidates as torch_candidates
from idrgbdo_torch.definitions import se3
from idrgbdo_torch.definitions import selection as torch_choice
from idrgbdo_torch.definitions import tracking as torch_alignment
from idrgbdo_torch.definitions import window as torch_bundle
from idrgbdo_torch.frame import prepare
from idrgbdo_torch.kernels import candidates
from idrgbdo_torch.kernels import selection as choice
from idrgbdo_torch.kernels import tracking as alignment
from idrgbdo_torch.kernels import verification as agreement
from idrgbdo_torch.kernels import window as bundle
from idrgbdo_torch.tracker import candidates as candidates_file
from idrgbdo_torch.tracker import selection, tracking, verification, window
from idrgbdo_torch.tracker.backends import FUSED, TORCH, backend_named
from idrgbdo_torch.tracker.candidates import BLOCK, BORDER, PLANE_RADIUS, THRESHOLD_OFFSET
from idrgbdo_torch.tracker.keyframe import make_keyframe
from idrgbdo_torch.tracker.selection import select_points
from idrgbdo_torch.tracker.tracking import AFFINE_PRIOR, STEPS
from idrgbdo_torch.tracker.verification import WEAK_BELOW
from idrgbdo_torch.tracker.window import Linearised

LEVELS = CONFIG.tracking.levels
FILES = ("agreement", "alignment", "bundle", "candidates", "choice", "marginal")
UNITS = np.array([1e5, 1e5, 1e5, 3e4, 3e4, 3e4, 200.0, 0.1])  # 1 / sigma of a keyframe's state
TWINS = [(getattr(FUSED, name), getattr(TORCH, name)) for name in FILES]
NEAR = se3.exp(torch.tensor([0.003, -0.002, 0.001, 0.001, -0.002, 0.0005], dtype=torch.float64))  # off whole pixels


@pytest.fixture(scope="module")
def cases(desk: Film) -> list[Case]:
    return make_cases(desk)


@pytest.fixture(scope="module")
def windows(desk: Film) -> Desk:
    return make_desk(desk)


def alignment_arguments(case: Case, levels: int = LEVELS, pixels: int = 8) -> tuple[Any, ...]:
    keyframe, T = case.keyframe, NEAR.numpy()
    return (
        case.frame.images, case.frame.depth, keyframe.frame.intrinsics, keyframe.points, keyframe.coarse, pixels,
        case.choose(24), T, np.array([0.02, -1.0]), PRIOR, np.linalg.inv(T), AFFINE_PRIOR, NOISE, STEPS[:levels],
    )  # fmt: skip


@pytest.mark.parametrize(("levels", "pixels"), [(1, 8), (2, 8), (3, 1), (LEVELS, 8), (LEVELS, 5)])
def test_alignment(cases: list[Case], levels: int, pixels: int) -> None:
    for case in cases[:2] if levels < LEVELS else cases:
        arguments = alignment_arguments(case, levels, pixels)
        fused, mine = alignment.align(*arguments), torch_alignment.align(*arguments)
        T, affine, H, rms, scale, iterations, seen, kept, change = mine
        close(T, fused[0])
        close(affine, fused[1], 1e-9)  # gain and offset are nearly one: every iteration's rounding grows along both
        unit = np.diag(fused[2]) ** -0.5
        close(unit[:, None] * H * unit, unit[:, None] * fused[2] * unit)
        close(rms, fused[3])
        assert (iterations, seen, kept) == fused[5:8]
        assert (scale, change) == pytest.approx((fused[4], fused[8]), rel=1e-8)
        assert iterations >= 2 * levels and kept > 12


def test_robust_scale() -> None:
    rms = np.random.default_rng(0).uniform(0, 3, 101)
    rms[::7] = -1.0
    for some in (rms, rms[:60], rms[:7], -np.ones(4), np.zeros(3)):
        assert torch_alignment.robust_scale(some) == pytest.approx(alignment.robust_scale(some), rel=1e-14)


def test_alignment_moves_neither_its_guess_nor_the_images(cases: list[Case]) -> None:
    arguments = alignment_arguments(cases[0])
    before = [np.array(x) for x in (arguments[1], arguments[6], arguments[7], arguments[8])]
    torch_alignment.align(*arguments)
    for x, was in zip((arguments[1], arguments[6], arguments[7], arguments[8]), before, strict=True):
        assert np.array_equal(x, was)


@pytest.mark.parametrize("use_depth", [True, False])
@pytest.mark.parametrize("paper", [True, False])
def test_rows_and_verification(cases: list[Case], use_depth: bool, paper: bool) -> None:
    case = cases[1]
    points, camera = case.keyframe.points, case.keyframe.frame.camera
    everyone = np.random.default_rng(0).permutation(len(points.uv))[:500]
    noise = NOISE._replace(use_depth=use_depth, paper_variance=paper)
    cam, T = case.keyframe.frame.intrinsics, case.T.numpy()
    arguments = (cam[0], camera.width, camera.height, 20.0, points, everyone, T, noise)
    for mine, fused in zip(torch_choice.whitened_rows(*arguments), choice.whitened_rows(*arguments), strict=True):
        close(mine.astype(float), fused.astype(float))
    for level in (0, 1):
        arguments = (
            case.frame.images[level], case.frame.depth, cam[level], level, points, points.patch[level], everyone, T,
            np.array([0.05, 3.0]), noise, 12.0,
        )  # fmt: skip
        counts = TORCH.agreement.verify(*arguments)
        assert counts == agreement.verify(*arguments)
        assert 0 < counts[1] < counts[0] < 500 and 0 < counts[3] <= counts[2]


@pytest.mark.parametrize("cell", [4, 9, 13])
def test_candidates(desk: Film, cases: list[Case], cell: int) -> None:
    image, depth = cases[0].frame.images[0], cases[0].frame.depth.copy()
    depth[50:60, 100:140] = 0.0
    g2 = candidates.gradient_squared(image)
    np.testing.assert_array_equal(torch_candidates.gradient_squared(image), g2)
    limits = candidates.block_thresholds(g2, BLOCK, THRESHOLD_OFFSET)
    close(torch_candidates.block_thresholds(g2, BLOCK, THRESHOLD_OFFSET), limits, 1e-12)
    edges = 255 * (np.random.default_rng(0).uniform(size=image.shape) < 0.1).astype(np.uint8)
    scores = candidates.candidate_scores(g2, limits, BLOCK, edges, depth)
    np.testing.assert_array_equal(torch_candidates.candidate_scores(g2, limits, BLOCK, edges, depth), scores)
    arguments = (depth, cell, BORDER, PLANE_RADIUS, 0.0025)
    mine, fused = (f.grid_candidates(scores, *arguments) for f in (torch_candidates, candidates))
    np.testing.assert_array_equal(mine[0], fused[0])
    close(mine[1], fused[1], 1e-10)
    np.testing.assert_array_equal(mine[2], fused[2])
    assert len(fused[0]) > 100 and set(fused[2]) == {0, 1, 2}
    uv = np.random.default_rng(0).integers(0, [image.shape[1], image.shape[0]], (500, 2)).astype(float)
    fused, mine = (f(depth, uv, PLANE_RADIUS, 0.0025) for f in (candidates.planes_at, torch_candidates.planes_at))
    np.testing.assert_array_equal(mine[0], fused[0])
    close(mine[1], fused[1], 1e-10)


def test_patches(cases: list[Case]) -> None:
    images, uv = cases[0].frame.images, cases[0].keyframe.points.uv
    index = np.random.default_rng(0).permutation(len(uv))[:300]
    for first, end in ((0, 1), (1, len(images))):
        filled = []
        for sample_patches in (candidates.sample_patches, torch_candidates.sample_patches):
            patch = np.full((len(images), len(uv), 8), -1.0, np.float32)
            gradient = np.full((len(images), len(uv), 8, 2), -1.0, np.float32)
            sample_patches(images, uv, index, first, end, patch, gradient)
            filled.append((patch, gradient))
        for fused, mine in zip(*filled, strict=True):
            close(mine, fused, 1e-5)
            assert (fused == -1.0).any() and (fused > 0).any()


@pytest.mark.parametrize("count", [5, 40, 90, 300])
def test_spreading_out(count: int) -> None:
    rng = np.random.default_rng(count)
    cells, order = rng.integers(0, 50, 200), rng.permutation(200)
    expected = candidates.first_of_cells(cells, order, count)
    assert torch_candidates.first_of_cells(cells, order, count).tolist() == expected.tolist()
    assert len(expected) == min(count, 200)


def test_displacement(cases: list[Case]) -> None:
    keyframe, T = cases[0].keyframe, cases[0].T.numpy()
    cam = keyframe.frame.intrinsics[0]
    behind = np.diag([1.0, -1.0, -1.0, 1.0])
    for T_other in (NEAR.numpy(), np.eye(4), behind):
        expected = agreement.displacement(cam, keyframe.points, keyframe.coarse, T, T_other)
        mine = TORCH.agreement.displacement(cam, keyframe.points, keyframe.coarse, T, T_other)
        assert mine == pytest.approx(expected, rel=1e-10)
    assert expected == np.inf


@pytest.mark.parametrize(
    ("limit", "use_depth", "first_estimates"), [(1e9, True, False), (1.0, True, True), (1.0, False, True)]
)
def test_window(windows: Desk, limit: float, use_depth: bool, first_estimates: bool) -> None:
    window = windows.window(5, off_m=0.003, off_rad=0.002)
    window.affine += 0.01 * np.random.default_rng(0).standard_normal(window.affine.shape) * [1, 100]
    points = window.points()
    points.valid[1, -3:] = False
    hosts = np.array([True, True, False, True, True])
    T_linear = window.T_kf_world
    if first_estimates:
        T_linear = se3.retract(0.002 * torch.randn(5, 6, generator=torch.Generator().manual_seed(0)).double(),
                               torch.from_numpy(T_linear)).numpy()  # fmt: skip
    noise = NOISE._replace(use_depth=use_depth)

    def linearised(linearise: Callable[..., float]) -> tuple[float, Linearised]:
        out = Linearised(*window.inv_depth.shape)
        energy = linearise(
            window.images, window.depths, window.slots, window.keyframes[0].frame.intrinsics[0], window.T_kf_world,
            T_linear, window.affine, window.inv_depth, points, hosts, limit, noise,
            out.H, out.b, out.Hd, out.cross, out.bd, out.rms,
        )  # fmt: skip
        return energy, out

    energy, fused = linearised(bundle.linearise_window)
    energy_mine, mine = linearised(torch_bundle.linearise_window)
    assert energy_mine == pytest.approx(energy, rel=1e-10)
    unit, unit_d = np.maximum(np.diag(fused.H), 1e-9) ** -0.5, np.maximum(fused.Hd, 1e-9) ** -0.5
    close(unit[:, None] * mine.H * unit, unit[:, None] * fused.H * unit)
    close(unit * mine.b, unit * fused.b)
    close(mine.Hd, fused.Hd)
    close(unit_d * mine.bd, unit_d * fused.bd)
    close(unit_d[..., None] * mine.cross * unit, unit_d[..., None] * fused.cross * unit)
    close(mine.rms, fused.rms)
    seen = fused.rms >= 0
    assert seen.any() and (limit > 1e3 or 0 < (fused.rms[seen] > limit).sum() < seen.sum())
    arguments = (fused.H, fused.b, fused.Hd, fused.cross, fused.bd)
    for reduced, expected in zip(
        torch_bundle.eliminate_depths(*arguments), bundle.eliminate_depths(*arguments), strict=True
    ):
        close(reduced, expected, 1e-12)


def test_marginalisation() -> None:
    rng = np.random.default_rng(0)
    unit = np.tile(UNITS, 5)
    J = rng.standard_normal((120, 40)) * unit
    H, b = J.T @ J, J.T @ rng.standard_normal(120)
    everything = np.arange(40)
    for gone in (np.arange(8, 16), everything[everything % 8 >= 6]):
        keep = np.setdiff1d(everything, gone)
        (ok, H_fused, b_fused), (ok_mine, H_mine, b_mine) = (
            file.marginalize(H, b, keep, gone) for file in (FUSED.marginal, TORCH.marginal)
        )
        assert ok and ok_mine
        close(H_mine / np.outer(unit[keep], unit[keep]), H_fused / np.outer(unit[keep], unit[keep]))
        close(b_mine / unit[keep], b_fused / unit[keep])
    poses = H[np.ix_(everything % 8 < 6, everything % 8 < 6)]
    close(TORCH.marginal.redundancy(poses)[1], FUSED.marginal.redundancy(poses)[1])


def test_every_function_that_the_tracker_calls_has_its_twin() -> None:
    assert backend_named("fused") is FUSED and pickle.loads(pickle.dumps(TORCH)) is TORCH
    for fused, mine in TWINS:
        assert mine.__name__.removeprefix(torch_backend.__name__) == fused.__name__.removeprefix(kernels.__name__)
    callers = "".join(
        inspect.getsource(module) for module in (tracking, verification, selection, candidates_file, window)
    )
    for fused, mine in TWINS:
        short = fused.__name__.split(".")[-1]
        used = set(re.findall(rf"\b(?:{short}|computing)\.(\w+)\(", callers)) & set(vars(fused))
        assert used - {"select"} <= set(vars(mine)) and used


def forbid_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every compiled function that has a torch twin, and the compiled Algorithm 1, fail when Python calls it."""

    def fail(*_: object) -> None:
        raise AssertionError("a compiled loop ran")

    for fused, mine in TWINS:
        for name, function in vars(fused).items():
            if isinstance(function, numba.core.dispatcher.Dispatcher) and (hasattr(mine, name) or name == "select"):
                monkeypatch.setattr(fused, name, fail)


@pytest.fixture(scope="module")
def sequence() -> Film:
    """A hundred frames of 160x120, so small that nothing can be sampled on the coarsest level of the pyramid."""
    quarter = replace(SMALL, width=160, height=120, fx=131.25, fy=131.25, cx=79.5, cy=59.5)
    return film(replace(quarter, frames=100, samples=1))


def test_a_hundred_frames_give_the_same_trajectory(sequence: Film, monkeypatch: pytest.MonkeyPatch) -> None:
    fused = run(IdRgbdo(), sequence.frames)
    with monkeypatch.context() as patched:
        forbid_kernels(patched)
        odometry = IdRgbdo(Config(backend="torch"))
        mine = run(odometry, sequence.frames)
        seen, bits = odometry.last_points()
        assert len(seen) == len(bits) > 12
        with pytest.raises(AssertionError, match="a compiled loop ran"):
            run(IdRgbdo(), sequence.frames[:1])
    assert fused.statuses == mine.statuses
    assert fused.statuses.count(Status.OK) > 95 and Status.LOST not in fused.statuses
    off = (fused.trajectory().positions - mine.trajectory().positions).norm(dim=1)
    turned = se3.log(se3.inverse(fused.trajectory().T_world_cam) @ mine.trajectory().T_world_cam)[:, 3:].norm(dim=1)
    assert off.max() < 1e-3 and turned.max() < 1e-3
    path = (sequence.groundtruth.positions[1:] - sequence.groundtruth.positions[:-1]).norm(dim=1).sum()
    assert path > 0.3 and sum(record.result.keyframe for record in fused.records) >= 3


@pytest.mark.parametrize("mode", ["rand", "grid", "inf"])
@pytest.mark.parametrize("objective", ["bits", "paper"])
def test_every_mode_and_objective_chooses_alike(cases: list[Case], mode: Mode, objective: str) -> None:
    config = replace(CONFIG.selection, mode=mode, objective=objective)  # type: ignore[arg-type]
    for case in cases[:2]:
        mine, fused = (
            select_points(case.keyframe, NEAR.numpy(), 24, PRIOR, config, NOISE, np.random.default_rng(0), backend)
            for backend in (TORCH, FUSED)
        )
        assert len(fused) == 24 and mine.tolist() == fused.tolist()


def test_recovery_is_the_same(sequence: Film) -> None:
    """All candidates on the widest pyramid, from a guess that is far off."""
    first, later = prepare(sequence.frames[0]), prepare(sequence.frames[3])
    guess = se3.exp(torch.tensor([0.03, 0.02, -0.02, 0.02, -0.03, 0.02], dtype=torch.float64)).numpy()
    found = []
    for backend in (FUSED, TORCH):
        keyframe = make_keyframe(first, Config(backend=backend.name), np.random.default_rng(0))
        found.append(verification.recover(later, keyframe, [guess], np.zeros(2), keyframe.coarse, NOISE, backend))
    (fused, verdict), (mine, same) = found
    close(mine.T_frame_kf, fused.T_frame_kf, 1e-6)
    assert same == verdict and not verdict.doubt(WEAK_BELOW)


@pytest.mark.parametrize(("patch", "limit"), [(1, 1e-4), (5, 1e-6)])  # m; one pixel a point leaves much to rounding
def test_smaller_patches_are_smaller_everywhere_and_the_same(sequence: Film, patch: int, limit: float) -> None:
    """`tracking.patch` reaches candidates, window and noise of both backends."""
    frames = sequence.frames[:16]
    small = replace(Config(), tracking=replace(Config().tracking, patch=patch))
    odometry = IdRgbdo(small)
    fused, mine = run(odometry, frames), run(IdRgbdo(replace(small, backend="torch")), frames)
    assert sum(record.result.keyframe for record in fused.records) >= 2
    off = (fused.trajectory().positions - mine.trajectory().positions).norm(dim=1)
    assert off.max() < limit
    assert odometry.keyframe is not None and odometry.keyframe.points.patch.shape[2] == patch
    assert odometry.window.points().patch.shape[2] == patch and odometry.noise.shared == patch
    whole = run(IdRgbdo(), frames).trajectory().positions
    assert 1e-5 < float((fused.trajectory().positions - whole).norm(dim=1).max()) < 0.01
