"""The sliding window on rendered keyframes whose poses are exactly known: refinement, Schur, priors, removal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from rendered import Film, rotation_deg
from torch import Tensor

from idrgbdo_torch import se3
from idrgbdo_torch.candidates import make_keyframe
from idrgbdo_torch.config import Config, WindowConfig
from idrgbdo_torch.frame import Keyframe, prepare
from idrgbdo_torch.marginalization import prior_cost, prior_gradient, redundancy_bits
from idrgbdo_torch.selection import select_points
from idrgbdo_torch.tracking import kernel_noise, motion_information
from idrgbdo_torch.window import PROTECTED, STEP, Linearised, Window

FRAMES = (0, 4, 8, 12, 16, 20, 24)
CONFIG = replace(Config(), window=WindowConfig(keyframes=5))
NOISE = kernel_noise(CONFIG.noise)
PRIOR = motion_information(CONFIG, 1 / 30)
NO_CHANGE = np.zeros(2)
MM = 1e-3
DEGREE = np.pi / 180


@pytest.fixture(scope="module")
def keyframes(desk: Film) -> list[Keyframe]:
    return [make_keyframe(prepare(desk.frames[k]), CONFIG, np.random.default_rng(0)) for k in FRAMES]


def twists(count: int, translation: float, rotation: float, seed: int = 0) -> Tensor:
    """Left increments (count, 6) of these sizes, the first one zero."""
    xi = torch.randn(count, 2, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    xi = torch.nn.functional.normalize(xi, dim=-1) * torch.tensor([[translation], [rotation]], dtype=torch.float64)
    xi[0] = 0.0
    return xi.reshape(count, 6)


Build = Callable[..., Window]


@pytest.fixture
def build(desk: Film, keyframes: list[Keyframe]) -> Build:
    def make(
        count: int = 5, off_m: float = 0.0, off_rad: float = 0.0, seed: int = 0, config: Config = CONFIG
    ) -> Window:
        """A window of the first frames at their true poses, world = first camera, moved by errors of this size."""
        window = Window(config, NOISE)
        for k, xi in enumerate(twists(count, off_m, off_rad, seed)):
            add(window, desk, keyframes, k, xi)
        return window

    return make


def add(window: Window, desk: Film, keyframes: list[Keyframe], k: int, xi: Tensor | None = None) -> None:
    keyframe = keyframes[k]
    m = window.config.window_points
    index = select_points(keyframe, np.eye(4), m, PRIOR, CONFIG.selection, NOISE, np.random.default_rng(0))
    T = desk.T(FRAMES[k], 0)
    window.add(keyframe, (T if xi is None else se3.retract(xi, T)).numpy(), NO_CHANGE, index)


def errors(window: Window, desk: Film, frames: tuple[int, ...] = FRAMES) -> tuple[np.ndarray, np.ndarray]:
    """Metres and degrees of every keyframe against the first."""
    E = [
        se3.inverse(desk.T(k, frames[0])) @ torch.from_numpy(T) for k, T in zip(frames, window.T_kf_world, strict=False)
    ]
    return np.array([float(e[:3, 3].norm()) for e in E]), np.array([rotation_deg(e) for e in E])


def cost(window: Window, limit: float = 1e9) -> float:
    energy, _ = window.linearise(window.points(), np.ones(len(window.keyframes), dtype=np.bool_), limit)
    return energy + 2 * float(prior_cost(window.prior, window.deviation()))


@pytest.mark.parametrize("seed", range(3))
def test_optimising_pulls_wrong_poses_back(build: Build, desk: Film, seed: int) -> None:
    window = build(5, 4 * MM, 0.15 * DEGREE, seed)
    before, (metres, degrees) = cost(window), errors(window, desk)
    assert metres[1:].min() > 3.5 * MM and degrees[1:].min() > 0.14
    assert 1 <= window.optimise() <= 6
    after, (metres, degrees) = cost(window), errors(window, desk)
    assert after < 0.7 * before
    assert metres.max() < 1.2 * MM and degrees.max() < 0.06


def test_the_answer_does_not_hang_on_the_start(build: Build) -> None:
    poses = []
    for seed in range(3):
        window = build(5, 3 * MM, 0.1 * DEGREE, seed)
        window.optimise()
        window.optimise()
        poses.append(window.T_kf_world)
    assert np.abs(poses[0] - poses[1]).max() < 3e-4 and np.abs(poses[0] - poses[2]).max() < 3e-4


def test_the_first_keyframe_stays(build: Build) -> None:
    window = build(5, 4 * MM, 0.15 * DEGREE)
    first = window.T_kf_world[0].copy()
    window.optimise()
    assert np.abs(window.T_kf_world[0] - first).max() < 1e-6
    assert np.abs(window.affine[0]).max() < 0.05
    assert np.abs(window.T_kf_world[1:] - build(5, 4 * MM, 0.15 * DEGREE).T_kf_world[1:]).max() > 1 * MM


def test_one_keyframe_has_nothing_to_refine(build: Build) -> None:
    window = build(1)
    assert window.optimise() == 0 and window.shrink() == []


def test_schur_step_is_the_dense_step(build: Build) -> None:
    window = build(4, 3 * MM, 0.1 * DEGREE)
    _, system = window.linearise(window.points(), np.ones(4, dtype=np.bool_), 1e9)
    prior = window.prior.H.numpy()
    H, b = system.reduced()
    step = np.linalg.solve(H + prior, b)
    depths = system.depth_step(step)
    cross = system.cross.reshape(-1, len(H))
    dense = np.block([[system.H + prior, cross.T], [cross, np.diag(system.Hd.ravel())]])
    known = dense.diagonal() > 0
    assert known.all() == (system.Hd > 0).all()
    expected = np.linalg.solve(dense[known][:, known], np.concatenate([system.b, system.bd.ravel()])[known])
    mine = np.concatenate([step, depths.ravel()])[known]
    np.testing.assert_allclose(mine, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())


def test_unused_places_take_no_step() -> None:
    system = Linearised(2, 3)
    system.H[:] = np.eye(2 * STEP)
    system.b[:] = 1.0
    H, b = system.reduced()
    assert np.array_equal(H, np.eye(2 * STEP)) and (b == 1).all() and (system.depth_step(b) == 0).all()


def test_refined_depths_reach_the_keyframes_where_tracking_reads_them(build: Build, keyframes: list[Keyframe]) -> None:
    window = build(4, 1 * MM, 0.05 * DEGREE)
    window.optimise()
    for k, (refined, index) in enumerate(zip(window.keyframes, window.index, strict=True)):
        before, after = keyframes[k].points, refined.points
        assert np.array_equal(after.inv_depth[index], window.inv_depth[k, : len(index)])
        assert (after.inv_depth[index] != before.inv_depth[index]).mean() > 0.7
        assert (np.abs(after.inv_depth - before.inv_depth) < 6 * np.sqrt(before.var_inv_depth)).all()
        others = np.setdiff1d(np.arange(len(before.uv)), index)
        assert np.array_equal(after.inv_depth[others], before.inv_depth[others])
        assert (after.var_inv_depth[index] <= before.var_inv_depth[index] * (1 + 1e-12)).all()
        assert after.var_inv_depth[index].mean() < 0.95 * before.var_inv_depth[index].mean()
        assert np.array_equal(refined.measured, keyframes[k].measured)


def test_wrong_depths_are_pulled_back(build: Build) -> None:
    window = build(4)
    exact = build(4)
    exact.optimise()
    window.inv_depth = window.inv_depth * (1 + 0.02 * np.random.default_rng(0).standard_normal(window.inv_depth.shape))
    off = np.abs(window.inv_depth - exact.inv_depth).mean()
    window.optimise()
    assert np.abs(window.inv_depth - exact.inv_depth).mean() < 0.1 * off


def test_brightness_is_chained_and_estimated(desk: Film) -> None:
    """Each frame brighter than the one before by a gain of 1.1 and an offset of 3, beside the camera's own drift."""

    def of_gray_100(gain: float, offset: float) -> np.ndarray:
        """What the keyframes make of gray level 100 of the first, if each is changed like this once more."""
        window = Window(CONFIG, NOISE)
        total = np.array([0.0, 0.0])
        for n, k in enumerate(FRAMES[:4]):
            brighter = replace(desk.frames[k], gray=np.exp(total[0]) * desk.frames[k].gray + total[1])
            keyframe = make_keyframe(prepare(brighter), CONFIG, np.random.default_rng(0))
            index = select_points(keyframe, np.eye(4), 24, PRIOR, CONFIG.selection, NOISE, np.random.default_rng(0))
            change = np.array([np.log(gain), offset]) if n else NO_CHANGE
            window.add(keyframe, desk.T(k, 0).numpy(), change, index)
            np.testing.assert_allclose(window.affine[n], total, atol=1e-12)
            total = np.array([total[0] + np.log(gain), gain * total[1] + offset])
        window.optimise()
        assert errors(window, desk)[0].max() < 1.5 * MM
        return np.exp(window.affine[:, 0]) * 100 + window.affine[:, 1]

    drift = of_gray_100(1.0, 0.0)
    assert 1 < np.abs(drift - 100).max() < 12
    expected = 1.1 ** np.arange(4) * drift + [0, 3, 3 * 2.1, 3 * 3.31]
    np.testing.assert_allclose(of_gray_100(1.1, 3.0), expected, atol=1.0)


