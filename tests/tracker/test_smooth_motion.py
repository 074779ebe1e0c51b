"""Frames between keyframes are steadied by hindsight: as far as their motion is smooth, and no further."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import torch
from rendered import Film
from window_cases import MM

from idrgbdo_torch.definitions import se3
from idrgbdo_torch.definitions.records import UPPER
from idrgbdo_torch.kernels.se3 import inverse, log_se3
from idrgbdo_torch.tracker import smooth_motion
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo
from idrgbdo_torch.tracker.smooth_motion import Stretch, changes_of_acceleration, smoothed

N = 180
TIMES = np.arange(N) / 30
NOISE = np.array([0.3, 0.3, 0.3, 0.2, 0.2, 0.2]) * MM  # m and rad, of a frame


def hand(times: np.ndarray, hertz: float = 0.7, size: float = 0.05) -> torch.Tensor:
    """(N, 4, 4) T_cam_world of a camera that sways and turns."""
    phase = torch.from_numpy(2 * np.pi * hertz * times)[:, None] + torch.arange(6)
    return se3.exp(size * phase.sin() * torch.tensor([1.0, 1, 1, 2, 2, 2], dtype=torch.float64))


def measured(truth: torch.Tensor, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Its poses with noise, and the information that each has."""
    noise = np.random.default_rng(seed).standard_normal((len(truth), 6)) * NOISE
    information = np.tile(np.diag(1 / NOISE**2)[UPPER], (len(truth), 1)).astype("float32")
    return se3.retract(torch.from_numpy(noise), truth).numpy(), information


def error(T: np.ndarray, truth: torch.Tensor) -> float:
    """Root mean square of the translations' errors, m."""
    return float(se3.log(torch.from_numpy(T) @ se3.inverse(truth))[:, :3].square().sum(1).mean().sqrt())


def keyframes(n: int = N, every: int = 8) -> np.ndarray:
    return np.arange(n) % every == 0


def test_half_of_what_a_smooth_motion_cannot_explain_goes() -> None:
    truth = hand(TIMES)
    T, information = measured(truth)
    held = np.zeros(N, dtype=bool)
    assert error(smoothed(TIMES, T, information, held), truth) < 0.6 * error(T, truth)


def test_keyframes_stay_and_the_others_profit_from_them() -> None:
    truth, held = hand(TIMES), keyframes()
    T, information = measured(truth)
    T[held] = truth.numpy()[held]
    out = smoothed(TIMES, T, information, held)
    np.testing.assert_array_equal(out[held], T[held])
    assert error(out, truth) < 0.6 * error(T, truth)


def test_a_motion_that_is_not_smooth_is_left_as_it_was_measured() -> None:
    """A robot on rubble: how strong the jerk is says the motion itself."""
    shaken = np.random.default_rng(3).standard_normal((N, 6)) * 20 * NOISE
    truth = se3.retract(torch.from_numpy(shaken), hand(TIMES))
    T, information = measured(truth)
    assert error(smoothed(TIMES, T, information, keyframes()), truth) < 1.02 * error(T, truth)


def test_a_sudden_stop_in_the_middle_costs_little() -> None:
    times = np.where(TIMES < 2, TIMES, 2.0)
    truth = hand(times, 0.3, 0.2)  # 0.4 m/s, and then at rest
    T, information = measured(truth)
    assert error(smoothed(TIMES, T, information, keyframes()), truth) < error(T, truth)


@pytest.mark.parametrize("unknown", [0.0, np.nan, np.inf])
def test_frames_that_nothing_was_measured_of_stay_and_part_the_others(unknown: float) -> None:
    truth = hand(TIMES)
    T, information = measured(truth)
    information[50:60] = unknown
    T[50:60] = T[49]
    out = smoothed(TIMES, T, information, np.zeros(N, dtype=bool))
    np.testing.assert_array_equal(out[50:60], T[50:60])
    alone = smoothed(TIMES[:50], T[:50], information[:50], np.zeros(50, dtype=bool))
    np.testing.assert_allclose(out[:50], alone, atol=1e-12)


