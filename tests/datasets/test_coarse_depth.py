"""Depth that is coarser than colour: surfaces stay smooth, edges sharp, and no holes arise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from idrgbdo_torch.datasets.calibration import Calibration, DepthCamera
from idrgbdo_torch.datasets.rectify import Registration

COLOR = Calibration(262.5, 262.5, 159.5, 119.5)
BESIDE = ((1.0, 0, 0, 1e-6), (0, 1.0, 0, 0), (0, 0, 1.0, 0))  # as good as the same place, but not recognised as such


def coarse(times: int, T: tuple[tuple[float, ...], ...] = (), offset: float = 0.0) -> Registration:
    """A depth camera in the same place with so many times fewer pixels, whose centres are moved by `offset` px."""
    centre = [(c + 0.5) / times - 0.5 + offset for c in (159.5, 119.5)]
    depth = DepthCamera(262.5 / times, 262.5 / times, *centre, T)
    return Registration(replace(COLOR, depth=depth), COLOR.pinhole(320, 240))


def plane(times: int, offset: float = 0.0) -> np.ndarray:
    """Depth of a slanted plane, 1 / (0.5 + 0.1 x + 0.05 y) of the ray (x, y, 1), in the coarse camera."""
    v, u = np.indices((240 // times, 320 // times))
    x, y = ((k - (c + 0.5) / times + 0.5 - offset) * times / 262.5 for k, c in ((u, 159.5), (v, 119.5)))
    return (1 / (0.5 + 0.1 * x + 0.05 * y)).astype(np.float32)


@pytest.mark.parametrize("T", [(), BESIDE], ids=["map", "points"])
@pytest.mark.parametrize("times", [2, 4, 8])
def test_a_slanted_plane_has_no_steps(times: int, T: tuple[tuple[float, ...], ...]) -> None:
    registered = coarse(times, T).depth(plane(times))
    expected = plane(1)
    inner = np.s_[2 * times : -2 * times, 2 * times : -2 * times]
    assert float((registered[inner] > 0).mean()) == 1.0
    errors = (registered - expected)[inner]
    slope = np.abs(np.diff(expected, axis=1)).max()  # m a pixel; repeated values would be wrong by times / 2 of it
    assert np.abs(errors).max() < (0.6 if T else 0.02) * slope
    steps = np.diff(registered, axis=1)[inner]
    assert (steps < 0).mean() > (0.9 if not T else 0.6)  # it goes on falling, pixel by pixel


@pytest.mark.parametrize("T", [(), BESIDE], ids=["map", "points"])
def test_an_edge_stays_an_edge_and_a_hole_a_hole(T: tuple[tuple[float, ...], ...]) -> None:
    depth = np.where(np.indices((60, 80))[1] < 40, np.float32(1.0), np.float32(2.0)).astype(np.float32)
    depth[20:24, 20:24] = 0
    registered = coarse(4, T).depth(depth)
    assert set(np.unique(registered).round(4)) == {0.0, 1.0, 2.0}
    assert float(np.abs(np.diff(registered[120])).max()) == pytest.approx(1.0, abs=1e-4)
    assert not registered[82:94, 82:94].any()


@pytest.mark.parametrize("times", [1, 2, 4])
@pytest.mark.parametrize("offset", [0.0, 0.125, 0.25, 0.5])
def test_points_that_fall_between_pixels_leave_no_holes(times: int, offset: float) -> None:
    registered = coarse(times, BESIDE, offset).depth(plane(times, offset))
    assert float((registered[16:-16, 16:-16] > 0).mean()) == 1.0


def test_finer_depth_is_taken_as_it_is() -> None:
    """Nothing is interpolated where depth has as many pixels as colour, or more."""
    fine = Registration(replace(COLOR, depth=DepthCamera(525, 525, 319.5, 239.5)), COLOR.pinhole(320, 240))
    depth = np.random.default_rng(0).uniform(1.0, 1.01, (480, 640)).astype(np.float32)
    assert np.isin(fine.depth(depth), depth).all()
