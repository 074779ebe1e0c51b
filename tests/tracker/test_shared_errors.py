"""What a reported covariance has besides the points' own: errors that they share."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from rendered import Film

from idrgbdo_torch.config import Config, SelectionConfig
from idrgbdo_torch.definitions.information import freedom_entropies_bits
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo
from idrgbdo_torch.tracker.shared_errors import INSTANT, SHARED, WIDE_SAYS, believed


def some_information(seed: int = 0) -> np.ndarray:
    A = 1e3 * np.random.default_rng(seed).standard_normal((40, 6))
    return A.T @ A


@pytest.mark.parametrize("points", [1, 24, 256])
def test_it_is_the_inverse_of_the_grown_covariance(points: int) -> None:
    information, velocity = some_information(), np.array([0.3, -0.1, 0.5, 1.0, 0.2, -0.7])
    grown = np.linalg.inv(information) * (1 + SHARED * (points - 1)) + INSTANT**2 * np.outer(velocity, velocity)
    np.testing.assert_allclose(believed(information, points, velocity), np.linalg.inv(grown), rtol=1e-6)


def test_one_point_at_rest_shares_nothing() -> None:
    information = some_information()
    np.testing.assert_array_equal(believed(information, 1, np.zeros(6)), information)
    np.testing.assert_array_equal(believed(information, 0, np.zeros(6)), information)


def test_where_there_is_no_information_there_is_none() -> None:
    np.testing.assert_array_equal(believed(np.zeros((6, 6)), 0, np.ones(6)), 0.0)


def test_a_frame_reports_it_and_its_entropies_with_it(desk: Film) -> None:
    odometry = IdRgbdo(Config(selection=SelectionConfig(points=96)))
    for frame in desk.frames[:5]:
        result = odometry.track(frame)
    assert odometry.last is not None and result.information is not None
    tracked, velocity = odometry.last[1], odometry.motion.velocity()
    assert tracked.points > 80 and np.abs(velocity).max() > 0.01
    np.testing.assert_allclose(
        result.information, believed(tracked.information, tracked.points, velocity, tracked.wide), rtol=1e-12
    )
    assert (result.information.diagonal() < WIDE_SAYS * torch.from_numpy(tracked.information).diagonal() / 1.05).all()
    assert result.entropy_bits == pytest.approx(freedom_entropies_bits(result.information).tolist())


def test_wide_patches_say_more_than_is_added_up() -> None:
    information = np.diag([4.0, 5.0, 6.0, 7.0, 8.0, 9.0])
    np.testing.assert_allclose(believed(information, 1, np.zeros(6), wide=True), WIDE_SAYS * information)
