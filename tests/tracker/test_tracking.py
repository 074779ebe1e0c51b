"""Eq. 19 against autograd; tracking on rendered frames with exactly known motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from rendered import Film
from torch import Tensor
from torch.func import hessian, jacfwd
from tracking_cases import CONFIG, EYE, NO_CHANGE, NOISE, PRIOR, Case, make_cases

from idrgbdo_torch.config import NoiseConfig
from idrgbdo_torch.definitions import se3
from idrgbdo_torch.definitions.information import freedom_entropies_bits, log2_det
from idrgbdo_torch.definitions.tracking import motion_prior_terms
from idrgbdo_torch.frame import prepare
from idrgbdo_torch.kernels import tracking as alignment
from idrgbdo_torch.measurement import PIXELS, MotionPrior, State, Subset, System, kernel_noise, with_blur
from idrgbdo_torch.tracker.motion import predict, turn_rate
from idrgbdo_torch.tracker.tracking import (
    motion_information,
    pose_information,
    track_frame,
)
from idrgbdo_torch.tracker.verification import unsure


def twists(*shape: int, seed: int = 0, size: float = 1.0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return size * torch.randn(*shape, 6, generator=generator, dtype=torch.float64)


def test_motion_prior_terms_are_those_of_its_quadratic() -> None:
    frame, predicted = twists(2)
    J = twists(10, seed=1)
    information = J.mT @ J
    cost = lambda step: 0.5 * (frame + step - predicted) @ information @ (frame + step - predicted)
    H, b = motion_prior_terms(frame, predicted, information)
    zero = torch.zeros(6, dtype=torch.float64)
    torch.testing.assert_close(H, hessian(cost)(zero))
    torch.testing.assert_close(b, -jacfwd(cost)(zero))
    torch.testing.assert_close(torch.linalg.solve(H, b), predicted - frame)
    many = motion_prior_terms(twists(3, 2), predicted, information)[1]
    assert many.shape == (3, 2, 6)
    torch.testing.assert_close(many[1, 0], motion_prior_terms(twists(3, 2)[1, 0], predicted, information)[1])


def test_the_fused_prior_is_eq_19_about_the_predicted_pose() -> None:
    xi, xi_prior = twists(2, size=0.3)
    T, T_prior = se3.exp(xi), se3.exp(xi_prior)
    J = twists(10, seed=1)
    information = J.mT @ J
    away = se3.log(T @ se3.inverse(T_prior))
    brightness = np.array([[3.0, 0.5], [0.5, 2.0]])
    affine, centre = np.array([0.1, 4.0]), np.array([0.3, 1.0])
    H, b = np.zeros((8, 8)), np.zeros(8)
    system, state = System(H, b, np.zeros(0)), State(T.numpy(), affine)
    prior = MotionPrior(se3.inverse(T_prior).numpy(), information.numpy(), brightness)
    energy = alignment.prior_terms(system, state, centre, prior, brightness)
    H_true, b_true = motion_prior_terms(away, torch.zeros(6, dtype=torch.float64), information)
    np.testing.assert_allclose(H[:6, :6], H_true, rtol=1e-12)
    np.testing.assert_allclose(b[:6], b_true, rtol=1e-10)
    np.testing.assert_allclose(H[6:, 6:], brightness)
    np.testing.assert_allclose(b[6:], brightness @ (centre - affine))
    off = affine - centre
    assert energy == pytest.approx(float(away @ information @ away) + off @ brightness @ off, rel=1e-10)
    step = np.linalg.solve(H, b)  # alone, the prior brings everything to where it is centred
    torch.testing.assert_close(se3.retract(torch.from_numpy(step[:6]), T), T_prior)
    np.testing.assert_allclose(affine + step[6:], centre)


def test_what_a_level_heard_is_its_equations_without_the_motion_prior_and_the_brightness() -> None:
    xi, xi_prior = twists(2, size=0.1)
    T, T_prior = se3.exp(xi), se3.exp(xi_prior)
    J, K = twists(10, seed=1), torch.randn(30, 8, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    H, b = (K.mT @ K).numpy(), (K.mT @ torch.ones(30, dtype=torch.float64)).numpy()
    state, nothing = State(T.numpy(), np.zeros(2)), np.zeros((2, 2))
    prior = MotionPrior(se3.inverse(T_prior).numpy(), (J.mT @ J).numpy(), nothing)
    system = System(H.copy(), b.copy(), np.zeros(0))
    alignment.prior_terms(system, state, np.zeros(2), prior, nothing)
    heard = alignment.heard_of_pose(system, state, prior, 0.5)
    np.testing.assert_allclose(heard.H, 0.5 * pose_information(H), rtol=1e-8)
    step = np.linalg.solve(heard.H, heard.b)
    np.testing.assert_allclose(step, np.linalg.solve(H, b)[:6], rtol=1e-8)  # where the level itself would go
    system = System(np.zeros((8, 8)), np.zeros(8), np.zeros(0))
    away = State(se3.retract(torch.from_numpy(step), T).numpy(), np.zeros(2))
    energy = alignment.heard_terms(system, away, heard)
    np.testing.assert_allclose(system.b, 0.0, atol=1e-8)  # the best pose, by that alone
    assert energy == pytest.approx(-step @ heard.b)
    assert alignment.heard_terms(system, state, heard) == pytest.approx(0.0, abs=1e-12)


def test_motion_information_is_that_of_a_change_of_velocity() -> None:
    sigma = np.sqrt(np.diag(np.linalg.inv(motion_information(CONFIG, 1 / 30))))
    np.testing.assert_allclose(sigma[:3], CONFIG.tracking.sigma_velocity / 30)
    np.testing.assert_allclose(sigma[3:], CONFIG.tracking.sigma_turn / 30)
    gap = np.sqrt(np.diag(np.linalg.inv(motion_information(CONFIG, 4 / 30))))
    assert (gap > 4 * sigma).all()  # after a gap the velocity itself has changed more


def test_prediction_goes_on_at_the_same_velocity() -> None:
    xi, start = twists(2, size=0.1)
    T_b = se3.exp(start)
    T_a = se3.retract(xi, T_b)
    for ratio in (0.0, 1.0, 2.5):
        expected = se3.retract(ratio * xi, T_a)
        torch.testing.assert_close(torch.from_numpy(predict(T_a.numpy(), T_b.numpy(), ratio)), expected)


def test_turn_rate_is_in_radians_per_second() -> None:
    spin = torch.tensor([0.3, -0.1, 0.2, 0.4, 0.5, -0.3], dtype=torch.float64)  # m/s, rad/s
    T_old = se3.exp(twists(1)[0])
    T_new = se3.retract(0.05 * spin, T_old)
    np.testing.assert_allclose(turn_rate(T_new.numpy(), T_old.numpy(), 0.05), spin[3:], atol=1e-12)


def test_blur_that_differs_is_noise_of_position() -> None:
    turn = np.array([0.3, 0.0, 0.4])
    config = replace(CONFIG.noise, blur=0.04)
    assert with_blur(NOISE, config, 500.0, turn, turn) == NOISE
    blurred = with_blur(NOISE, config, 500.0, turn, np.zeros(3))
    added = 0.04 * 500 * 0.5 / 30  # px: blur x focal length x rad/s x s a frame
    assert blurred.var_pixel == pytest.approx(NOISE.var_pixel + NOISE.shared * added**2)
    assert blurred._replace(var_pixel=NOISE.var_pixel) == NOISE


def test_pose_information_marginalises_brightness() -> None:
    J = np.random.default_rng(0).standard_normal((30, 8))
    H = J.T @ J
    expected = np.linalg.inv(np.linalg.inv(H)[:6, :6])
    np.testing.assert_allclose(pose_information(H), expected, rtol=1e-9)


def test_the_least_certain_freedom_is_named() -> None:
    sure = torch.full((6,), -12.0, dtype=torch.float64)
    assert unsure(sure) == ""
    sure[4] = -5.0
    assert unsure(sure) == "rotation about y is uncertain: -5.0 bits"
    information = 1e8 * torch.eye(6, dtype=torch.float64)
    assert unsure(freedom_entropies_bits(information)) == ""
    information[2, 2] = 1e3
    assert unsure(freedom_entropies_bits(information)).startswith("z is uncertain")


@pytest.fixture(scope="module")
def cases(desk: Film) -> list[Case]:
    return make_cases(desk)


def test_tracking_finds_a_known_motion(cases: list[Case]) -> None:
    alone = NOISE._replace(coarse=0.0)  # the points of the finest level
    errors = {m: np.array([case.error(case.track(m, noise=alone)) for case in cases]) for m in (24, 256)}
    assert min(float(case.T[:3, 3].norm()) for case in cases) > 0.03
    assert (errors[24] < [0.002, 0.1]).all()
    assert (errors[256] < [0.001, 0.05]).all()
    assert errors[256][:, 0].mean() < 0.8 * errors[24][:, 0].mean()


def test_what_level_1_says_of_a_pose_counts_on_the_finest(cases: list[Case]) -> None:
    """Many coarse points help a few fine ones, and all that they know is in the information."""
    deaf = NOISE._replace(coarse=0.0)
    errors: dict[bool, list[float]] = {True: [], False: []}
    for case in cases:
        coarse, index = Subset(case.keyframe.coarse, PIXELS), case.choose(8)
        alone, both = (
            track_frame(case.pair(noise=noise), State(EYE, NO_CHANGE), index, coarse, PRIOR, 4)
            for noise in (deaf, NOISE)
        )
        errors[False].append(case.error(alone)[0])
        errors[True].append(case.error(both)[0])
        bits = [freedom_entropies_bits(torch.from_numpy(found.information)) for found in (alone, both)]
        assert (bits[1] < bits[0] - 0.3).all()
    assert np.mean(errors[True]) < 0.7 * np.mean(errors[False])


def test_points_are_chosen_ones_and_all_but_a_few_are_used(cases: list[Case]) -> None:
    for case in cases:
        tracked = case.track(24)
        assert tracked.index.tolist() == case.choose(24).tolist()
        assert 18 <= tracked.points <= 24 and len(tracked.rms) == 24
        assert (tracked.rms >= 0).sum() >= tracked.points
        assert 3 < tracked.iterations < 80
        assert (np.linalg.eigvalsh(tracked.information) > 0).all()


def test_information_grows_with_the_points_and_covers_the_error(cases: list[Case]) -> None:
    bits = lambda m: [float(log2_det(torch.from_numpy(case.track(m).information))) for case in cases]
    assert np.mean(bits(256)) > np.mean(bits(24)) + 6
    nees = [
        float(xi @ torch.from_numpy(tracked.information) @ xi) / 6
        for case in cases
        for tracked in [case.track(24)]
        for xi in [case.twist(tracked)]
    ]
    assert 0.1 < np.mean(nees) < 5


def test_the_answer_does_not_hang_on_the_guess(cases: list[Case]) -> None:
    for n, case in enumerate(cases):
        best = torch.from_numpy(case.track().T_frame_kf)
        guess = se3.retract(twists(1, seed=n, size=0.015)[0], case.T).numpy()
        again = torch.from_numpy(case.track(guess=guess).T_frame_kf)
        assert (best[:3, 3] - again[:3, 3]).norm() < 2e-4


def test_a_strong_prior_keeps_the_pose_at_the_guess_and_a_weak_one_does_not(cases: list[Case]) -> None:
    case = cases[0]
    held = case.track(prior=1e12 * np.eye(6))
    assert np.abs(held.T_frame_kf - EYE).max() < 1e-3
    # Eq. 19 belongs to the estimate, not to what is reported of it
    assert np.trace(held.information) < 1e10


def test_a_change_of_brightness_is_not_a_motion(cases: list[Case], desk: Film) -> None:
    case, bright = cases[1], replace(desk.frames[8], gray=1.2 * desk.frames[8].gray + 10)
    before, after = case.track(), case.track(frame=prepare(bright))
    assert np.abs(before.T_frame_kf - after.T_frame_kf).max() < 3e-4
    relative = after.affine - before.affine
    assert relative[0] == pytest.approx(np.log(1.2), abs=0.02) and relative[1] == pytest.approx(10, abs=2.5)


def test_moving_things_are_outliers(cases: list[Case], desk: Film) -> None:
    """A bright square that was not there before, over a twelfth of the image."""
    gray = desk.frames[3].gray.clone()
    gray[90:170, 120:200] = 255.0
    case = cases[0]
    tracked = case.track(96, frame=prepare(replace(desk.frames[3], gray=gray)))
    error, angle = case.error(tracked)
    assert error < 0.002 and angle < 0.1
    assert tracked.points < (tracked.rms >= 0).sum()


@pytest.mark.parametrize("variance", ["first_order", "paper"])
@pytest.mark.parametrize("depth_residual", [True, False])
def test_variants_of_the_noise_model(cases: list[Case], variance: str, depth_residual: bool) -> None:
    noise = kernel_noise(NoiseConfig(variance=variance, depth_residual=depth_residual))  # type: ignore[arg-type]
    for case in cases:
        coarse = Subset(case.keyframe.coarse, PIXELS)
        tracked = track_frame(case.pair(noise=noise), State(EYE, NO_CHANGE), case.choose(96), coarse, PRIOR, 4)
        error, angle = case.error(tracked)
        assert error < 0.005 and angle < 0.2


def test_inputs_are_not_changed(cases: list[Case]) -> None:
    case = cases[0]
    guess, affine, prior = np.eye(4), np.zeros(2), PRIOR.copy()
    copies = [x.copy() for x in (*case.frame.images, case.frame.depth, *case.keyframe.points)]
    case.track(guess=guess, affine=affine, prior=prior)
    assert np.array_equal(guess, EYE) and not affine.any() and np.array_equal(prior, PRIOR)
    now = (*case.frame.images, case.frame.depth, *case.keyframe.points)
    assert all(np.array_equal(x, y) for x, y in zip(copies, now, strict=True))
