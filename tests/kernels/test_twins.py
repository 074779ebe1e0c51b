"""Every fused kernel against its torch definition: poses, linear algebra, sampling, normal equations."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
import torch
from plane_scene import P, Scene, close, plane_scene
from plane_world import AFFINE, CAMERA, T_TARGET_HOST, XI
from torch import Tensor

from idrgbdo_torch.config import NoiseConfig
from idrgbdo_torch.definitions import se3
from idrgbdo_torch.definitions.image import sample_surface, sample_with_gradient
from idrgbdo_torch.definitions.photometric import (
    PATTERN,
    WIDE_PATTERN,
    Photometric,
    Warp,
    depth_residual,
    distortion_weight,
    linearize,
    photometric_variance,
    projective_distortion,
    residual_variance,
    warp,
)
from idrgbdo_torch.definitions.solver import huber_weight, normal_equations, robust_cost
from idrgbdo_torch.kernels import image as sampling
from idrgbdo_torch.kernels import photometric as model
from idrgbdo_torch.kernels import se3 as lie
from idrgbdo_torch.kernels import solver as linear
from idrgbdo_torch.kernels import tracking
from idrgbdo_torch.kernels.linearise import linearise
from idrgbdo_torch.measurement import COMPACT, PATTERNS, PIXELS, WIDE, Noise, State, Subset, System, kernel_noise
from idrgbdo_torch.tracker.candidates import PLANE_RADIUS


@pytest.mark.parametrize("size", [1e-12, 1e-6, 3e-5, 1e-3, 0.4, 0.5, 2.0])
def test_poses(size: float) -> None:
    generator = torch.Generator().manual_seed(0)
    for _ in range(20):
        xi, other = torch.randn(2, 6, generator=generator, dtype=torch.float64)
        xi[3:] *= size / xi[3:].norm()
        T, T_other = se3.exp(xi), se3.exp(other)
        close(lie.retract(xi.numpy(), T_other.numpy()), se3.retract(xi, T_other), 1e-14)
        close(lie.log_se3(T.numpy()), se3.log(T), 1e-12)
        close(lie.inverse(T.numpy()), se3.inverse(T), 1e-15)
        close(lie.adjoint(T.numpy()), se3.adjoint(T), 1e-15)


def test_a_long_chain_of_retractions_stays_a_rotation() -> None:
    T = np.eye(4)
    for xi in 0.3 * np.random.default_rng(0).standard_normal((20_000, 6)):
        T = lie.retract(xi, T)
    assert np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() < 1e-14


def test_solving_symmetric_systems() -> None:
    rng = np.random.default_rng(0)
    for n in (1, 2, 6, 8):
        J = rng.standard_normal((3 * n, n)) * 10.0 ** rng.uniform(-3, 3, n)
        A, b = J.T @ J, rng.standard_normal(n)
        ok, x = linear.solve_spd(A, b)
        unit = np.diag(A) ** -0.5
        close(linear.inverse_spd(A) / np.outer(unit, unit), np.linalg.inv(A * np.outer(unit, unit)))
        expected = torch.linalg.solve(torch.from_numpy(A), torch.from_numpy(b))
        assert ok
        torch.testing.assert_close(torch.from_numpy(x), expected, rtol=1e-10, atol=0)


@pytest.mark.parametrize("entry", [-1.0, 0.0, np.nan, np.inf])
def test_a_system_that_cannot_be_solved_is_a_value(entry: float) -> None:
    A = np.diag([1.0, entry, 2.0])
    assert not linear.solve_spd(A, np.ones(3))[0]
    assert not linear.inverse_spd(A).any()
    assert not linear.solve_spd(np.eye(3), np.array([1.0, np.nan, 0.0]))[0]


def test_sampling_intensities() -> None:
    rng = np.random.default_rng(0)
    image = rng.uniform(0, 255, (12, 17)).astype(np.float32)
    uv = rng.uniform(-2.0, 19.0, (2000, 2))
    value, g, valid = sample_with_gradient(torch.from_numpy(image).double(), torch.from_numpy(uv))
    mine = np.array([sampling.sample(image, u, v) for u, v in uv])
    assert 0.3 < valid.double().mean() < 0.9
    close(mine[:, 0], valid.double(), 0.0)
    close(mine[:, 1], value, 1e-13)
    close(mine[:, 2:], g, 1e-13)


def test_sampling_one_surface_of_a_depth_image() -> None:
    rng = np.random.default_rng(0)
    depth = (1.5 + 0.1 * rng.uniform(size=(12, 17))).astype(np.float32)
    depth[rng.uniform(size=depth.shape) < 0.05] = 0.0
    depth[:, 10:] *= 1.3
    inverse = torch.where(torch.from_numpy(depth) > 0, 1 / torch.from_numpy(depth).double(), 0.0)
    uv = rng.uniform(-1.0, 18.0, (2000, 2))
    d, g, valid = sample_surface(inverse, torch.from_numpy(uv), 0.05)
    mine = np.array([sampling.sample_inverse_depth(depth, u, v, 0.05) for u, v in uv])
    assert 0.1 < valid.double().mean() < 0.6
    close(mine[:, 0], valid.double(), 0.0)
    close(mine[:, 1], d, 1e-13)
    close(mine[:, 2:], g, 1e-13)


def test_the_patch_is_the_definition_s_and_starts_at_its_centre() -> None:
    assert np.array_equal(PATTERNS[COMPACT], PATTERN.numpy()) and np.array_equal(PATTERNS[WIDE], WIDE_PATTERN.numpy())
    for pattern in (PATTERN, WIDE_PATTERN):
        assert pattern[0].tolist() == [0, 0] and PIXELS == P == len(pattern)
    assert WIDE_PATTERN.norm(dim=1).max() < PLANE_RADIUS + 1e-9  # inside of what the plane around a point was fitted to


@pytest.mark.parametrize("mode", ["first_order", "paper"])
def test_variances(mode: Literal["first_order", "paper"]) -> None:
    config = NoiseConfig(variance=mode, sigma_intensity=4.0, sigma_pixel=0.3, c_h=0.7)
    noise = kernel_noise(config)
    rng = np.random.default_rng(0)
    for g, duv_dd, sigma_d in zip(
        20 * rng.standard_normal((50, 2)), 30 * rng.standard_normal((50, 2)), 0.01 * rng.uniform(size=50), strict=True
    ):
        expected = photometric_variance(
            torch.from_numpy(g)[None], torch.from_numpy(duv_dd), sigma_d, mode=mode, sigma_pixel=0.3, shared=P
        )
        assert model.photometric_variance(*g, *duv_dd, sigma_d**2, noise) == pytest.approx(float(expected), rel=1e-12)
    for area in (0.1, 1.0, 1.7, 6.0):
        h, _ = distortion_weight(torch.tensor(area, dtype=torch.float64), config.c_h)
        assert model.distortion_weight(area, noise.c_h) == pytest.approx(float(h), rel=1e-14)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return plane_scene()


def moved_gradient(g_host: Tensor, d: Tensor, warped: Warp, T: Tensor, level: int) -> Tensor:
    """A host gradient (N, P, 2) seen from the target: (dp_i/dp_j)^-T g."""
    camera = CAMERA.at_level(level)
    m = torch.tensor([camera.fx, camera.fy]).double()
    z = warped.P[:, 2] * d  # (N,)
    xy = warped.P[:, :2] / warped.P[:, 2:]
    dp = (T[:2, :2] - xy[..., None] * T[2, :2]) / z[:, None, None] * m[:, None] / m  # (N, 2, 2)
    return (torch.linalg.inv(dp).mT[:, None] @ g_host[..., None])[..., 0]


def blended(term: Photometric, moved: Tensor, warped: Warp, share: float) -> tuple[Tensor, Tensor]:
    """Gradient (N, P, 2) and dr/dxi (N, P, 6) with this share of the reference's gradient."""
    g = (1 - share) * term.gradient + share * moved
    return g, g @ warped.duv_dxi


