"""What the choice of points reads, in torch: twin of kernels.choice.

Algorithm 1 itself has its torch definition in selection.select_informative.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ..camera import Pinhole, inside
from ..kernels.choice import GRADIENT_NOISE
from ..kernels.model import Noise, Points
from ..photometric import (
    PATTERN_1,
    distortion_weight,
    gradient_information,
    photometric_variance,
    projective_distortion,
    residual_variance,
    warp,
)
from .convert import Array, chosen, residual_noise


def whitened_rows(
    cam: Array, width: int, height: int, margin: float, points: Points, index: Array, T: Array, noise: Noise
) -> tuple[Array, Array, Array]:
    """Twin of kernels.choice.whitened_rows: rows (M, 3, 6), seen (M,), pixels (M, 2)."""
    fx, fy, cx, cy = (float(x) for x in cam)
    camera = Pinhole(width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy)
    some = chosen(points, index)
    uv, d, var_d = some.uv[0], some.inverse_depth[0], some.variance[0]
    T_target_host = torch.from_numpy(T)
    warped = warp(camera, uv, d, T_target_host, PATTERN_1)
    P = torch.where(warped.valid[:, None], warped.P, 1.0)
    h, front = distortion_weight(projective_distortion(d, P, T_target_host), noise.c_h)
    seen = warped.valid & front & inside(camera, warped.centre, margin)

    gradient = some.gradient[0][0].double()
    sigma = residual_noise(noise)
    sigmas: dict[str, Any] = {"sigma_intensity": sigma.sigma_intensity, "sigma_pixel": sigma.sigma_pixel}
    phi = photometric_variance(gradient, warped.duv_dd, var_d.sqrt(), mode=sigma.mode, shared=sigma.shared, **sigmas)
    # noise alone looks like a gradient too: on a bare wall it must not pass for information
    signal = 1 - GRADIENT_NOISE * noise.var_intensity / (gradient.square().sum(-1) + 1e-9)
    G = gradient_information(gradient, signal.clamp(min=0) / residual_variance(h, phi))
    patch = _factor(G).mT @ warped.duv_dxi  # (M, 2, 6)

    z = P[:, 2]
    trust = (noise.var_depth + var_d / (z * d) ** 4).rsqrt() if noise.use_depth else torch.zeros_like(d)
    depth = (trust / z**2)[:, None] * warped.dP_dxi[:, 2]
    rows = torch.cat([patch, depth[:, None]], dim=1)
    rows = torch.where(seen[:, None, None], rows, 0.0)
    where = torch.where(seen[:, None], warped.centre, 0.0)
    return rows.numpy(), seen.numpy(), where.numpy()


def _factor(G: Tensor) -> Tensor:
    """Lower triangular L (..., 2, 2) with L L^T = G, zero where nothing is known."""
    L00 = G[..., 0, 0].sqrt()
    L10 = torch.where(L00 > 0, G[..., 0, 1] / torch.where(L00 > 0, L00, 1.0), 0.0)
    L11 = (G[..., 1, 1] - L10.square()).clamp(min=0).sqrt()
    return torch.stack([L00, torch.zeros_like(L00), L10, L11], dim=-1).reshape(*G.shape)
