"""Rows and normal equations that the sparse baselines share, batched torch in float64."""

from __future__ import annotations

import torch
from torch import Tensor


def twist_jacobian(dr_dP: Tensor, P: Tensor) -> Tensor:
    """Jacobians (N, ..., 6) of a left increment [v, w] from those of the moved points: dr_dP (N, ..., 3), P (N, 3)."""
    P = P.reshape(len(P), *[1] * (dr_dP.dim() - 2), 3)
    return torch.cat([dr_dP, torch.linalg.cross(P.expand_as(dr_dP), dr_dP)], dim=-1)


def surface_inverse_depth(depth: Tensor, uv: Tensor, half: int = 3, agreement: float = 0.03) -> Tensor:
    """(N,) inverse depths at pixels uv (N, 2) of a depth image (H, W) in m; NaN where there is no single surface.

    The inverse depth of a plane is linear in the pixel, so a linear fit over a square of 2 half + 1 pixels averages the
    noise without bias. At least 70 % of the pixels must be within `agreement` of the middle one.
    """
    height, width = depth.shape
    steps = torch.arange(-half, half + 1)
    dv, du = (x.reshape(-1) for x in torch.meshgrid(steps, steps, indexing="ij"))
    middle = uv.round().long()
    u, v = middle[:, :1] + du, middle[:, 1:] + dv  # (N, K)
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    z = torch.where(inside, depth[v.clamp(0, height - 1), u.clamp(0, width - 1)], 0.0).double()
    d = torch.where(z > 0, 1 / z.clamp(min=1e-6), 0.0)
    centre = d[:, len(du) // 2, None]
    weight = ((d > 0) & ((d - centre).abs() < agreement * centre)).double()
    X = torch.stack([torch.ones_like(d), u - uv[:, :1], v - uv[:, 1:]], dim=-1)  # (N, K, 3)
    XtW = (X * weight[..., None]).mT
    H = XtW @ X + 1e-6 * torch.eye(3, dtype=torch.float64)
    value = torch.linalg.solve(H, (XtW @ d[..., None])[..., 0])[:, 0]
    return torch.where((weight.sum(1) >= 0.7 * len(du)) & (value > 0), value, torch.nan)


def student_weight(squared: Tensor, freedom: float, dimension: int) -> Tensor:
    """Weights of residuals with squared whitened length (N,) under a t-distribution of that dimension."""
    return (freedom + dimension) / (freedom + squared)