def linearised_by_definition(
    scene: Scene, index: np.ndarray, T: Tensor, affine: Tensor, level: int, noise: Noise, scale: float, limit: float
) -> tuple[Tensor, Tensor, float, Tensor, int]:
    """H, b, energy, rms and the number of points seen, from the functions of photometric and solver."""
    camera = CAMERA.at_level(level)
    uv, d, var_d, slope = (scene.tensor(name, index) for name in ("uv", "inv_depth", "var_inv_depth", "slope"))
    pattern = WIDE_PATTERN if noise.pattern == WIDE and level == 0 else PATTERN
    warped = warp(camera, (uv + 0.5) * 0.5**level - 0.5, d, T, pattern, None if level else slope)
    patch, g_host = (torch.from_numpy(x[level, index]).double() for x in (scene.points.patch, scene.points.gradient))
    term = linearize(torch.from_numpy(scene.images[level]).double(), warped, patch, affine)
    moved = moved_gradient(g_host, d, warped, T, level)
    h, facing = distortion_weight(projective_distortion(d, warped.P, T), noise.c_h)
    phi = photometric_variance(
        moved, warped.duv_dd, var_d.sqrt(), shared=P, sigma_intensity=noise.var_intensity**0.5,
        sigma_pixel=(noise.var_pixel / P) ** 0.5,
    )  # fmt: skip
    variance = residual_variance(h, phi)
    _, dr_dxi = blended(term, moved, warped, noise.gradient_blend)
    seen = term.valid & facing
    s = term.r / variance.sqrt() / scale
    rms = s.square().mean(-1).sqrt()
    kept = seen & (rms <= limit)
    weight = huber_weight(s, noise.huber) / (variance * scale**2) * kept[:, None]
    J = torch.cat([dr_dxi, term.dr_daffine], dim=-1)
    H, b = normal_equations(J.flatten(0, 1), term.r.flatten(), weight.flatten())
    energy = float((2 * robust_cost(s, noise.huber) * kept[:, None]).sum()) + P * limit**2 * int((seen & ~kept).sum())
    if noise.use_depth:
        full = warp(CAMERA, uv, d, T)
        depth = torch.from_numpy(scene.depth).double()
        inverse = torch.where(depth > 0, 1 / depth, 0.0)
        near = depth_residual(inverse, full, 0.05)
        g = sample_surface(inverse, full.centre, 0.05)[1] * 2.0**level  # 1/m per px of the level
        stretch = 1 / (full.P[:, 2] * d) ** 2
        variance = noise.var_depth + stretch**2 * var_d + noise.var_pixel * g.square().sum(-1)
        s = near.r / variance.sqrt()
        on = near.valid & kept
        J = torch.cat([near.dr_dxi, torch.zeros(len(d), 2)], dim=-1)
        weight = huber_weight(s, noise.huber, 6 * noise.huber) / variance * on
        H, b = normal_equations(J, near.r, weight, (H, b))
        energy += float((2 * robust_cost(s, noise.huber, 6 * noise.huber) * on).sum())
    return H, b, energy, torch.where(seen, rms * scale, -1.0), int(seen.sum())


