"""What hindsight makes of a run: keyframes that left follow those that stayed, frames lie between their keyframes."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from rendered import Film
from window_cases import MM, Desk, make_desk

from idrgbdo_torch.config import Config
from idrgbdo_torch.definitions import se3
from idrgbdo_torch.evaluation import evaluate
from idrgbdo_torch.kernels.se3 import inverse, log_se3, retract
from idrgbdo_torch.odometry import run
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo
from idrgbdo_torch.tracker.smoothing import between, departure, followed, smooth_keyframes


@pytest.fixture(scope="module")
def keyed(desk: Film) -> Desk:
    return make_desk(desk)


def random_poses(count: int, seed: int) -> np.ndarray:
    xi = 0.3 * torch.randn(count, 6, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return se3.exp(xi).numpy()


def random_information(K: int) -> np.ndarray:
    A = np.random.default_rng(K).standard_normal((12 * K, 6 * K))
    return A.T @ A


def test_what_left_goes_where_the_whole_system_would_have_put_it() -> None:
    """Two leave one after the other; then the rest learns something. As if nothing had been marginalised."""
    K, few = 5, 1e-4
    T, H = random_poses(K, 0), random_information(K)
    first = departure(T, H, 1)
    stayed = np.repeat(np.arange(K) != 1, 6)
    rest = H[stayed][:, stayed] - H[stayed][:, ~stayed] @ np.linalg.solve(H[~stayed][:, ~stayed], H[~stayed][:, stayed])
    second = departure(np.delete(T, 1, axis=0), rest, 0)
    news = np.zeros(6 * K)
    news[-6:] = few * H[-6:, -6:].diagonal()
    y = np.linalg.solve(H, news)  # the answer of all five together
    expected = np.stack([retract(y[6 * k : 6 * k + 6], T[k]) for k in range(K)])
    poses = [T[0], T[1], *expected[2:]]
    smoothed = smooth_keyframes(poses, [(1, (0, 2, 3, 4), first), (0, (2, 3, 4), second)])
    assert max(np.abs(log_se3(T[k] @ inverse(expected[k]))).max() for k in (0, 1)) > 1e-6
    for k in range(K):
        assert np.abs(log_se3(smoothed[k] @ inverse(expected[k]))).max() < 1e-8


def test_what_moves_as_a_whole_takes_what_left_along(keyed: Desk) -> None:
    window = keyed.window(6)
    window.optimise()
    (_, _, left), *_ = window.shrink()
    push = np.array([2 * MM, -1 * MM, 3 * MM, 0.01, -0.02, 0.005])
    T_new_old = retract(push, np.eye(4))  # another world
    pose = followed(left, left.T_others @ T_new_old)
    # not to the last digit: the first keyframe's prior knows the old world, and the motion is not small
    assert np.abs(log_se3(pose @ inverse(left.T @ T_new_old))[:3]).max() < 0.5 * MM


def test_a_keyframe_without_information_stays() -> None:
    H = random_information(3)
    H[6:12] = H[:, 6:12] = 0.0
    left = departure(random_poses(3, 1), H, 1)
    assert np.abs(followed(left, left.T_others @ random_poses(1, 2)[0]) - left.T).max() < 1e-12


def test_a_frame_takes_its_share_of_the_later_keyframes_correction() -> None:
    T_kf, T_frame_kf, T_next_kf = random_poses(3, 3)
    correction = np.array([1, 2, -3, 0.5, 0.2, 0.1]) * MM
    T_next = retract(correction, T_next_kf @ T_kf)
    for share in (0.0, 0.4, 1.0):
        moved = log_se3(between(T_frame_kf, T_kf, T_next_kf, T_next, share) @ inverse(T_frame_kf @ T_kf))
        np.testing.assert_allclose(moved, share * correction, atol=1e-12)
    assert np.abs(between(T_next_kf, T_kf, T_next_kf, T_next, 1.0) - T_next).max() < 1e-12


def test_hindsight_is_better(desk: Film) -> None:
    odometry = IdRgbdo(Config())
    odometry.reset(desk.groundtruth.T_world_cam[0])
    done = run(odometry, desk.frames)
    causal, refined = (evaluate(t, desk.groundtruth) for t in (done.trajectory(), odometry.trajectory()))
    assert refined.ate.rmse_m < 0.95 * causal.ate.rmse_m
    keyframes = [number for number, record in enumerate(done.records) if record.result.keyframe]
    smoothed = smooth_keyframes(odometry.history.keyframe_poses, odometry.history.departures)
    assert len(odometry.history.departures) == len(keyframes) - odometry.config.window.keyframes > 3
    for frame, pose in zip(keyframes, smoothed, strict=True):  # a keyframe's own frame is where the keyframe is
        assert np.abs(odometry.trajectory().T_world_cam[frame].numpy() - inverse(pose)).max() < 1e-9
