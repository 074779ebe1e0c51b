"""The two backends against each other through the Protocol: method by method, then a whole sequence."""

from __future__ import annotations

import inspect
import pickle
from dataclasses import replace
from types import FunctionType

import numba
import numpy as np
import pytest
import torch
from plane_scene import close
from rendered import SMALL, Film, film
from tracking_cases import CONFIG, FUSED, NOISE, PRIOR, TORCH, Case, make_cases
from window_cases import Desk, make_desk

from idrgbdo_torch import IdRgbdo, Status, run
from idrgbdo_torch.config import Config, KeyframeConfig, Mode
from idrgbdo_torch.definitions import se3
from idrgbdo_torch.frame import prepare
from idrgbdo_torch.kernels import candidates, information, marginalization, selection, tracking, verification, window
from idrgbdo_torch.measurement import (
    WIDE,
    Aligned,
    MotionPrior,
    Noise,
    Points,
    State,
    Subset,
    View,
    WindowPairs,
    WindowSystem,
)
from idrgbdo_torch.tracker.alignment import recover
from idrgbdo_torch.tracker.backends import BACKENDS, Backend, backend_named
from idrgbdo_torch.tracker.candidates import BLOCK, BORDER, PLANE_RADIUS, THRESHOLD_OFFSET
from idrgbdo_torch.tracker.keyframe import make_keyframe
from idrgbdo_torch.tracker.selection import select_points
from idrgbdo_torch.tracker.tracking import AFFINE_PRIOR, STEPS, Pair
from idrgbdo_torch.tracker.verification import LIMITS

LEVELS = CONFIG.tracking.levels
UNITS = np.array([1e5, 1e5, 1e5, 3e4, 3e4, 3e4, 200.0, 0.1])  # 1 / sigma of a keyframe's state
KERNELS = (candidates, information, marginalization, selection, tracking, verification, window)  # what Fused calls
NEAR = se3.exp(torch.tensor([0.003, -0.002, 0.001, 0.001, -0.002, 0.0005], dtype=torch.float64))  # off whole pixels


@pytest.fixture(scope="module")
def cases(desk: Film) -> list[Case]:
    return make_cases(desk)


@pytest.fixture(scope="module")
def windows(desk: Film) -> Desk:
    return make_desk(desk)


Arguments = tuple[View, Points, Subset, Subset, State, MotionPrior, Noise, np.ndarray]


def alignment_arguments(case: Case, levels: int = LEVELS, pixels: int = 8) -> Arguments:
    T = NEAR.numpy()
    coarse, fine = Subset(case.keyframe.coarse, pixels), Subset(case.choose(24), 8)
    start, prior = State(T, np.array([0.02, -1.0])), MotionPrior(np.linalg.inv(T), PRIOR, AFFINE_PRIOR)
    return case.frame.view, case.keyframe.points, coarse, fine, start, prior, NOISE, STEPS[:levels]


@pytest.mark.parametrize(("levels", "pixels"), [(1, 8), (2, 8), (3, 1), (LEVELS, 8), (LEVELS, 5)])
def test_alignment(cases: list[Case], levels: int, pixels: int) -> None:
    for case in cases[:2] if levels < LEVELS else cases:
        arguments = alignment_arguments(case, levels, pixels)
        fused, mine = FUSED.align(*arguments), TORCH.align(*arguments)
        assert isinstance(fused, Aligned) and isinstance(mine, Aligned)
        close(mine.T, fused.T)
        close(mine.affine, fused.affine, 1e-9)  # gain and offset are nearly one: rounding grows along both
        unit = np.diag(fused.H) ** -0.5
        close(unit[:, None] * mine.H * unit, unit[:, None] * fused.H * unit)
        close(mine.rms, fused.rms)
        assert (mine.iterations, mine.seen, mine.kept) == (fused.iterations, fused.seen, fused.kept)
        assert (mine.scale, mine.change) == pytest.approx((fused.scale, fused.change), rel=1e-8)
        assert mine.iterations >= 2 * levels and mine.kept > 12


def test_robust_scale() -> None:
    rms = np.random.default_rng(0).uniform(0, 3, 101)
    rms[::7] = -1.0
    for some in (rms, rms[:60], rms[:7], -np.ones(4), np.zeros(3)):
        assert TORCH.robust_scale(some) == pytest.approx(FUSED.robust_scale(some), rel=1e-14)


def test_alignment_moves_neither_its_guess_nor_the_images(cases: list[Case]) -> None:
    for backend in (TORCH, FUSED):
        view, _, _, fine, start, *_ = arguments = alignment_arguments(cases[0])
        read = (view.depth, *view.images, fine.which, start.T, start.affine)
        before = [np.array(x) for x in read]
        backend.align(*arguments)
        for x, was in zip(read, before, strict=True):
            assert np.array_equal(x, was)


