"""Pinhole camera: projection, its Jacobians against autograd, pyramid levels, and points that cannot be seen."""

from __future__ import annotations

import pytest
import torch
from torch.func import jacfwd

from idrgbdo_torch.definitions.camera import (
    Pinhole,
    backproject,
    dP_dinverse_depth,
    duv_dP,
    inside,
    project,
)
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.measurement import inverse_depth_sigma

CAMERA = Pinhole(width=640, height=480, fx=525.0, fy=520.0, cx=319.5, cy=239.5)
UV = torch.tensor([[319.5, 239.5], [0.0, 0.0], [600.25, 13.75]], dtype=torch.float64)
D = torch.tensor([0.5, 1.0, 0.123], dtype=torch.float64)


def test_projection_undoes_backprojection() -> None:
    for dtype, tolerance in ((torch.float32, 1e-4), (torch.float64, 1e-11)):
        P = backproject(CAMERA, UV.to(dtype), D.to(dtype))
        assert P.dtype == dtype
        torch.testing.assert_close(1 / P[:, 2], D.to(dtype))
        uv, valid = project(CAMERA, P)
        assert valid.all() and uv.dtype == dtype
        torch.testing.assert_close(uv, UV.to(dtype), atol=tolerance, rtol=0)


def test_axis_and_one_known_point() -> None:
    uv, valid = project(CAMERA, torch.tensor([[0.0, 0.0, 2.0], [1.0, -0.5, 2.0]]))
    assert valid.all()
    torch.testing.assert_close(uv, torch.tensor([[319.5, 239.5], [319.5 + 262.5, 239.5 - 130.0]]))


def test_batches_broadcast() -> None:
    P = backproject(CAMERA, UV[:, None], D)  # (3, 1, 2) by (3,)
    assert P.shape == (3, 3, 3)
    torch.testing.assert_close(P[1, 2], backproject(CAMERA, UV[1], D[2]))


def test_jacobians_against_autograd() -> None:
    for uv, d in zip(UV, D, strict=True):
        P = backproject(CAMERA, uv, d)
        torch.testing.assert_close(duv_dP(CAMERA, P), jacfwd(lambda p: project(CAMERA, p)[0])(P))
        expected = jacfwd(lambda x, uv=uv: backproject(CAMERA, uv, x))(d)
        torch.testing.assert_close(dP_dinverse_depth(CAMERA, uv, d), expected)


def test_points_that_cannot_be_seen_are_invalid_and_never_nan() -> None:
    nan, inf = float("nan"), float("inf")
    P = torch.tensor([[0.1, 0.2, 0.0], [1.0, 1.0, -2.0], [nan, 0.0, 1.0], [0.0, 0.0, inf], [0.0, 0.0, 0.0]])
    P.requires_grad_()
    uv, valid = project(CAMERA, P)
    assert not valid.any()
    assert torch.isfinite(uv).all() and (duv_dP(CAMERA, P) == 0).all()
    uv.sum().backward()
    assert P.grad is not None and (P.grad == 0).all()
    d = torch.tensor([0.0, -1.0, nan, inf], requires_grad=True)
    points = backproject(CAMERA, torch.zeros(4, 2), d)
    assert (points == 0).all() and (dP_dinverse_depth(CAMERA, torch.zeros(4, 2), d) == 0).all()
    points.sum().backward()
    assert d.grad is not None and (d.grad == 0).all()


def test_inside_and_its_margin() -> None:
    uv = torch.tensor([[0.0, 0.0], [639.0, 479.0], [639.1, 10.0], [-0.1, 10.0], [19.9, 30.0], [20.0, 30.0]])
    assert inside(CAMERA, uv).tolist() == [True, True, False, False, True, True]
    assert inside(CAMERA, uv, margin=20.0).tolist() == [False, False, False, False, False, True]
    assert not inside(CAMERA, torch.tensor([float("nan"), 1.0]))


def test_a_level_sees_the_same_point_at_the_scaled_pixel() -> None:
    P = backproject(CAMERA, UV, D)
    for level in range(4):
        uv, _ = project(CAMERA.at_level(level), P)
        torch.testing.assert_close(uv, (UV + 0.5) * 0.5**level - 0.5)


def test_depth_noise() -> None:
    assert inverse_depth_sigma(40.0, 0.16) == pytest.approx(0.004)
    # a disparity f b d that is off by sigma_px moves d by sigma_d
    assert 40.0 * inverse_depth_sigma(40.0, 0.3) == pytest.approx(0.3)
    with pytest.raises(IdRgbdoError, match="focal_baseline"):
        inverse_depth_sigma(0.0, 0.1)
    with pytest.raises(IdRgbdoError, match="sigma_disparity"):
        inverse_depth_sigma(40.0, float("nan"))