def test_a_keyframe_with_few_points_and_one_with_none(desk: Film, keyframes: list[Keyframe], build: Build) -> None:
    window = build(3)
    for k, few in ((3, 5), (4, 0)):
        window.add(keyframes[k], desk.T(FRAMES[k], 0).numpy(), NO_CHANGE, np.arange(few) * 20)
    window.optimise()
    metres, _ = errors(window, desk)
    assert metres.max() < 1.5 * MM
    add(window, desk, keyframes, 5)
    window.optimise()
    assert len(window.shrink()) == 1 and np.isfinite(window.T_kf_world).all()


def test_the_window_keeps_its_size_and_its_newest(build: Build, desk: Film, keyframes: list[Keyframe]) -> None:
    window = build(5)
    assert window.shrink() == []
    for k in (5, 6):
        add(window, desk, keyframes, k)
        window.optimise()
        newest = [keyframe.frame.timestamp for keyframe in window.keyframes[-PROTECTED:]]
        removed = window.shrink()
        assert len(removed) == 1 and removed[0] < 6 - PROTECTED
        assert len(window.keyframes) == len(window.index) == len(window.slots) == 5
        assert [keyframe.frame.timestamp for keyframe in window.keyframes[-PROTECTED:]] == newest
        assert window.prior.H.shape == (5 * STEP,) * 2 and window.prior.b.shape == (5 * STEP,)
        for slot, keyframe in zip(window.slots, window.keyframes, strict=True):
            assert np.array_equal(window.images[slot], keyframe.frame.images[0])
            assert np.array_equal(window.depths[slot], keyframe.frame.depth)
    window.optimise()
    frames = [round((keyframe.frame.timestamp - desk.frames[0].timestamp) * 30) for keyframe in window.keyframes]
    E = [se3.inverse(desk.T(k, 0)) @ torch.from_numpy(T) for k, T in zip(frames, window.T_kf_world, strict=True)]
    assert max(float(e[:3, 3].norm()) for e in E) < 2 * MM


