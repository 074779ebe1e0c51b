"""What leaves the window: which keyframe goes, and the prior that stays of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from rendered import Film
from window_cases import CONFIG, DEGREE, MM, Desk, make_desk, twists

from idrgbdo_torch.config import WindowConfig
from idrgbdo_torch.definitions import se3
from idrgbdo_torch.definitions.marginalization import LinearPrior, prior_gradient, redundancy_bits
from idrgbdo_torch.kernels.se3 import adjoint, inverse
from idrgbdo_torch.measurement import STEP
from idrgbdo_torch.tracker.window import PROTECTED, SLOTS


@pytest.fixture(scope="module")
def keyed(desk: Film) -> Desk:
    return make_desk(desk)


def test_the_window_keeps_its_size_and_its_newest(keyed: Desk) -> None:
    window = keyed.window(5)
    assert window.shrink() == []
    for k in (5, 6):
        keyed.add(window, k)
        window.optimise()
        newest = [keyframe.frame.timestamp for keyframe in window.members.keyframes[-PROTECTED:]]
        removed = window.shrink()
        assert len(removed) == 1 and removed[0][0] < 6 - PROTECTED
        assert len(window.members.keyframes) == len(window.members.chosen) == 5
        assert [keyframe.frame.timestamp for keyframe in window.members.keyframes[-PROTECTED:]] == newest
        assert window.prior.H.shape == (5 * STEP,) * 2 and window.prior.b.shape == (5 * STEP,)
        views = window.views()
        assert len(views.images) == len(views.depths) == SLOTS  # the same kernels whatever the number of keyframes
        for k, keyframe in enumerate(window.members.keyframes):
            assert views.images[k] is keyframe.frame.images[0] and views.depths[k] is keyframe.frame.depth
    window.optimise()
    assert keyed.errors(window)[0].max() < 2 * MM


def test_removal_takes_the_most_redundant_or_the_oldest(keyed: Desk) -> None:
    window = keyed.window(6, config=replace(CONFIG, window=WindowConfig(keyframes=5, removal="information")))
    window.optimise()
    k = window.least_useful(window.pose_information())
    H = window.solved.reduced
    brightness = np.arange(len(H)) % STEP >= 6
    poses = np.linalg.inv(np.linalg.inv(H)[~brightness][:, ~brightness])
    psi = redundancy_bits(torch.from_numpy(0.5 * (poses + poses.T)))
    assert k == int(psi[: 6 - PROTECTED].argmax())
    oldest = keyed.window(6, config=replace(CONFIG, window=WindowConfig(keyframes=5, removal="oldest")))
    oldest.optimise()
    assert oldest.least_useful(oldest.pose_information()) == 0


def test_removal_takes_who_tells_the_next_view_least(keyed: Desk) -> None:
    """A view at the newest keyframe, joined to the system with its links, and without one of them."""
    window = keyed.window(6)
    window.optimise()
    information, K = window.pose_information(), 6
    T = window.members.T
    links = []
    for k in [0, 1, 2, 3, 4, 4]:  # of the last pair also as those of the view and the newest
        A = -window.solved.system.H[STEP * 5 : STEP * 5 + 6, STEP * k : STEP * k + 6] @ np.linalg.inv(
            adjoint(T[5] @ inverse(T[k]))
        )
        links.append(0.5 * (A + A.T))

    def view_information(without: int) -> float:
        joint = np.zeros((6 * K + 6,) * 2)
        joint[:-6, :-6] = information
        for k in range(K):
            if k != without:
                J = np.zeros((6, 6 * K + 6))
                J[:, -6:], J[:, 6 * k : 6 * k + 6] = np.eye(6), -adjoint(T[5] @ inverse(T[k]))
                joint += J.T @ links[k] @ J
        return float(np.linalg.slogdet(np.linalg.inv(np.linalg.inv(joint)[-6:, -6:]))[1])

    everything = view_information(-1)
    expected = [0.5 * (everything - view_information(k)) / np.log(2) for k in range(K)]
    np.testing.assert_allclose(window.next_view_bits(information), expected, rtol=0.01, atol=1e-4)
    assert window.least_useful(information) == int(np.argmin(expected[:4]))


def test_a_keyframe_out_of_sight_goes_first(keyed: Desk) -> None:
    window = keyed.window(6)
    window.optimise()
    window.members.pairs.rms[2, -1] = -1.0  # none of its points is seen by the newest
    assert window.least_useful(window.pose_information()) == 2
    window.members.pairs.rms[4, -1] = -1.0  # protected
    window.members.pairs.rms[2, -1] = 1.0
    assert window.least_useful(window.pose_information()) < 4


@pytest.mark.parametrize("k", [0, 2])
def test_marginalising_is_dense_elimination_of_its_points_and_itself(keyed: Desk, k: int) -> None:
    """And the prior's pull on the kept is, at the present state, what the removed terms pulled (Eqs. 23, 25)."""
    window = keyed.window(5, 2 * MM, 0.05 * DEGREE)
    window.optimise()
    for again in (False, True):  # the second time on top of a prior, with poses that have moved since
        K = len(window.members.keyframes)
        hosts = np.arange(K) == k
        pairs = np.repeat(hosts[:, None], K, axis=1)
        _, system = window.assemble(pairs)
        cross = system.cross.transpose(0, 2, 1).reshape(-1, STEP * K)
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
            window.members = window.members._replace(
                T=se3.retract(twists(4, 1 * MM, 1e-3), torch.from_numpy(window.members.T)).numpy()
            )