@pytest.mark.parametrize("use_depth", [True, False])
@pytest.mark.parametrize("paper", [True, False])
def test_rows_and_verification(cases: list[Case], use_depth: bool, paper: bool) -> None:
    case = cases[1]
    points, camera = case.keyframe.points, case.keyframe.frame.camera
    everyone = np.random.default_rng(0).permutation(len(points.uv))[:500]
    noise = NOISE._replace(use_depth=use_depth, paper_variance=paper)
    T = case.T.numpy()
    mine, fused = (b.whitened_rows(camera, 20.0, points, everyone, T, noise) for b in (TORCH, FUSED))
    for of_mine, of_fused in zip(mine, fused, strict=True):
        close(of_mine.astype(float), of_fused.astype(float))
    state = State(T, np.array([0.05, 3.0]))
    for level in (0, 1):
        counts, expected = (
            backend.verify(case.frame.view, level, points, everyone, state, noise, 12.0) for backend in (TORCH, FUSED)
        )
        assert counts == expected
        assert 0 < counts.bright < counts.seen < 500 and 0 < counts.near <= counts.with_depth


@pytest.mark.parametrize("cell", [4, 9, 13])
def test_candidates(desk: Film, cases: list[Case], cell: int) -> None:
    image, depth = cases[0].frame.images[0], cases[0].frame.depth.copy()
    depth[50:60, 100:140] = 0.0
    g2 = FUSED.gradient_squared(image)
    np.testing.assert_array_equal(TORCH.gradient_squared(image), g2)
    limits = FUSED.block_thresholds(g2, BLOCK, THRESHOLD_OFFSET)
    close(TORCH.block_thresholds(g2, BLOCK, THRESHOLD_OFFSET), limits, 1e-12)
    edges = 255 * (np.random.default_rng(0).uniform(size=image.shape) < 0.1).astype(np.uint8)
    scores = FUSED.candidate_scores(g2, limits, BLOCK, edges, depth)
    np.testing.assert_array_equal(TORCH.candidate_scores(g2, limits, BLOCK, edges, depth), scores)
    arguments = (depth, cell, BORDER, PLANE_RADIUS, 0.0025)
    mine, fused = (backend.grid_candidates(scores, *arguments) for backend in (TORCH, FUSED))
    np.testing.assert_array_equal(mine[0], fused[0])
    close(mine[1], fused[1], 1e-10)
    np.testing.assert_array_equal(mine[2], fused[2])
    assert len(fused[0]) > 100 and set(fused[2]) == {0, 1, 2}
    uv = np.random.default_rng(0).integers(0, [image.shape[1], image.shape[0]], (500, 2)).astype(float)
    planes, expected = (backend.planes_at(depth, uv, PLANE_RADIUS, 0.0025) for backend in (TORCH, FUSED))
    np.testing.assert_array_equal(planes[0], expected[0])
    close(planes[1], expected[1], 1e-10)
    close(planes[2], expected[2], 1e-10)


def test_patches(cases: list[Case]) -> None:
    images, uv = cases[0].frame.images, cases[0].keyframe.points.uv
    index = np.random.default_rng(0).permutation(len(uv))[:300]
    for levels in (range(1), range(1, len(images))):
        filled = []
        for backend in (FUSED, TORCH):
            patch = np.full((len(images), len(uv), 8), -1.0, np.float32)
            gradient = np.full((len(images), len(uv), 8, 2), -1.0, np.float32)
            backend.sample_patches(images, uv, index, levels, WIDE, patch, gradient)
            filled.append((patch, gradient))
        for fused, mine in zip(*filled, strict=True):
            close(mine, fused, 1e-5)
            assert (fused == -1.0).any() and (fused > 0).any()


@pytest.mark.parametrize("count", [5, 40, 90, 300])
def test_spreading_out(count: int) -> None:
    rng = np.random.default_rng(count)
    cells, order = rng.integers(0, 50, 200), rng.permutation(200)
    expected = FUSED.first_of_cells(cells, order, count)
    assert TORCH.first_of_cells(cells, order, count).tolist() == expected.tolist()
    assert len(expected) == min(count, 200)


def test_displacement(cases: list[Case]) -> None:
    keyframe, T = cases[0].keyframe, cases[0].T.numpy()
    cam = keyframe.frame.intrinsics[0]
    behind = np.diag([1.0, -1.0, -1.0, 1.0])
    for T_other in (NEAR.numpy(), np.eye(4), behind):
        expected = FUSED.displacement(cam, keyframe.points, keyframe.coarse, T, T_other)
        mine = TORCH.displacement(cam, keyframe.points, keyframe.coarse, T, T_other)
        assert mine == pytest.approx(expected, rel=1e-10)
    assert expected == np.inf


