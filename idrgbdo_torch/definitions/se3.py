"""Rigid motions as (..., 4, 4) matrices and twists xi = [v, w], translation first, over any leading batch dimensions.

Every function keeps dtype (float32 or float64), is differentiable by autograd, and has finite gradients at identity.
"""

from __future__ import annotations

from math import factorial

import torch
from torch import Tensor

SERIES_TERMS = 10  # of the Taylor series used below one radian: the first term left out is 1e-19 there


def hat(w: Tensor) -> Tensor:
    """The (..., 3, 3) skew matrix of w (..., 3), so that hat(w) @ x is the cross product of w and x."""
    x, y, z = w.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).reshape(*w.shape[:-1], 3, 3)


def exp(xi: Tensor) -> Tensor:
    """The motion (..., 4, 4) of twist xi (..., 6): [v in m, w in rad]."""
    v, w = xi[..., :3], xi[..., 3:]
    W = hat(w)
    WW = W @ W
    sinc, versine, cubic = (c[..., None, None] for c in _rotation_series((w * w).sum(-1)))
    eye = torch.eye(3, dtype=xi.dtype, device=xi.device)
    R = eye + sinc * W + versine * WW
    V = eye + versine * W + cubic * WW
    return _assemble(R, (V @ v[..., None])[..., 0])


def log(T: Tensor) -> Tensor:
    """The twist xi (..., 6) of a motion T (..., 4, 4), with a rotation angle of at most pi."""
    w = _log_rotation(T[..., :3, :3])
    W = hat(w)
    _, versine, cubic = (c[..., None, None] for c in _rotation_series((w * w).sum(-1)))
    V = torch.eye(3, dtype=T.dtype, device=T.device) + versine * W + cubic * (W @ W)
    v = torch.linalg.solve(V, T[..., :3, 3:])[..., 0]  # V is invertible below a full turn
    return torch.cat([v, w], dim=-1)


def retract(xi: Tensor, T: Tensor) -> Tensor:
    """Eq. (1). T^(k+1) = exp(xi) T^(k), the left update of a pose T (..., 4, 4) by an increment xi (..., 6)."""
    return exp(xi) @ T


def inverse(T: Tensor) -> Tensor:
    """The inverse motion: inverse(T_a_b) is T_b_a, (..., 4, 4)."""
    R_inverse = T[..., :3, :3].mT
    return _assemble(R_inverse, -(R_inverse @ T[..., :3, 3:])[..., 0])


def transform(T: Tensor, P: Tensor) -> Tensor:
    """Points T_a_b P_b (..., 3). The leading dimensions of T (..., 4, 4) and P (..., 3) broadcast."""
    return (T[..., :3, :3] @ P[..., None])[..., 0] + T[..., :3, 3]


def adjoint(T: Tensor) -> Tensor:
    """The (..., 6, 6) matrix with T exp(xi) = exp(adjoint(T) xi) T, for twists [v, w]."""
    R = T[..., :3, :3]
    top = torch.cat([R, hat(T[..., :3, 3]) @ R], dim=-1)
    bottom = torch.cat([torch.zeros_like(R), R], dim=-1)
    return torch.cat([top, bottom], dim=-2)


def _rotation_series(angle2: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """sin t / t, (1 - cos t) / t^2 and (t - sin t) / t^3 from t^2, smooth at 0."""
    small = angle2 < 1.0
    safe = torch.where(small, torch.ones_like(angle2), angle2)  # both branches finite, so gradients are too
    t = safe.sqrt()
    closed = (t.sin() / t, (1 - t.cos()) / safe, (t - t.sin()) / (safe * t))
    x = torch.where(small, angle2, torch.zeros_like(angle2))
    series = (_alternating_series(x, first) for first in (1, 2, 3))
    sinc, versine, cubic = (torch.where(small, near, far) for near, far in zip(series, closed, strict=True))
    return sinc, versine, cubic


def _alternating_series(x: Tensor, first: int) -> Tensor:
    """Sum over k of (-x)^k / (2 k + first)! by Horner's rule."""
    total = torch.zeros_like(x)
    for k in reversed(range(SERIES_TERMS + 1)):
        total = torch.full_like(x, 1 / factorial(2 * k + first)) - x * total
    return total


def _log_rotation(R: Tensor) -> Tensor:
    """Rotation vector (..., 3) through the unit quaternion, accurate at 0 and near pi.

    4 q q^T is linear in R; its row with the largest diagonal, normalised, is q up to sign, well conditioned.
    """
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = R.flatten(-2).unbind(-1)
    rows = [
        [1 + r00 + r11 + r22, r21 - r12, r02 - r20, r10 - r01],
        [r21 - r12, 1 + r00 - r11 - r22, r01 + r10, r02 + r20],
        [r02 - r20, r01 + r10, 1 - r00 + r11 - r22, r12 + r21],
        [r10 - r01, r02 + r20, r12 + r21, 1 - r00 - r11 + r22],
    ]
    K = torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)  # (..., 4, 4)
    best = K.diagonal(dim1=-2, dim2=-1).argmax(-1)[..., None, None].expand(*K.shape[:-2], 1, 4)
    q = K.gather(-2, best)[..., 0, :]
    q = q / torch.linalg.vector_norm(q, dim=-1, keepdim=True)
    q = torch.where(q[..., :1] < 0, -q, q)
    real, imaginary = q[..., 0], q[..., 1:]
    n2 = (imaginary * imaginary).sum(-1)  # sin^2 of half the angle
    small = n2 < 1e-4
    n = torch.where(small, torch.ones_like(n2), n2).sqrt()
    x = torch.where(small, n2, torch.zeros_like(n2))
    near = 2 + x * (1 / 3 + x * (3 / 20 + x * (5 / 56 + x * (35 / 576))))  # 2 asin(n) / n
    return torch.where(small, near, 2 * torch.atan2(n, real) / n)[..., None] * imaginary


def _assemble(R: Tensor, t: Tensor) -> Tensor:
    """The (..., 4, 4) motion of rotation (..., 3, 3) and translation (..., 3)."""
    top = torch.cat([R, t[..., None]], dim=-1)
    bottom = torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=R.dtype, device=R.device).expand(*top.shape[:-2], 1, 4)
    return torch.cat([top, bottom], dim=-2)