@pytest.mark.parametrize("use_depth", [True, False])
@pytest.mark.parametrize("level", [0, 1, 2])
@pytest.mark.parametrize(("scale", "limit", "pattern"), [(1.0, 1e9, WIDE), (1.3, 1.2, COMPACT)])
def test_normal_equations_of_a_frame(
    scene: Scene, level: int, use_depth: bool, scale: float, limit: float, pattern: int
) -> None:
    noise = kernel_noise(NoiseConfig(depth_residual=use_depth, gradient_blend=0.3, sigma_pixel=0.3), pattern=pattern)
    index = np.random.default_rng(1).permutation(200)[:150]
    for step in (0.0, 0.02):
        T = se3.retract(step * XI, T_TARGET_HOST)
        H, b, rms = system = System(np.empty((8, 8)), np.empty(8), np.empty(len(index)))
        state = State(T.numpy(), AFFINE.numpy())
        energy, seen, kept = linearise(
            scene.view, level, scene.points, Subset(index, P), state, scale, limit, noise, system
        )
        expected = linearised_by_definition(scene, index, T, AFFINE, level, noise, scale, limit)
        unit = expected[0].diagonal().rsqrt()
        close(unit[:, None] * torch.from_numpy(H) * unit, unit[:, None] * expected[0] * unit)
        close(unit * torch.from_numpy(b), unit * expected[1])
        assert energy == pytest.approx(expected[2], rel=1e-10)
        close(rms, expected[3])
        assert (seen, kept) == (expected[4], int(((rms >= 0) & (rms <= limit * scale)).sum()))
        assert 50 < seen < len(index) and (limit > 1e3 or 10 < kept < seen)


def test_one_pixel_patches(scene: Scene) -> None:
    """The centre alone is the first pixel of the pattern."""
    noise = kernel_noise(NoiseConfig(depth_residual=False))
    one = scene.points._replace(patch=scene.points.patch[..., :1], gradient=scene.points.gradient[..., :1, :])
    results = []
    for points in (scene.points, one):
        system = System(np.empty((8, 8)), np.empty(8), np.empty(200))
        subset, state = Subset(np.arange(200), 1), State(T_TARGET_HOST.numpy(), AFFINE.numpy())
        energy, _, _ = linearise(scene.view, 0, points, subset, state, 1.0, 1e9, noise, system)
        results.append((system.H, system.b, energy))
    assert np.array_equal(results[0][0], results[1][0]) and np.array_equal(results[0][1], results[1][1])
    assert results[0][2] == results[1][2] > 0


def test_brightness_information_is_the_schur_complement() -> None:
    rng = np.random.default_rng(0)
    J = rng.standard_normal((30, 8))
    H, least = J.T @ J, np.diag([2.0, 3.0])
    close(tracking.brightness_information(H, least), torch.linalg.inv(torch.linalg.inv(torch.from_numpy(H))[6:, 6:]))
    assert (tracking.brightness_information(-H, least) == least).all()


def test_robust_scale_of_unit_noise_is_one() -> None:
    rng = np.random.default_rng(0)
    rms = np.sqrt((rng.standard_normal((5001, 8)) ** 2).mean(axis=1))
    rms[::10] = -1.0  # unseen
    rms[1::10] = 50.0  # outliers
    assert tracking.robust_scale(rms) == pytest.approx(1.1, abs=0.06)
    assert tracking.robust_scale(np.full(4, -1.0)) == 1.0
    assert tracking.robust_scale(np.zeros(4)) == 0.5