def test_removal_takes_the_most_redundant_or_the_oldest(build: Build) -> None:
    window = build(6)
    window.optimise()
    k = window.least_useful()
    H, _ = window.system.reduced()
    H += window.prior.H.numpy()
    brightness = np.arange(len(H)) % STEP >= 6
    poses = np.linalg.inv(np.linalg.inv(H)[~brightness][:, ~brightness])
    psi = redundancy_bits(torch.from_numpy(0.5 * (poses + poses.T)))
    assert k == int(psi[: 6 - PROTECTED].argmax())
    oldest = build(6, config=replace(CONFIG, window=WindowConfig(keyframes=5, removal="oldest")))
    oldest.optimise()
    assert oldest.least_useful() == 0


def test_a_keyframe_out_of_sight_goes_first(build: Build) -> None:
    window = build(6)
    window.optimise()
    window.system.rms[2, :, -1] = -1.0  # none of its points is seen by the newest
    assert window.least_useful() == 2
    window.system.rms[4, :, -1] = -1.0  # protected
    window.system.rms[2, :, -1] = 1.0
    assert window.least_useful() < 4


@pytest.mark.parametrize("k", [0, 2])
def test_marginalising_is_dense_elimination_of_its_points_and_itself(build: Build, k: int) -> None:
    """And the prior's pull on the kept is, at the present state, what the removed terms pulled (Eqs. 23, 25)."""
    window = build(5, 2 * MM, 0.05 * DEGREE)
    window.optimise()
    for again in (False, True):  # the second time on top of a prior, with poses that have moved since
        K = len(window.keyframes)
        hosts = np.arange(K) == k
        _, system = window.linearise(window.points(), hosts, CONFIG.noise.outlier)
        cross = system.cross.reshape(-1, STEP * K)
        pull = prior_gradient(window.prior, window.deviation()).numpy()
        H = np.block([[system.H + window.prior.H.numpy(), cross.T], [cross, np.diag(system.Hd.ravel())]])
        g = np.concatenate([system.b + pull, system.bd.ravel()])
        kept = np.zeros(len(H), dtype=np.bool_)
        kept[: STEP * K] = ~np.repeat(hosts, STEP)
        gone = ~kept & (H.diagonal() > 0)
        unit = 1 / np.sqrt(np.where(H.diagonal() > 0, H.diagonal(), 1.0))
        H, g = unit[:, None] * H * unit, unit * g
        star = H[kept][:, kept] - H[kept][:, gone] @ np.linalg.solve(H[gone][:, gone], H[gone][:, kept])
        pull_star = g[kept] - H[kept][:, gone] @ np.linalg.solve(H[gone][:, gone], g[gone])
        window.marginalise(k)
        u = unit[kept]
        np.testing.assert_allclose(u[:, None] * window.prior.H.numpy() * u, star, atol=1e-7)
        now = u * prior_gradient(window.prior, window.deviation()).numpy()
        np.testing.assert_allclose(now, pull_star, atol=1e-6 * np.abs(g).max())
        if not again:
            window.T_kf_world = se3.retract(twists(4, 1 * MM, 1e-3), torch.from_numpy(window.T_kf_world)).numpy()


