"""B frame pairs at once: points of B keyframes against B target images, as residuals, weights and normal equations.

The definitions of photometric.py, put together the way tracking uses them (section 4.2), with no loop over pairs or
points. Everything is differentiable: images, inverse depths, weights and noise may require gradients. A pair may have
fewer than N points: an inverse depth of 0 is no point.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor

from ..config import NoiseConfig
from ..errors import door
from ..measurement import OTHER_SURFACE, PIXELS, inverse_depth_sigma
from .camera import Pinhole
from .image import sample_surface
from .photometric import (
    PATTERN,
    PATTERN_1,
    WIDE_PATTERN,
    Warp,
    depth_residual,
    distortion_weight,
    linearize,
    photometric_variance,
    projective_distortion,
    residual_variance,
    warp,
)
from .points import HostPoints, at_level
from .solver import huber_weight, normal_equations, robust_cost


@dataclass(frozen=True)
class ResidualNoise:
    """What a residual is trusted with (Eqs. 5 to 8); make one with `residual_noise`, change it with `replace`.

    A tensor may stand where a number does, so that it can be learnt.
    """

    sigma_intensity: float | Tensor  # gray levels; broadcasts to (B, N, P)
    sigma_pixel: float | Tensor  # px, of position; a scalar
    sigma_depth: float | Tensor  # 1/m, of one reading of the target's sensor; broadcasts to (B, N)
    shared: float  # pixels of a patch that share one error of position and depth
    c_h: float
    huber: float  # whitened
    outlier: float  # limit of a point's whitened residual, in robust standard deviations
    use_depth: bool
    mode: Literal["first_order", "paper"]
    gradient_blend: float  # share of the keyframe's gradient in the Jacobian
    wide: bool = False  # whether patches of the finest level have the WIDE_PATTERN


@door
def residual_noise(config: NoiseConfig | None = None) -> ResidualNoise:
    """The noise of a configuration, by default of the default one, for patches of 8 pixels."""
    config = config or NoiseConfig()
    return ResidualNoise(
        sigma_intensity=config.sigma_intensity,
        sigma_pixel=config.sigma_pixel,
        sigma_depth=inverse_depth_sigma(config.focal_baseline, config.sigma_disparity),
        shared=float(PIXELS),
        c_h=config.c_h,
        huber=config.huber / config.sigma_intensity,
        outlier=config.outlier,
        use_depth=config.depth_residual,
        mode=config.variance,
        gradient_blend=config.gradient_blend,
    )


@dataclass(frozen=True)
class Target:
    """What the points are held against: one pyramid level of B images, and the depth of level 0."""

    level: int
    image: Tensor  # (B, H, W) gray levels
    camera: Pinhole  # of level 0
    inverse_depth: Tensor | None = None  # (B, H0, W0) 1/m, 0 where missing


@dataclass(frozen=True)
class NormalEquations:
    """B linear systems in the increment [v, w, a, b] of T_target_host and brightness, and what became of the points."""

    H: Tensor  # (B, 8, 8) float64
    b: Tensor  # (B, 8) float64, -J^T W r
    energy: Tensor  # (B,) float64, the robust cost, a point past the limit counting as the limit
    rms: Tensor  # (B, N) whitened residual of a point, -1 where the target does not see it
    kept: Tensor  # (B, N) bool: seen and within the limit

    @property
    def seen(self) -> Tensor:
        """(B, N) bool."""
        return self.rms >= 0


def gradient_in_target(camera: Pinhole, gradient: Tensor, inverse_depth: Tensor, warped: Warp, T: Tensor) -> Tensor:
    """Host gradients (..., P, 2) as the target would show them: (dp_i / dp_j)^-T g at fixed inverse depth.

    inverse_depth (...), T = T_target_host (..., 4, 4) broadcasting; zero where the surface is not seen from its front.
    """
    z = torch.where(warped.valid, warped.P[..., 2], 1.0)
    x, y = warped.P[..., 0] / z, warped.P[..., 1] / z
    q = z * inverse_depth  # depth in the target over depth in the host
    a00 = (T[..., 0, 0] - x * T[..., 2, 0]) / q
    a01 = (T[..., 0, 1] - x * T[..., 2, 1]) / q * (camera.fx / camera.fy)
    a10 = (T[..., 1, 0] - y * T[..., 2, 0]) / q * (camera.fy / camera.fx)
    a11 = (T[..., 1, 1] - y * T[..., 2, 1]) / q
    area = a00 * a11 - a01 * a10
    front = warped.valid & (area > 0)
    scale = (torch.where(front, 1.0, 0.0) / torch.where(front, area, 1.0))[..., None]
    g_u, g_v = gradient.to(q).unbind(-1)
    g_u, g_v = (
        scale * (a11[..., None] * g_u - a10[..., None] * g_v),
        scale * (a00[..., None] * g_v - a01[..., None] * g_u),
    )
    return torch.stack([g_u, g_v], dim=-1)


@door
def linearise_pairs(
    points: HostPoints, target: Target, T_target_host: Tensor, affine: Tensor, noise: ResidualNoise,
    scale: float | Tensor = 1.0, limit: float = float("inf"), pixels: int = PIXELS,
) -> NormalEquations:  # fmt: skip
    """Residuals, Jacobians and robust weights of B pairs, summed into one system each.

    T_target_host (B, 4, 4); affine (B, 2), the brightness of the target relative to the host; scale: a number or (B,),
    the robust scale of the whitened residuals; limit: largest rms of a point that takes part, in units of scale;
    pixels: how many of the pattern's are compared.
    """
    level, camera = target.level, target.camera.at_level(target.level)
    exists = points.inverse_depth > 0
    d = torch.where(exists, points.inverse_depth, 1.0)  # (B, N)
    T = T_target_host.to(d)[:, None]  # (B, 1, 4, 4)
    slope = None if level else points.slope  # a patch of a coarse level is larger than what is known to be plane
    pattern = WIDE_PATTERN if noise.wide and level == 0 else PATTERN
    warped = warp(camera, at_level(points.uv, level), d, T, pattern[:pixels], slope)
    brightness = affine.to(d)[:, None]
    term = linearize(target.image, warped, points.patch[level][..., :pixels].to(d), brightness)

    # the variance comes from the keyframe's gradient: it must not change with the pose, or the cost would reward places
    # where the residual is merely less certain
    moved = gradient_in_target(camera, points.gradient[level][..., :pixels, :], d, warped, T)
    P = torch.where(warped.valid[..., None], warped.P, 1.0)
    h, front = distortion_weight(projective_distortion(d, P, T), noise.c_h)
    sigmas: dict[str, Any] = {"sigma_intensity": noise.sigma_intensity, "sigma_pixel": noise.sigma_pixel}
    phi = photometric_variance(
        moved, warped.duv_dd, points.variance.sqrt(), mode=noise.mode, shared=noise.shared, **sigmas
    )
    variance = residual_variance(h, phi) / point_weight(points, pixels)  # (B, N, P)

    seen = term.valid & front & exists
    robust = torch.as_tensor(scale, dtype=d.dtype, device=d.device)[..., None, None]
    s = term.r / variance.sqrt() / robust
    rms = s.detach().square().mean(-1).sqrt()
    kept = seen & (rms <= limit)
    g = (1 - noise.gradient_blend) * term.gradient + noise.gradient_blend * moved
    J = torch.cat([g @ warped.duv_dxi, term.dr_daffine], dim=-1)  # (B, N, P, 8)
    weight = huber_weight(s, noise.huber) / (variance * robust**2) * kept[..., None]
    H, b = normal_equations(J.flatten(1, 2), term.r.flatten(1, 2), weight.flatten(1, 2))
    cost = (2 * robust_cost(s, noise.huber) * kept[..., None]).sum((1, 2)).double()
    if limit < float("inf"):
        cost = cost + pixels * limit**2 * (seen & ~kept).sum(-1)
    if noise.use_depth and target.inverse_depth is not None:
        J, r, weight, depth_cost = depth_rows(points, target, T, noise, kept)
        H, b = normal_equations(J, r, weight, (H, b))
        cost = cost + depth_cost
    shown = torch.where(seen, rms * robust.detach()[..., 0], -1.0)
    return NormalEquations(H, b, cost, shown, kept)


def depth_rows(
    points: HostPoints, target: Target, T: Tensor, noise: ResidualNoise, kept: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """J (B, N, 8), r (B, N), weight (B, N) and cost (B,) of measured against warped inverse depth.

    T: T_target_host (B, 1, 4, 4); kept (B, N): points whose brightness agrees.
    """
    assert target.inverse_depth is not None  # the caller has looked
    d = torch.where(points.inverse_depth > 0, points.inverse_depth, 1.0)
    warped = warp(target.camera, points.uv, d, T, PATTERN_1)
    term = depth_residual(target.inverse_depth, warped)
    slope = sample_surface(target.inverse_depth, warped.centre)[1] * 2.0**target.level  # 1/m per px of the level
    stretch = 1 / (torch.where(warped.valid, warped.P[..., 2], 1.0) * d) ** 2  # d rho / d d, up to the small t_z term
    position = noise.shared * noise.sigma_pixel**2 * slope.square().sum(-1)
    variance = noise.sigma_depth**2 + stretch**2 * points.variance + position
    if points.weight is not None:
        variance = variance / point_weight(points, PIXELS).mean(-1)
    s = term.r / variance.sqrt()
    on = term.valid & kept
    past = OTHER_SURFACE * noise.huber
    weight = huber_weight(s, noise.huber, past) / variance * on
    J = torch.cat([term.dr_dxi, torch.zeros_like(term.dr_dxi[..., :2])], dim=-1)
    cost = (2 * robust_cost(s, noise.huber, past) * on).sum(-1).double()
    return J, term.r, weight, cost


def point_weight(points: HostPoints, pixels: int) -> Tensor:
    """The points' weights as (B, N, P) or a broadcasting one."""
    if points.weight is None:
        return points.inverse_depth.new_ones(1, 1, 1)
    weight = points.weight.to(points.inverse_depth)
    return weight[..., None] if weight.ndim == 2 else weight[..., :pixels]


def robust_scale(rms: Tensor) -> Tensor:
    """(B,) scale of the points' whitened rms (B, N), -1 unseen: a median rms of 0.9 counts as 1; at least 0.5."""
    order = rms.sort(dim=-1).values
    first = (order < 0).sum(-1)
    middle = ((first + rms.shape[-1]) // 2).clamp(max=rms.shape[-1] - 1)
    scale = (order.gather(-1, middle[..., None])[..., 0] / 0.9).clamp(min=0.5)
    return torch.where(first == rms.shape[-1], 1.0, scale)
