"""Residual variances and information of the measurement model, on the analytic world of plane_world."""

from __future__ import annotations

import pytest
import torch
from plane_world import (
    AFFINE,
    CAMERA,
    FACING,
    T_TARGET_HOST,
    XI,
    host_intensity,
    one_point,
    points,
    render,
)
from torch.func import jacfwd

from idrgbdo_torch.definitions import se3
from idrgbdo_torch.definitions.camera import duv_dP, project
from idrgbdo_torch.definitions.photometric import (
    PATTERN,
    Warp,
    distortion_weight,
    gradient_information,
    linearize,
    photometric_variance,
    projective_distortion,
    residual_variance,
    warp,
)
from idrgbdo_torch.errors import IdRgbdoError


def test_distortion_is_the_determinant_of_the_warp() -> None:
    uv, d = one_point()
    for xi in (XI, 5 * XI, torch.tensor([0.3, 0.2, -0.8, 0.3, -0.4, 1.0], dtype=torch.float64)):
        T = se3.exp(xi)
        dp_dp = jacfwd(lambda p, T=T: warp(CAMERA, p, d, T).centre)(uv)
        P = warp(CAMERA, uv, d, T).P
        torch.testing.assert_close(projective_distortion(d, P, T), torch.linalg.det(dp_dp))
    nearer = se3.exp(torch.tensor([0, 0, -1.0, 0, 0, 0], dtype=torch.float64))
    z = 1 / d - 1
    torch.testing.assert_close(projective_distortion(d, warp(CAMERA, uv, d, nearer).P, nearer), (1 / (d * z)) ** 2)


def test_a_surface_seen_from_behind_has_negative_distortion() -> None:
    # rotate by 120 degrees about the axis through the point: the target looks at the back of the frontal plane
    point = torch.tensor([0.0, 0.0, 2.0], dtype=torch.float64)
    turn = se3.exp(torch.tensor([0, 0, 0, 0, 2.1, 0], dtype=torch.float64))
    T = turn.clone()
    T[:3, 3] = point - turn[:3, :3] @ point
    uv, d = torch.tensor([161.5, 117.5], dtype=torch.float64), torch.tensor(0.5, dtype=torch.float64)
    warped = warp(CAMERA, uv, d, T)
    delta_A = projective_distortion(d, warped.P, T)
    assert delta_A < 0
    assert not distortion_weight(delta_A)[1]


def test_distortion_weight() -> None:
    delta_A = torch.tensor([1.0, 0.5, 2.0, 9.0, 0.0, -1.0, float("nan")], dtype=torch.float64)
    h, valid = distortion_weight(delta_A)
    e = torch.tensor([0.0, 0.25, 1.0, 4.0, 0.0, 0.0, 0.0], dtype=torch.float64).exp()
    torch.testing.assert_close(h, e)
    assert valid.tolist() == [True, True, True, True, False, False, False]
    torch.testing.assert_close(distortion_weight(delta_A[1], c_h=2.0)[0], e[1] ** 2)
    torch.testing.assert_close(
        residual_variance(h[:2], torch.tensor([[4.0, 5.0], [6.0, 7.0]]).double())[1],
        e[1] * torch.tensor([6.0, 7.0]).double(),
    )


def test_first_order_variance_is_that_of_the_residual() -> None:
    generator = torch.Generator().manual_seed(0)
    g = torch.tensor([[8.0, -5.0]], dtype=torch.float64)
    duv_dd = torch.tensor([-14.0, 6.0], dtype=torch.float64)
    n, sigma_d = 200_000, 0.02
    noise = torch.randn(4, n, generator=generator, dtype=torch.float64)
    shift = 0.3 * noise[:2].mT + duv_dd * (sigma_d * noise[2])[:, None]
    empirical = (4.0 * noise[3] + shift @ g[0]).var()
    predicted = photometric_variance(g, duv_dd, sigma_d)
    torch.testing.assert_close(predicted[0], empirical, rtol=0.02, atol=0)
    eight = photometric_variance(g, duv_dd, sigma_d, shared=8.0)
    torch.testing.assert_close(eight - 16, 8 * (predicted - 16))
    per_point = photometric_variance(g, duv_dd, torch.tensor(sigma_d, dtype=torch.float64))
    torch.testing.assert_close(per_point, predicted)