@pytest.mark.parametrize(
    ("limit", "use_depth", "first_estimates"), [(1e9, True, False), (1.0, True, True), (1.0, False, True)]
)
def test_window(windows: Desk, limit: float, use_depth: bool, first_estimates: bool) -> None:
    refined = windows.window(5, off_m=0.003, off_rad=0.002)
    members = refined.members
    off = 0.01 * np.random.default_rng(0).standard_normal(members.affine.shape) * [1, 100]
    state = members._replace(affine=members.affine + off).state(first_estimates=False)
    points = members.points
    points.valid[1, -3:] = False
    pairs = np.random.default_rng(1).random((5, 5)) < 0.7
    pairs[2] = False
    if first_estimates:
        xi = 0.002 * torch.randn(5, 6, generator=torch.Generator().manual_seed(0)).double()
        state = state._replace(T_linear=se3.retract(xi, torch.from_numpy(state.T)).numpy())
    noise = NOISE._replace(use_depth=use_depth)
    views = refined.views()

    on = members._replace(affine=state.affine + 0.01, inv_depth=1.001 * state.inv_depth).state(first_estimates=False)

    def linearised(backend: Backend) -> tuple[float, WindowSystem, WindowPairs]:
        """Taken at one state, assembled at another."""
        taken = WindowPairs.empty(*state.inv_depth.shape)
        backend.linearise_window(views, state, points, pairs, limit, noise, taken)
        return *backend.assemble(taken, on, points, pairs), taken

    energy, fused, taken = linearised(FUSED)
    energy_mine, mine, taken_mine = linearised(TORCH)
    assert energy_mine == pytest.approx(energy, rel=1e-10)
    assert np.array_equal(taken_mine.taken, taken.taken) and np.array_equal(taken.taken, pairs & ~np.eye(5, dtype=bool))
    far = FUSED.distances(taken, on)
    close(TORCH.distances(taken, on), far)
    assert np.isinf(far[~taken.taken & ~np.eye(5, dtype=bool)]).all() and (far[taken.taken] > 0).all()
    unit, unit_d = np.maximum(np.diag(fused.H), 1e-9) ** -0.5, np.maximum(fused.Hd, 1e-9) ** -0.5
    close(unit[:, None] * mine.H * unit, unit[:, None] * fused.H * unit)
    close(unit * mine.b, unit * fused.b)
    close(mine.Hd, fused.Hd)
    close(unit_d * mine.bd, unit_d * fused.bd)
    close(unit_d[:, None] * mine.cross * unit[:, None], unit_d[:, None] * fused.cross * unit[:, None])
    close(taken_mine.rms, taken.rms)
    seen = taken.rms >= 0
    assert seen.any() and (limit > 1e3 or 0 < (taken.rms[seen] > limit).sum() < seen.sum())
    for reduced, expected in zip(TORCH.eliminate_depths(fused), FUSED.eliminate_depths(fused), strict=True):
        close(reduced, expected, 1e-12)


def test_marginalisation() -> None:
    rng = np.random.default_rng(0)
    unit = np.tile(UNITS, 5)
    J = rng.standard_normal((120, 40)) * unit
    H, b = J.T @ J, J.T @ rng.standard_normal(120)
    everything = np.arange(40)
    for gone in (np.arange(8, 16), everything[everything % 8 >= 6]):
        marginal = np.isin(everything, gone)
        fused, mine = (backend.marginalize(H, b, marginal) for backend in (FUSED, TORCH))
        scale = torch.from_numpy(unit[~marginal])
        close(mine.H / torch.outer(scale, scale), fused.H / torch.outer(scale, scale))
        close(mine.b / scale, fused.b / scale)
    poses = H[np.ix_(everything % 8 < 6, everything % 8 < 6)]
    close(TORCH.redundancy(poses), FUSED.redundancy(poses))


def test_where_a_kernel_meets_a_singular_matrix_the_definition_answers() -> None:
    J = np.random.default_rng(0).standard_normal((60, 24)) * np.tile(UNITS, 3)
    H, b = J.T @ J, J.T @ np.ones(60)
    H[9] = H[:, 9] = b[9] = 0.0  # a variable that nobody has measured
    marginal = np.isin(np.arange(24), np.arange(8, 16))
    assert not marginalization.marginalize(H, b, np.flatnonzero(~marginal), np.flatnonzero(marginal))[0]
    fused, mine = (backend.marginalize(H, b, marginal) for backend in (FUSED, TORCH))
    assert torch.equal(fused.H, mine.H) and torch.equal(fused.b, mine.b) and bool(fused.H.isfinite().all())


