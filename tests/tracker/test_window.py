"""The sliding window on rendered keyframes whose poses are exactly known: refinement and its linear algebra."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rendered import Film
from window_cases import CONFIG, DEGREE, FRAMES, FUSED, MM, NO_CHANGE, NOISE, PRIOR, Desk, make_desk

from idrgbdo_torch.definitions.marginalization import prior_cost
from idrgbdo_torch.frame import prepare
from idrgbdo_torch.measurement import STEP, WindowSystem
from idrgbdo_torch.tracker.keyframe import make_keyframe
from idrgbdo_torch.tracker.selection import select_points
from idrgbdo_torch.tracker.window import ITERATIONS, Window, depth_step


@pytest.fixture(scope="module")
def keyed(desk: Film) -> Desk:
    return make_desk(desk)


def cost(window: Window, limit: float = 1e9) -> float:
    K = len(window.members.keyframes)
    everything = np.ones((K, K), dtype=np.bool_)
    window.linearise(everything, limit)
    energy, _ = window.assemble(everything)
    return energy + 2 * float(prior_cost(window.prior, window.deviation()))


@pytest.mark.parametrize("seed", range(3))
def test_optimising_pulls_wrong_poses_back(keyed: Desk, seed: int) -> None:
    window = keyed.window(5, 4 * MM, 0.15 * DEGREE, seed)
    before, (metres, degrees) = cost(window), keyed.errors(window)
    assert metres[1:].min() > 3.5 * MM and degrees[1:].min() > 0.14
    assert 1 <= window.optimise() <= ITERATIONS
    after, (metres, degrees) = cost(window), keyed.errors(window)
    assert after < 0.7 * before
    assert metres.max() < 1.8 * MM and degrees.max() < 0.06


def test_the_answer_does_not_hang_on_the_start(keyed: Desk) -> None:
    poses = []
    for seed in range(3):
        window = keyed.window(5, 3 * MM, 0.1 * DEGREE, seed)
        window.optimise()
        window.optimise()
        poses.append(window.members.T)
    assert np.abs(poses[0] - poses[1]).max() < 3e-4 and np.abs(poses[0] - poses[2]).max() < 3e-4


def test_the_first_keyframe_stays(keyed: Desk) -> None:
    window = keyed.window(5, 4 * MM, 0.15 * DEGREE)
    first = window.members.T[0].copy()
    window.optimise()
    assert np.abs(window.members.T[0] - first).max() < 1e-6
    assert np.abs(window.members.affine[0]).max() < 0.05
    assert np.abs(window.members.T[1:] - keyed.window(5, 4 * MM, 0.15 * DEGREE).members.T[1:]).max() > 1 * MM


def test_one_keyframe_has_nothing_to_refine(keyed: Desk) -> None:
    window = keyed.window(1)
    assert window.optimise() == 0 and window.shrink() == []


def test_schur_step_is_the_dense_step(keyed: Desk) -> None:
    window = keyed.window(4, 3 * MM, 0.1 * DEGREE)
    everything = np.ones((4, 4), dtype=np.bool_)
    window.linearise(everything, 1e9)
    _, system = window.assemble(everything)
    prior = window.prior.H.numpy()
    H, b = FUSED.eliminate_depths(system)
    step = np.linalg.solve(H + prior, b)
    depths = depth_step(system, step)
    cross = system.cross.transpose(0, 2, 1).reshape(-1, len(H))
    dense = np.block([[system.H + prior, cross.T], [cross, np.diag(system.Hd.ravel())]])
    known = dense.diagonal() > 0
    assert known.all() == (system.Hd > 0).all()
    expected = np.linalg.solve(dense[known][:, known], np.concatenate([system.b, system.bd.ravel()])[known])
    mine = np.concatenate([step, depths.ravel()])[known]
    np.testing.assert_allclose(mine, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())


def test_unused_places_take_no_step() -> None:
    system = WindowSystem.empty(2, 3)
    system.Hd[:] = system.bd[:] = system.cross[:] = 0.0
    system.H[:] = np.eye(2 * STEP)
    system.b[:] = 1.0
    H, b = FUSED.eliminate_depths(system)
    assert np.array_equal(H, np.eye(2 * STEP)) and (b == 1).all() and (depth_step(system, b) == 0).all()


def test_refined_depths_reach_the_keyframes_where_tracking_reads_them(keyed: Desk) -> None:
    window = keyed.window(4, 1 * MM, 0.05 * DEGREE)
    window.optimise()
    for k, (refined, index) in enumerate(zip(window.members.keyframes, window.members.chosen, strict=True)):
        before, after = keyed.keyframes[k].points, refined.points
        assert np.array_equal(after.inv_depth[index], window.members.inv_depth[k, : len(index)])
        assert (after.inv_depth[index] != before.inv_depth[index]).mean() > 0.7
        assert (np.abs(after.inv_depth - before.inv_depth) < 6 * np.sqrt(before.var_inv_depth)).all()
        others = np.setdiff1d(np.arange(len(before.uv)), index)
        assert np.array_equal(after.inv_depth[others], before.inv_depth[others])
        assert (after.var_inv_depth[index] <= before.var_inv_depth[index] * (1 + 1e-12)).all()
        assert after.var_inv_depth[index].mean() < 0.95 * before.var_inv_depth[index].mean()
        assert np.array_equal(refined.measured, keyed.keyframes[k].measured)


def test_wrong_depths_are_pulled_back(keyed: Desk) -> None:
    window = keyed.window(4)
    exact = keyed.window(4)
    exact.optimise()
    window.members = window.members._replace(
        inv_depth=window.members.inv_depth
        * (1 + 0.02 * np.random.default_rng(0).standard_normal(window.members.inv_depth.shape))
    )
    off = np.abs(window.members.inv_depth - exact.members.inv_depth).mean()
    window.optimise()
    assert np.abs(window.members.inv_depth - exact.members.inv_depth).mean() < 0.1 * off


def test_brightness_is_chained_and_estimated(desk: Film, keyed: Desk) -> None:
    """Each frame brighter than the one before by a gain of 1.1 and an offset of 3, beside the camera's own drift."""

    def of_gray_100(gain: float, offset: float) -> np.ndarray:
        """What the keyframes make of gray level 100 of the first, if each is changed like this once more."""
        window = Window(CONFIG, NOISE, FUSED)
        total = np.array([0.0, 0.0])
        for n, k in enumerate(FRAMES[:4]):
            brighter = replace(desk.frames[k], gray=np.exp(total[0]) * desk.frames[k].gray + total[1])
            keyframe = make_keyframe(prepare(brighter), CONFIG, np.random.default_rng(0), FUSED)
            index = select_points(
                keyframe, np.eye(4), 24, PRIOR, CONFIG.selection, NOISE, np.random.default_rng(0), FUSED
            )
            change = np.array([np.log(gain), offset]) if n else NO_CHANGE
            window.add(keyframe, desk.T(k, 0).numpy(), change, index)
            np.testing.assert_allclose(window.members.affine[n], total, atol=1e-12)
            total = np.array([total[0] + np.log(gain), gain * total[1] + offset])
        window.optimise()
        assert keyed.errors(window)[0].max() < 1.5 * MM
        return np.exp(window.members.affine[:, 0]) * 100 + window.members.affine[:, 1]

    drift = of_gray_100(1.0, 0.0)
    assert 1 < np.abs(drift - 100).max() < 12
    expected = 1.1 ** np.arange(4) * drift + [0, 3, 3 * 2.1, 3 * 3.31]
    np.testing.assert_allclose(of_gray_100(1.1, 3.0), expected, atol=1.0)


def test_a_keyframe_with_few_points_and_one_with_none(keyed: Desk) -> None:
    window = keyed.window(3)
    for k, few in ((3, 5), (4, 0)):
        window.add(keyed.keyframes[k], keyed.film.T(FRAMES[k], 0).numpy(), NO_CHANGE, np.arange(few) * 20)
    window.optimise()
    metres, _ = keyed.errors(window)
    assert metres.max() < 2.2 * MM
    keyed.add(window, 5)
    window.optimise()
    assert len(window.shrink()) == 1 and np.isfinite(window.members.T).all()