def test_marginalising_at_the_optimum_hardly_moves_the_rest(keyed: Desk) -> None:
    window = keyed.window(5, 2 * MM, 0.05 * DEGREE)
    for _ in range(3):
        window.optimise()
    kept = window.members.T[[0, 2, 3, 4]]
    window.marginalise(1)
    window.optimise()
    assert np.abs(window.members.T - kept).max() < 4e-4


def test_the_prior_pulls(keyed: Desk) -> None:
    window = keyed.window(5)
    window.optimise()
    x = 3 * STEP  # of the fourth keyframe
    H, b = window.prior.H.clone(), window.prior.b.clone()
    H[x, x] += 1e10
    b[x] += 1e10 * (5 * MM + float(window.deviation()[x]))  # as if something else had measured it 5 mm away
    before = window.members.T.copy()
    window.prior = LinearPrior(H, b)
    for _ in range(3):
        window.optimise()
    moved = se3.log(torch.from_numpy(window.members.T) @ se3.inverse(torch.from_numpy(before)))
    assert moved[3, 0] == pytest.approx(5 * MM, rel=0.05)
    assert moved[0].abs().max() < 2e-5  # which holds the gauge


@pytest.mark.parametrize("first_estimates", [True, False])
def test_first_estimates_do_not_move(keyed: Desk, first_estimates: bool) -> None:
    config = replace(CONFIG, window=WindowConfig(keyframes=5, first_estimates=first_estimates))
    window = keyed.window(6, 2 * MM, 0.05 * DEGREE, config=config)
    window.optimise()
    window.marginalise(1)
    assert window.members.in_prior[0] and window.members.in_prior.sum() >= 3
    fixed, moving = window.members.in_prior.copy(), window.members.T.copy()
    linear = window.members.T_linear.copy()
    np.testing.assert_array_equal(linear[fixed][1:], moving[fixed][1:])
    keyed.add(window, 6, twists(2, 2 * MM, 0.05 * DEGREE)[1])
    window.optimise()
    assert np.abs(window.members.T[:-1] - moving).max() > 1e-5
    np.testing.assert_array_equal(window.members.T_linear[:-1][fixed], linear[fixed])
    window.marginalise(1)
    kept = np.delete(np.arange(5), 1)
    np.testing.assert_array_equal(window.members.T_linear[: len(kept)][fixed[kept]], linear[kept][fixed[kept]])
    assert window.deviation().abs().max() > 0
    everything = np.ones((5, 5), dtype=np.bool_)
    window.linearise(everything, 1e9)
    _, at_state = window.assemble(everything)
    window.members = window.members._replace(T_linear=window.members.T.copy())
    window.linearise(everything, 1e9)
    _, relinearised = window.assemble(everything)
    assert np.array_equal(at_state.H, relinearised.H) != first_estimates
