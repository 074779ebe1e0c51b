"""One pattern in one order: what `host_points` samples is what `warp` looks up."""

from __future__ import annotations

import pytest
import torch
from rendered import Film

from idrgbdo_torch import HostPoints, host_points, linearize, pick_points, tracking_pyramid, warp
from idrgbdo_torch.definitions.points import TRACKED_LEVELS, at_level

EYE = torch.eye(4, dtype=torch.float64)
CENTRE_FIFTH = [1, 2, 3, 4, 0, 5, 6, 7]  # the order that a reader of DSO expects


@pytest.fixture(scope="module")
def points(desk: Film) -> HostPoints:
    frame = desk.frames[0]
    return host_points(frame.gray[None], *pick_points(frame.gray[None], frame.depth[None], 200))


@pytest.mark.parametrize("level", range(TRACKED_LEVELS))
def test_a_frame_against_itself_leaves_no_residual(desk: Film, points: HostPoints, level: int) -> None:
    frame = desk.frames[0]
    image = tracking_pyramid(frame.gray[None], TRACKED_LEVELS)[level]
    warped = warp(frame.camera.at_level(level), at_level(points.uv, level), points.inverse_depth, EYE)
    no_change = torch.zeros(2, dtype=torch.float64)
    term = linearize(image, warped, points.patch[level], no_change)
    assert term.valid.sum() > 100 and term.r.abs().max() < 1e-3
    sampled = points.gradient[level][term.valid].double()
    torch.testing.assert_close(term.gradient[term.valid], sampled, rtol=0, atol=1e-3)
    other = linearize(image, warped, points.patch[level][..., CENTRE_FIFTH], no_change)
    assert other.r.abs().mean() > 1.0  # gray levels: the check would notice


def test_the_first_pixel_is_the_point_itself(desk: Film, points: HostPoints) -> None:
    frame = desk.frames[0]
    warped = warp(frame.camera, points.uv, points.inverse_depth, EYE)
    there = points.inverse_depth > 0
    torch.testing.assert_close(warped.uv[there][:, 0], points.uv[there], rtol=0, atol=1e-9)
    u, v = points.uv[0].long().unbind(-1)
    torch.testing.assert_close(points.patch[0][0, :, 0], frame.gray[v, u].double(), rtol=0, atol=1e-4)