def test_marginalising_at_the_optimum_hardly_moves_the_rest(build: Build) -> None:
    window = build(5, 2 * MM, 0.05 * DEGREE)
    for _ in range(3):
        window.optimise()
    kept = window.T_kf_world[[0, 2, 3, 4]]
    window.marginalise(1)
    window.optimise()
    assert np.abs(window.T_kf_world - kept).max() < 4e-4


@pytest.mark.parametrize("first_estimates", [True, False])
def test_first_estimates_do_not_move(
    build: Build, desk: Film, keyframes: list[Keyframe], first_estimates: bool
) -> None:
    config = replace(CONFIG, window=WindowConfig(keyframes=5, first_estimates=first_estimates))
    window = build(6, 2 * MM, 0.05 * DEGREE, config=config)
    window.optimise()
    window.marginalise(1)
    assert window.in_prior[0] and window.in_prior.sum() >= 3
    fixed, moving = window.in_prior.copy(), window.T_kf_world.copy()
    linear = window.T_linear.copy()
    np.testing.assert_array_equal(linear[fixed][1:], moving[fixed][1:])
    add(window, desk, keyframes, 6, twists(2, 2 * MM, 0.05 * DEGREE)[1])
    window.optimise()
    assert np.abs(window.T_kf_world[:-1] - moving).max() > 1e-5
    np.testing.assert_array_equal(window.T_linear[:-1][fixed], linear[fixed])
    window.marginalise(1)
    kept = np.delete(np.arange(5), 1)
    np.testing.assert_array_equal(window.T_linear[: len(kept)][fixed[kept]], linear[kept][fixed[kept]])
    assert window.deviation().abs().max() > 0
    _, at_state = window.linearise(window.points(), np.ones(5, dtype=np.bool_), 1e9)
    window.T_linear = window.T_kf_world.copy()
    _, relinearised = window.linearise(window.points(), np.ones(5, dtype=np.bool_), 1e9)
    assert np.array_equal(at_state.H, relinearised.H) != first_estimates
