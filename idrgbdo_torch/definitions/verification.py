"""How far points agree with a pose, in torch: twin of kernels.verification."""

from __future__ import annotations

import torch

from ..measurement import IN_FRONT, NEAR_SHARE, NEAR_SIGMAS, Agreement, Noise, Points, State, View
from .camera import Pinhole, backproject, project
from .convert import Array, chosen, inverse_of_depth, pinhole
from .image import sample_surface, sample_with_gradient
from .photometric import PATTERN_1, warp
from .points import at_level
from .se3 import transform


def verify(view: View, level: int, points: Points, index: Array, state: State, noise: Noise, limit: float) -> Agreement:
    """Twin of kernels.verification.verify."""
    image, patch = view.images[level], points.patch[level]
    camera = pinhole(view.cameras[level], image)
    some = chosen(points, index)
    uv, d = some.uv[0], some.inverse_depth[0]
    warped = warp(camera, at_level(uv, level), d, torch.from_numpy(state.T), PATTERN_1)
    value, _, valid = sample_with_gradient(torch.from_numpy(image), warped.centre)
    seen = warped.valid & valid
    a, b = torch.from_numpy(state.affine)
    off = value - a.exp() * torch.from_numpy(patch)[torch.from_numpy(index), 0] - b
    bright = seen & (off.abs() < limit)
    at_full = (warped.centre + 0.5) * 2.0**level - 0.5
    measured, _, on_surface = sample_surface(inverse_of_depth(view.depth), at_full, 0.1)
    rho = 1 / torch.where(warped.valid, warped.P[:, 2], 1.0)
    with_depth = seen & on_surface
    tolerance = NEAR_SIGMAS * (noise.var_depth + some.variance[0]).sqrt() + NEAR_SHARE * rho
    near = with_depth & ((measured - rho).abs() < tolerance)
    hidden = with_depth & ~near & (measured > (1 + IN_FRONT) * rho)
    counts = (seen, bright, with_depth, near, hidden, hidden & bright)
    return Agreement(*(int(each.sum()) for each in counts))


def displacement(cam: Array, points: Points, index: Array, T_a: Array, T_b: Array) -> float:
    """Twin of kernels.verification.displacement: mean distance in px of points at two poses, inf without any."""
    fx, fy, cx, cy = (float(x) for x in cam)
    camera = Pinhole(width=1, height=1, fx=fx, fy=fy, cx=cx, cy=cy)  # only the projection is asked for
    some = chosen(points, index)
    P = backproject(camera, some.uv[0], some.inverse_depth[0])
    (uv_a, front_a), (uv_b, front_b) = (project(camera, transform(torch.from_numpy(T), P)) for T in (T_a, T_b))
    apart = (uv_a - uv_b).norm(dim=-1)[front_a & front_b]
    return float(apart.mean()) if len(apart) else float("inf")
