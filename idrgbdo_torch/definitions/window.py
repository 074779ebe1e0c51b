"""Linearisation of the sliding window in torch: twin of kernels.window. All pairs of keyframes at once."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ..measurement import OTHER_SURFACE, STEP, WIDE, Noise, Views, WindowPairs, WindowPoints, WindowState
from .convert import Array, noise_of_arrays, pinhole
from .image import sample_surface
from .linearise import gradient_in_target
from .photometric import (
    PATTERN,
    PATTERN_1,
    WIDE_PATTERN,
    Warp,
    distortion_weight,
    linearize,
    photometric_variance,
    projective_distortion,
    residual_variance,
    warp,
)
from .se3 import adjoint, inverse
from .solver import huber_weight, robust_cost


def linearise_window(
    views: Views,
    state: WindowState,
    points: WindowPoints,
    which: Array,
    limit: float,
    noise: Noise,
    pairs: WindowPairs,
) -> None:
    """Twin of kernels.window.linearise_window: fills the pairs.

    Inside, dimensions are (target, host, point, pixel); the state of one residual is [v, w, a, b, d].
    """
    K, N = state.inv_depth.shape
    camera = pinhole(views.camera, views.images[0])
    gray, z = (torch.from_numpy(np.stack(own[:K])) for own in (views.images, views.depths))
    z = z.double()
    inverse_depth = torch.where(z > 0, 1 / z, 0.0)  # (K, H, W)
    uv, patch, gradient, _, _, valid, slope = (torch.from_numpy(x) for x in points)
    inv_depth = torch.from_numpy(state.inv_depth)
    usable = valid & (inv_depth > 1e-3)
    d = torch.where(usable, inv_depth, 1.0).expand(K, K, N)
    pixel = uv.expand(K, K, N, 2)
    brightness = torch.from_numpy(state.affine)
    gain = (brightness[:, None, 0] - brightness[None, :, 0]).exp()  # (K, K)

    T = relative_poses(torch.from_numpy(state.T))  # (K, K, 1, 4, 4)
    pattern = WIDE_PATTERN if noise.pattern == WIDE else PATTERN
    now = warp(camera, pixel, d, T, pattern[: patch.shape[-1]], slope.expand(K, K, N, 2))
    linear = warp(camera, pixel, d, relative_poses(torch.from_numpy(state.T_linear)), PATTERN_1)
    relative = torch.stack([gain.log(), brightness[:, None, 1].expand(K, K)], dim=-1)[:, :, None]  # (K, K, 1, 2)
    term = linearize(gray, now, patch.double() - brightness[:, 1, None, None], relative)

    sigma = noise_of_arrays(noise)
    moved = gradient_in_target(camera, gradient.double(), d, now, T)
    P = torch.where(now.valid[..., None], now.P, 1.0)
    h, front = distortion_weight(projective_distortion(d, P, T), noise.c_h)
    # inverse depth is a state here: its noise must not count a second time
    phi = photometric_variance(
        moved, torch.zeros_like(now.duv_dd), 0.0, mode=sigma.mode, shared=sigma.shared,
        sigma_intensity=float(sigma.sigma_intensity), sigma_pixel=float(sigma.sigma_pixel),
    )  # fmt: skip
    weight = 1 / residual_variance(h, phi)  # (K, K, N, P)
    seen = term.valid & front & usable
    s = term.r * weight.sqrt()
    size = s.square().mean(-1).sqrt()
    kept = seen & (size <= limit)
    g = (1 - noise.gradient_blend) * term.gradient + noise.gradient_blend * moved
    J = torch.cat([g @ linear.duv_dxi, term.dr_daffine, (g @ linear.duv_dd[..., None])], dim=-1)  # (K, K, N, P, 9)
    w = huber_weight(s, noise.huber) * weight * kept[..., None]
    L, l = _normal(J, term.r, w)
    energy = (2 * robust_cost(s, noise.huber) * kept[..., None]).sum((-2, -1))
    if bool((seen & ~kept).any()):
        energy = energy + s.shape[-1] * limit**2 * (seen & ~kept).sum(-1)

    if noise.use_depth:
        rows, r, w, cost = _depth_rows(inverse_depth, now, linear, kept, noise)
        more = _normal(rows[..., None, :], r[..., None], w[..., None])
        L, l, energy = L + more[0], l + more[1], energy + cost

    both = torch.stack([brightness.expand(K, K, 2), brightness[:, None].expand(K, K, 2)], dim=2)
    filled = (
        L[..., :8, :8].sum(2), l[..., :8].sum(2), _chain(torch.from_numpy(state.T_linear), gain), L[..., 8, 8],
        l[..., 8], L[..., 8, :8].mT, torch.where(seen, size, -1.0), energy, torch.ones(K, K, dtype=torch.bool),
        T[:, :, 0], both, inv_depth.expand(K, K, N),
    )  # fmt: skip
    taken = which & ~np.eye(K, dtype=np.bool_)
    for mine, out in zip(filled, pairs, strict=True):  # in the order of WindowPairs
        out[taken] = mine.transpose(0, 1).numpy()[taken]


def relative_poses(T_cam_world: Tensor) -> Tensor:
    """T_target_host (K, K, 1, 4, 4) of all pairs."""
    return (T_cam_world[:, None] @ inverse(T_cam_world)[None])[:, :, None]


def _normal(J: Tensor, r: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """A point's own L (..., 9, 9) and l (..., 9) from its rows J (..., P, 9)."""
    JtW = J.mT * weight[..., None, :]
    return JtW @ J, -(JtW @ r[..., None])[..., 0]


def _depth_rows(
    inverse_depth: Tensor, now: Warp, linear: Warp, kept: Tensor, noise: Noise
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """J (K, K, N, 9), r, weight (K, K, N) and cost of measured against warped inverse depth, linear about `linear`."""
    measured, g, on_surface = sample_surface(inverse_depth, now.centre)
    on = kept & on_surface
    rho = 1 / torch.where(now.valid, now.P[..., 2], 1.0)
    rho_0 = 1 / torch.where(linear.valid, linear.P[..., 2], 1.0)
    r = torch.where(on, measured - rho, 0.0)
    weight = 1 / (noise.var_depth + noise.var_pixel * g.square().sum(-1))
    s = r * weight.sqrt()
    past = OTHER_SURFACE * noise.huber
    slope = (rho_0 * rho_0)[..., None]
    dr_dxi = (g[..., None, :] @ linear.duv_dxi)[..., 0, :] + slope * linear.dP_dxi[..., 2, :]
    dr_dd = (g * linear.duv_dd).sum(-1, keepdim=True) + slope * linear.dP_dd[..., 2:]
    J = torch.cat([dr_dxi, torch.zeros_like(dr_dxi[..., :2]), dr_dd], dim=-1)
    weight = weight * huber_weight(s, noise.huber, past) * on
    return J, r, weight, (2 * robust_cost(s, noise.huber, past) * on).sum(-1)


def _chain(T_linear: Tensor, gain: Tensor) -> Tensor:
    """(K, K, 8, 8): increments of the relative state by those of the host."""
    K = len(T_linear)
    chain = torch.zeros(K, K, STEP, STEP, dtype=T_linear.dtype)
    chain[..., :6, :6] = -adjoint(relative_poses(T_linear)[:, :, 0])
    chain[..., 6, 6] = -1.0
    chain[..., 7, 7] = -gain
    return chain
