"""The measurement model on an analytic world: a smoothly textured plane seen from two known poses."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from plane_world import (
    AFFINE,
    CAMERA,
    FACING,
    SLANTED,
    T_TARGET_HOST,
    XI,
    derivative,
    host_intensity,
    one_point,
    pixel_grid,
    points,
    render,
)
from torch import Tensor
from torch.func import jacfwd

from idrgbdo_torch.definitions import se3
from idrgbdo_torch.definitions.image import sample_bilinear
from idrgbdo_torch.definitions.photometric import (
    PATTERN,
    PATTERN_1,
    depth_residual,
    linearize,
    photometric_residual,
    warp,
)


def test_identity_warps_every_pixel_onto_itself() -> None:
    uv, d = points(SLANTED)
    warped = warp(CAMERA, uv, d, torch.eye(4, dtype=torch.float64))
    assert warped.valid.all()
    torch.testing.assert_close(warped.uv, uv[:, None] + PATTERN)
    torch.testing.assert_close(warped.centre, uv)
    assert warped.duv_dd.abs().max() < 1e-9  # without parallax, depth does not matter


def test_warp_finds_the_same_surface_point() -> None:
    for plane, pattern in ((FACING, PATTERN), (SLANTED, PATTERN_1)):
        uv, d = points(plane)
        warped = warp(CAMERA, uv, d, T_TARGET_HOST, pattern)
        gray, inverse_depth = render(T_TARGET_HOST, plane)
        seen, valid = sample_bilinear(inverse_depth, warped.centre)
        assert valid.all()
        torch.testing.assert_close(1 / warped.P[:, 2], seen)
        torch.testing.assert_close(
            sample_bilinear(gray, warped.uv)[0], host_intensity(uv, plane, pattern), atol=0.1, rtol=0
        )


def test_a_patch_on_a_slanted_surface_needs_its_slope() -> None:
    uv, d = points(SLANTED)
    host = render(torch.eye(4, dtype=torch.float64), SLANTED)[1]
    slope = torch.stack([host[0, 1] - host[0, 0], host[1, 0] - host[0, 0]]).expand(len(uv), 2)  # the same everywhere
    gray, expected = render(T_TARGET_HOST, SLANTED)[0], host_intensity(uv, SLANTED, PATTERN)
    with_slope, without = (warp(CAMERA, uv, d, T_TARGET_HOST, slope=s).uv for s in (slope, None))
    off = [(sample_bilinear(gray, at)[0] - expected).abs().mean() for at in (with_slope, without)]
    assert off[0] < 0.5 * off[1]


def test_moving_right_moves_pixels_left() -> None:
    T = se3.exp(torch.tensor([-0.1, 0, 0, 0, 0, 0], dtype=torch.float64))  # the camera goes 0.1 m to the right
    uv, d = one_point()
    warped = warp(CAMERA, uv, d, T)
    torch.testing.assert_close(warped.centre, uv - torch.tensor([0.1 * 280.0 * 0.47, 0.0]).double())
    torch.testing.assert_close(warped.duv_dd, torch.tensor([-0.1 * 280.0, 0.0]).double())


def test_warp_jacobians_against_autograd() -> None:
    uv, d = one_point()
    warped = warp(CAMERA, uv, d, T_TARGET_HOST)
    torch.testing.assert_close(warped.duv_dxi, derivative(lambda T: warp(CAMERA, uv, d, T).centre))
    torch.testing.assert_close(warped.dP_dxi, derivative(lambda T: warp(CAMERA, uv, d, T).P))
    torch.testing.assert_close(warped.duv_dd, jacfwd(lambda x: warp(CAMERA, uv, x, T_TARGET_HOST).centre)(d))
    torch.testing.assert_close(warped.dP_dd, jacfwd(lambda x: warp(CAMERA, uv, x, T_TARGET_HOST).P)(d))


def test_warp_batches_over_anything() -> None:
    uv, d = points(SLANTED, step=60)
    T = se3.exp(XI * torch.tensor([1.0, 0.5, -1.0], dtype=torch.float64)[:, None, None])  # (3, 1, 4, 4)
    warped = warp(CAMERA, uv, d, T)
    assert warped.uv.shape == (3, len(uv), 8, 2) and warped.duv_dxi.shape == (3, len(uv), 2, 6)
    single = warp(CAMERA, uv[2], d[2], T[1, 0])
    torch.testing.assert_close(warped.uv[1, 2], single.uv)
    torch.testing.assert_close(warped.duv_dxi[1, 2], single.duv_dxi)
    small = warp(CAMERA, uv.float(), d.float(), T.float())
    assert small.uv.dtype == torch.float32
    torch.testing.assert_close(small.uv.double(), warped.uv, atol=1e-3, rtol=0)


def test_points_without_depth_or_behind_are_invalid_and_finite() -> None:
    uv = torch.tensor([160.0, 120.0], dtype=torch.float64).expand(5, 2)
    d = torch.tensor([0.0, -1.0, float("nan"), float("inf"), 0.5], dtype=torch.float64)
    back = se3.exp(torch.tensor([0, 0, -2.5, 0, 0, 0], dtype=torch.float64))
    warped = warp(CAMERA, uv, d, back)
    assert not warped.valid.any()
    image = render(back, FACING)[0]
    term = linearize(image, warped, torch.zeros(5, 8, dtype=torch.float64), AFFINE)
    depth = depth_residual(torch.full((240, 320), 0.5), warped)
    for value in (*vars(warped).values(), *vars(term).values(), *vars(depth).values()):
        assert torch.isfinite(value.double()).all()
    assert not term.valid.any() and (term.dr_dxi == 0).all() and (depth.r == 0).all()


def test_residual_is_the_paper_s_up_to_scale_and_sign() -> None:
    I_i, I_j = torch.tensor([130.0]).double(), torch.tensor([90.0]).double()
    a_i, b_i, a_j, b_j = 0.2, 3.0, -0.1, -7.0
    paper = torch.exp(torch.tensor(-a_j)) * (I_j - b_j) - torch.exp(torch.tensor(-a_i)) * (I_i - b_i)
    a = torch.tensor(a_i - a_j).double()
    affine = torch.stack([a, b_i - a.exp() * b_j])
    expected = -torch.exp(torch.tensor(a_i)) * paper
    torch.testing.assert_close(photometric_residual(I_i, I_j, affine), expected, atol=1e-4, rtol=1e-6)


@pytest.mark.parametrize(("plane", "pattern"), [(FACING, PATTERN), (SLANTED, PATTERN_1)])
def test_residual_vanishes_at_the_true_pose_and_brightness(plane: Tensor, pattern: Tensor) -> None:
    uv, d = points(plane)
    gray, _ = render(T_TARGET_HOST, plane)
    gray = AFFINE[0].exp() * gray + AFFINE[1]
    reference = host_intensity(uv, plane, pattern)
    term = linearize(gray, warp(CAMERA, uv, d, T_TARGET_HOST, pattern), reference, AFFINE)
    assert term.valid.all() and term.r.abs().max() < 0.15  # what bilinear interpolation misses
    still = linearize(gray, warp(CAMERA, uv, d, torch.eye(4, dtype=torch.float64), pattern), reference, AFFINE)
    assert still.r.abs().mean() > 5


def test_photometric_jacobians_against_autograd() -> None:
    grid = pixel_grid()
    ramp = 2.0 * grid[..., 0] - 1.5 * grid[..., 1] + 20  # bilinear sampling and its gradient are exact here
    uv, d = one_point()
    reference = torch.tensor([77.0], dtype=torch.float64)
    r = lambda T, x, affine: linearize(ramp, warp(CAMERA, uv, x, T, PATTERN_1), reference, affine).r
    term = linearize(ramp, warp(CAMERA, uv, d, T_TARGET_HOST, PATTERN_1), reference, AFFINE)
    torch.testing.assert_close(term.dr_dxi, derivative(lambda T: r(T, d, AFFINE)))
    torch.testing.assert_close(term.dr_dd, jacfwd(lambda x: r(T_TARGET_HOST, x, AFFINE))(d))
    torch.testing.assert_close(term.dr_daffine, jacfwd(lambda x: r(T_TARGET_HOST, d, x))(AFFINE))


def test_pattern_jacobian_is_the_centre_s_geometry_with_each_pixel_s_gradient() -> None:
    uv, d = points(FACING, step=50)
    gray, _ = render(T_TARGET_HOST, FACING)
    warped = warp(CAMERA, uv, d, T_TARGET_HOST)
    term = linearize(gray, warped, host_intensity(uv, FACING, PATTERN), AFFINE)
    torch.testing.assert_close(term.dr_dxi, torch.einsum("npk,nkj->npj", term.gradient, warped.duv_dxi))
    numeric = torch.stack(
        [
            (
                linearize(gray, warp(CAMERA, uv, d, se3.retract(1e-3 * e, T_TARGET_HOST)), term.r, AFFINE).r
                - linearize(gray, warp(CAMERA, uv, d, se3.retract(-1e-3 * e, T_TARGET_HOST)), term.r, AFFINE).r
            )
            / 2e-3
            for e in torch.eye(6, dtype=torch.float64)
        ],
        dim=-1,
    )
    assert (term.dr_dxi - numeric).norm() < 0.06 * numeric.norm()


def test_one_pixel_outside_invalidates_the_point() -> None:
    uv = torch.tensor([[3.0, 60.0], [2.9, 60.0], [316.0, 60.0], [80.0, 236.1]], dtype=torch.float64)
    d = torch.full((4,), 0.5, dtype=torch.float64)
    warped = warp(CAMERA, uv, d, torch.eye(4, dtype=torch.float64))
    term = linearize(render(T_TARGET_HOST, FACING)[0], warped, torch.zeros(4, 8).double(), AFFINE)
    assert term.valid.tolist() == [True, False, True, False]
    assert (term.r[1] == 0).all() and (term.dr_daffine[3] == 0).all()


def gauss_newton(term: Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]) -> tuple[Tensor, Tensor]:
    """Ten undamped steps from identity over pose and brightness; `term` gives rows J (n, 8) and residuals (n,)."""
    T, affine = torch.eye(4, dtype=torch.float64), torch.zeros(2, dtype=torch.float64)
    for _ in range(10):
        J, r = term(T, affine)
        step = torch.linalg.solve(J.mT @ J, -J.mT @ r)
        T, affine = se3.retract(step[:6], T), affine + step[6:]
    return T, affine


@pytest.mark.parametrize(("plane", "pattern"), [(FACING, PATTERN), (SLANTED, PATTERN_1)])
def test_gauss_newton_recovers_a_known_motion(plane: Tensor, pattern: Tensor) -> None:
    uv, d = points(plane, step=8)
    gray, inverse_depth = render(T_TARGET_HOST, plane)
    gray = AFFINE[0].exp() * gray + AFFINE[1]
    reference = host_intensity(uv, plane, pattern)

    def both(T: Tensor, affine: Tensor) -> tuple[Tensor, Tensor]:
        warped = warp(CAMERA, uv, d, T, pattern)
        photo, depth = linearize(gray, warped, reference, affine), depth_residual(inverse_depth, warped)
        rows = torch.cat([photo.dr_dxi, photo.dr_daffine], dim=-1).reshape(-1, 8)
        depth_rows = torch.nn.functional.pad(depth.dr_dxi, (0, 2))
        return torch.cat([rows, 250 * depth_rows]), torch.cat([photo.r.reshape(-1), 250 * depth.r])

    T, affine = gauss_newton(both)
    assert se3.log(T @ se3.inverse(T_TARGET_HOST)).abs().max() < 1e-4
    torch.testing.assert_close(affine, AFFINE, atol=0.05, rtol=0)
    T, _ = gauss_newton(lambda T, a: tuple(x[: len(uv) * len(pattern)] for x in both(T, a)))  # type: ignore[arg-type, return-value]
    assert se3.log(T @ se3.inverse(T_TARGET_HOST)).abs().max() < 3e-4  # brightness alone


def test_depth_residual_vanishes_at_the_true_pose_and_has_the_right_sign() -> None:
    uv, d = points(SLANTED)
    _, inverse_depth = render(T_TARGET_HOST, SLANTED)
    term = depth_residual(inverse_depth, warp(CAMERA, uv, d, T_TARGET_HOST))
    assert term.valid.all() and term.r.abs().max() < 1e-12
    # claim that the target is 0.1 m farther away than it is: the warped inverse depth is too small, r is positive
    far = se3.retract(torch.tensor([0, 0, 0.1, 0, 0, 0], dtype=torch.float64), T_TARGET_HOST)
    assert (depth_residual(inverse_depth, warp(CAMERA, uv, d, far)).r > 0.01).all()


def test_depth_jacobians_against_autograd() -> None:
    uv, d = one_point()
    _, inverse_depth = render(T_TARGET_HOST, SLANTED)
    term = depth_residual(inverse_depth, warp(CAMERA, uv, d, T_TARGET_HOST))
    assert term.valid and term.r.abs() > 0.01
    torch.testing.assert_close(
        term.dr_dxi, derivative(lambda T: depth_residual(inverse_depth, warp(CAMERA, uv, d, T)).r)
    )
    expected = jacfwd(lambda x: depth_residual(inverse_depth, warp(CAMERA, uv, x, T_TARGET_HOST)).r)(d)
    torch.testing.assert_close(term.dr_dd, expected)


def test_a_given_depth_gradient_replaces_the_sampled_one() -> None:
    uv, d = points(SLANTED)
    _, inverse_depth = render(T_TARGET_HOST, SLANTED)
    warped = warp(CAMERA, uv, d, T_TARGET_HOST)
    sampled = depth_residual(inverse_depth, warped)
    R, t = T_TARGET_HOST[:3, :3], T_TARGET_HOST[:3, 3]
    plane = R @ SLANTED / (1 + SLANTED @ R.mT @ t)  # n . P = 1 in the target, whose inverse depth is n . ray
    given = depth_residual(inverse_depth, warped, gradient=plane[:2] / torch.tensor([CAMERA.fx, CAMERA.fy]))
    torch.testing.assert_close(given.dr_dxi, sampled.dr_dxi)
    torch.testing.assert_close(given.dr_dd, sampled.dr_dd)
    flat = depth_residual(inverse_depth, warped, gradient=torch.zeros(2))
    torch.testing.assert_close(flat.dr_dxi, warped.P[:, 2:] ** -2 * warped.dP_dxi[:, 2])


def test_depth_residual_skips_holes_and_edges() -> None:
    uv, d = points(SLANTED)
    _, inverse_depth = render(T_TARGET_HOST, SLANTED)
    broken = inverse_depth.clone()
    broken[:, :160] = 0
    broken[120:, 160:] *= 1.2
    warped = warp(CAMERA, uv, d, T_TARGET_HOST)
    term = depth_residual(broken, warped)
    u, v = warped.centre.unbind(-1)
    torch.testing.assert_close(term.valid, (u >= 160) & ((v <= 119) | (v >= 120)))
    assert (term.r[~term.valid] == 0).all() and (term.dr_dxi[~term.valid] == 0).all()
