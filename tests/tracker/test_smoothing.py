"""What hindsight makes of a run: keyframes that left follow those that stayed, frames lie between their keyframes."""

from __future__ import annotations

import numpy as np
import torch
from rendered import Film
from window_cases import MM

from idrgbdo_torch.config import Config, WindowConfig
from idrgbdo_torch.definitions import se3
from idrgbdo_torch.kernels.se3 import adjoint, inverse, log_se3, retract
from idrgbdo_torch.odometry import run
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo
from idrgbdo_torch.tracker.smoothing import between, departure, followed, smooth_keyframes


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


def test_what_moves_as_a_whole_takes_what_left_along() -> None:
    """Measured are relative poses alone, so that any world is as good as another."""
    K, T = 4, random_poses(4, 5)
    H = np.zeros((6 * K, 6 * K))
    for i in range(K):
        for j in range(i):
            J = np.zeros((6, 6 * K))
            J[:, 6 * i : 6 * i + 6], J[:, 6 * j : 6 * j + 6] = np.eye(6), -adjoint(T[i] @ inverse(T[j]))
            H += J.T @ random_information(1) @ J
    left = departure(T, H, 2)
    T_new_old = retract(np.array([1, -2, 3, 1, 2, -1]) * 1e-5, np.eye(4))
    moved = log_se3(followed(left, left.T_others @ T_new_old) @ inverse(left.T))
    np.testing.assert_allclose(moved, log_se3(left.T @ T_new_old @ inverse(left.T)), atol=1e-8)


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


def test_a_keyframe_s_own_frame_is_where_the_keyframe_is(desk: Film) -> None:
    odometry = IdRgbdo(Config(window=WindowConfig(keyframes=3)))
    done = run(odometry, desk.frames)
    numbers = [number for number, record in enumerate(done.records) if record.result.keyframe]
    smoothed = smooth_keyframes(odometry.history.keyframe_poses, odometry.history.departures)
    assert len(odometry.history.departures) == len(numbers) - odometry.config.window.keyframes > 1
    refined = odometry.trajectory().T_world_cam.numpy()
    for number, pose in zip(numbers, smoothed, strict=True):
        assert np.abs(refined[number] - inverse(pose)).max() < 1e-9
    causal = done.trajectory().T_world_cam.numpy()
    moved = [np.abs(log_se3(inverse(a) @ b)[:3]).max() for a, b in zip(causal[numbers], refined[numbers], strict=True)]
    assert 0.05 * MM < max(moved) < 5 * MM  # later keyframes taught something