@pytest.mark.parametrize(
    "odd", ["twice the same time", "nearly the same time", "a second without frames", "three frames", "no frame"]
)
def test_times_as_they_come(odd: str) -> None:
    times, n = TIMES.copy(), {"three frames": 3, "no frame": 0}.get(odd, N)
    times[60:] += {
        "twice the same time": -1 / 30,
        "nearly the same time": 1e-6 - 1 / 30,
        "a second without frames": 1.0,
    }.get(odd, 0.0)
    T, information = measured(hand(times))
    out = smoothed(times[:n], T[:n], information[:n], keyframes(n))
    assert out.shape == (n, 4, 4)
    assert np.isfinite(out).all()
    if n == N:
        cut = smoothed(times[:60], T[:60], information[:60], keyframes(60))
        np.testing.assert_allclose(out[:60], cut, atol=1e-12)
    else:
        np.testing.assert_array_equal(out, T[:n])


def test_changes_of_acceleration_are_linear_about_the_poses() -> None:
    """The jacobians against finite differences, at uneven times."""
    times = torch.from_numpy(TIMES[:12] + 0.004 * np.sin(np.arange(12)))
    T = hand(times.numpy())
    changes, jacobians = changes_of_acceleration(times, T)
    increments = 1e-6 * torch.from_numpy(np.random.default_rng(0).standard_normal((12, 6)))
    actual = changes_of_acceleration(times, se3.retract(increments, T))[0] - changes
    four = torch.stack([increments[k : k + 4] for k in range(9)])
    predicted = torch.einsum("nikj,nkj->ni", jacobians, four)
    # the curvature of the group is left out
    torch.testing.assert_close(actual, predicted, rtol=0, atol=0.02 * float(predicted.abs().max()))


def test_the_increments_are_the_minimum_and_the_evidence_is_the_integral() -> None:
    """Against dense matrices: the minimum of the cost, and log of the determinants."""
    n = 10
    times, held = TIMES[:n], keyframes(n, 5)
    T = measured(hand(times))[0]
    information = np.tile(np.diag(1 / NOISE**2), (n, 1, 1))
    system = Stretch.of(times, T, information, held)
    sigma = np.array([0.3, 2.0])
    J = np.zeros((6 * (n - 3), 6 * n))
    jacobians = changes_of_acceleration(torch.from_numpy(times), torch.from_numpy(T))[1].reshape(-1, 6, 24)
    for k in range(n - 3):
        J[6 * k : 6 * k + 6, 6 * k : 6 * k + 24] = jacobians[k]
    J[:, np.repeat(held, 6)] = 0.0
    W = np.diag(np.tile(np.repeat(1 / sigma**2, 3), n - 3))
    L = np.zeros((6 * n, 6 * n))
    for k in range(n):
        L[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] = np.eye(6) if held[k] else information[k]
    r, H = system.changes.reshape(-1), J.T @ W @ J + L
    x = -np.linalg.solve(H, J.T @ W @ r)
    evidence, increments = system.most_likely(sigma)
    np.testing.assert_allclose(increments.reshape(-1), x, rtol=1e-7, atol=1e-12)
    left = r + J @ x
    cost = left @ W @ left + x @ L @ x
    expected = 0.5 * (cost + np.linalg.slogdet(H)[1] - np.linalg.slogdet(W)[1])
    assert evidence == pytest.approx(expected, rel=1e-9)
    np.testing.assert_array_equal(increments[held], 0.0)


def test_pieces_of_a_long_run_fit_together(monkeypatch: pytest.MonkeyPatch) -> None:
    truth, held = hand(TIMES), keyframes()
    T, information = measured(truth)
    monkeypatch.setattr(smooth_motion, "_search", lambda system: system.most_likely(smooth_motion.USUAL)[1])
    whole = smoothed(TIMES, T, information, held)
    monkeypatch.setattr(smooth_motion, "STRETCH", 30)
    pieces = smoothed(TIMES, T, information, held)
    apart = [np.abs(log_se3(a @ inverse(b))).max() for a, b in zip(pieces, whole, strict=True)]
    assert max(apart) < 0.02 * MM


def test_a_film_s_refined_frames_lie_smoother(desk: Film) -> None:
    """Steps between neighbouring frames err less than those that were tracked."""
    odometry = IdRgbdo()
    causal = [odometry.track(frame).T_world_cam.numpy() for frame in desk.frames]
    truth = desk.groundtruth.T_world_cam.numpy()

    def of_steps(T: list[np.ndarray]) -> float:
        steps = [inverse(a) @ b for a, b in pairwise(T)]
        right = [inverse(a) @ b for a, b in pairwise(truth)]
        return float(np.mean([np.linalg.norm(log_se3(inverse(a) @ b)[:3]) for a, b in zip(steps, right, strict=True)]))

    refined = odometry.trajectory().T_world_cam.numpy()
    assert of_steps(list(refined)) < 0.75 * of_steps(causal)