def test_entropies_of_each_freedom() -> None:
    J = np.random.default_rng(0).standard_normal((30, 6)) * [1e4, 1e4, 1e4, 3e3, 3e3, 3e3]
    Lambda = J.T @ J
    close(TORCH.freedom_entropies(Lambda), FUSED.freedom_entropies(Lambda), 1e-9)
    Lambda[2] = Lambda[:, 2] = 0.0  # a direction that nothing measures
    mine, fused = TORCH.freedom_entropies(Lambda), FUSED.freedom_entropies(Lambda)
    assert mine[2] == fused[2] == np.inf
    close(np.delete(mine, 2), np.delete(fused, 2), 1e-9)


def test_both_backends_answer_every_call_of_the_protocol() -> None:
    """By the same parameter names too, so that a call with keywords reaches either."""
    calls = {name: f for name, f in vars(Backend).items() if isinstance(f, FunctionType) and not name.startswith("_")}
    assert len(calls) > 15
    for backend in BACKENDS.values():
        own = {name for name, f in vars(type(backend)).items() if isinstance(f, FunctionType)}
        assert own == set(calls)
        for name, call in calls.items():
            assert inspect.signature(getattr(type(backend), name)) == inspect.signature(call), name
    assert backend_named("fused") is FUSED and backend_named("torch") is TORCH
    assert type(pickle.loads(pickle.dumps(TORCH))) is type(TORCH)  # a checkpoint holds the odometry


def forbid_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every function of the kernels that Fused calls fail when Python calls it."""

    def fail(*_: object) -> None:
        raise AssertionError("a compiled loop ran")

    monkeypatch.setattr(information, "freedom_entropies", fail)  # the only one in numpy
    for file in KERNELS:
        for name, function in list(vars(file).items()):
            if isinstance(function, numba.core.dispatcher.Dispatcher):
                monkeypatch.setattr(file, name, fail)


@pytest.fixture(scope="module")
def sequence() -> Film:
    """A hundred frames of 160x120, so small that nothing can be sampled on the coarsest level of the pyramid."""
    quarter = replace(SMALL, width=160, height=120, fx=131.25, fy=131.25, cx=79.5, cy=59.5)
    return film(replace(quarter, frames=100, samples=1))


def test_fifty_frames_give_the_same_trajectory(sequence: Film, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = sequence.frames[:50]
    fused = run(IdRgbdo(), frames)
    with monkeypatch.context() as patched:
        forbid_kernels(patched)
        odometry = IdRgbdo(Config(backend="torch"))
        mine = run(odometry, frames)
        seen, bits = odometry.last_points()
        assert len(seen) == len(bits) > 12
        with pytest.raises(AssertionError, match="a compiled loop ran"):
            run(IdRgbdo(), frames[:1])
    assert fused.statuses == mine.statuses
    assert fused.statuses.count(Status.OK) > 46 and Status.LOST not in fused.statuses
    off = (fused.trajectory().positions - mine.trajectory().positions).norm(dim=1)
    turned = se3.log(se3.inverse(fused.trajectory().T_world_cam) @ mine.trajectory().T_world_cam)[:, 3:].norm(dim=1)
    assert off.max() < 1e-3 and turned.max() < 1e-3
    path = (sequence.groundtruth.positions[1:50] - sequence.groundtruth.positions[:49]).norm(dim=1).sum()
    assert path > 0.15 and sum(record.result.keyframe for record in fused.records) >= 3


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
        keyframe = make_keyframe(first, CONFIG, np.random.default_rng(0), backend)
        found.append(recover(Pair(later, keyframe, NOISE, backend), [guess], np.zeros(2), keyframe.coarse))
    (fused, verdict), (mine, same) = found
    close(mine.T_frame_kf, fused.T_frame_kf, 1e-6)
    assert same == verdict and not verdict.doubt(LIMITS.weak)


@pytest.mark.parametrize(("patch", "limit"), [(1, 2e-4), (5, 1e-6)])  # m; one pixel a point leaves much to rounding
def test_smaller_patches_are_smaller_everywhere_and_the_same(sequence: Film, patch: int, limit: float) -> None:
    """`tracking.patch` reaches candidates, window and noise of both backends."""
    frames = sequence.frames[:16]
    often = KeyframeConfig(threshold_bits=0.15)  # so that the window has something to do
    small = replace(Config(), tracking=replace(Config().tracking, patch=patch), keyframe=often)
    odometry = IdRgbdo(small)
    fused, mine = run(odometry, frames), run(IdRgbdo(replace(small, backend="torch")), frames)
    assert sum(record.result.keyframe for record in fused.records) >= 2
    off = (fused.trajectory().positions - mine.trajectory().positions).norm(dim=1)
    assert off.max() < limit
    assert odometry.reference is not None and odometry.reference.keyframe.points.patch.shape[2] == patch
    assert odometry.window.members.points.patch.shape[2] == patch and odometry.noise.shared == patch
    whole = run(IdRgbdo(replace(Config(), keyframe=often)), frames).trajectory().positions
    assert 1e-5 < float((fused.trajectory().positions - whole).norm(dim=1).max()) < 0.01