def test_shared_errors_count_once_for_a_patch() -> None:
    """P pixels with equal gradient and one common error: P / (sigma_I^2 + P s^2) is exactly their information."""
    g = torch.tensor([3.0, 4.0], dtype=torch.float64).expand(8, 2)
    zero = torch.zeros(2, dtype=torch.float64)
    variance = photometric_variance(g, zero, 0.0, sigma_pixel=0.5, shared=8.0)
    covariance = 16 * torch.eye(8, dtype=torch.float64) + (0.5 * 5) ** 2
    torch.testing.assert_close((1 / variance).sum(), torch.linalg.inv(covariance).sum())


def test_variance_as_printed() -> None:
    g = torch.tensor([[8.0, -5.0], [0.0, 2.0]], dtype=torch.float64)
    duv_dd = torch.tensor([-14.0, 6.0], dtype=torch.float64)
    printed = torch.tensor([112.0**2 + 30.0**2, 12.0**2], dtype=torch.float64) * 0.01**2
    torch.testing.assert_close(photometric_variance(g, duv_dd, 0.01, mode="paper", floor=0.0), printed)
    torch.testing.assert_close(photometric_variance(g, duv_dd, 0.01, mode="paper"), printed + 16)
    assert (photometric_variance(g, 0 * duv_dd, 0.01, mode="paper", floor=0.0) == 0).all()
    with pytest.raises(IdRgbdoError, match="mode"):
        photometric_variance(g, duv_dd, 0.01, mode="exact")  # type: ignore[arg-type]


def test_information_of_a_patch_is_the_sum_over_rows() -> None:
    uv, d = points(FACING, step=50)
    gray, _ = render(T_TARGET_HOST, FACING)
    warped = warp(CAMERA, uv, d, T_TARGET_HOST)
    term = linearize(gray, warped, host_intensity(uv, FACING, PATTERN), AFFINE)
    weight = 1 / photometric_variance(term.gradient, warped.duv_dd, 0.004)
    G = gradient_information(term.gradient, weight)
    information = warped.duv_dxi.mT @ G @ warped.duv_dxi
    rows = torch.einsum("npi,np,npj->nij", term.dr_dxi, weight, term.dr_dxi)
    torch.testing.assert_close(information, rows)
    assert information.shape == (len(uv), 6, 6)
    assert (torch.linalg.matrix_rank(information, hermitian=True) <= 2).all()


def test_measurements_are_differentiable() -> None:
    """For torch pipelines: gradients of a loss reach pose, depth, brightness and image."""
    uv, d = points(FACING, step=50)
    gray, _ = render(T_TARGET_HOST, FACING)
    inputs = [torch.zeros(6, dtype=torch.float64), d, AFFINE.clone(), gray]
    for x in inputs:
        x.requires_grad_()
    xi, d, affine, gray = inputs
    warped: Warp = warp(CAMERA, uv, d, se3.exp(xi))
    h, _ = distortion_weight(projective_distortion(d, warped.P, se3.exp(xi)))
    term = linearize(gray, warped, host_intensity(uv, FACING, PATTERN), affine)
    variance = residual_variance(h, photometric_variance(term.gradient, warped.duv_dd, 0.004))
    (term.r**2 / variance).sum().backward()
    for x in inputs:
        assert x.grad is not None and torch.isfinite(x.grad).all() and x.grad.abs().max() > 0
    assert duv_dP(CAMERA, warped.P).shape == (len(uv), 2, 3) and project(CAMERA, warped.P)[1].all()
