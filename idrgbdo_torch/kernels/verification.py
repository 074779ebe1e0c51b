"""How well a pose explains points that did not choose it, and how far two poses are apart in the image."""

from __future__ import annotations

from math import exp, sqrt

import numpy as np

from ..measurement import IN_FRONT, NEAR_SHARE, NEAR_SIGMAS, Agreement
from .compiled import kernel
from .image import sample, sample_inverse_depth
from .photometric import moved


@kernel
def verify(view, level, points, index, state, noise, limit):
    """How many of some points a State explains in a View on a level (Agreement); limit: gray levels."""
    image, depth, cam = view.images[level], view.depth, view.cameras[level]
    patch, T, affine = points.patch[level], state.T, state.affine
    fx, fy, cx, cy = cam[0], cam[1], cam[2], cam[3]
    size = 0.5**level
    up = 1.0 / size
    gain = exp(affine[0])
    seen = 0
    bright = 0
    with_depth = 0
    near = 0
    hidden = 0
    hidden_bright = 0
    for n in range(index.shape[0]):
        p = index[n]
        d = points.inv_depth[p]
        mx = ((points.uv[p, 0] + 0.5) * size - 0.5 - cx) / fx
        my = ((points.uv[p, 1] + 0.5) * size - 0.5 - cy) / fy
        qx, qy, qz = moved(T, mx, my, d)
        if qz < 1e-3:
            continue
        u = fx * qx / qz + cx
        v = fy * qy / qz + cy
        ok, value, _gu, _gv = sample(image, u, v)
        if not ok:
            continue
        seen += 1
        agrees = abs(value - gain * patch[p, 0] - affine[1]) < limit
        if agrees:
            bright += 1
        ok, measured, _gu, _gv = sample_inverse_depth(depth, (u + 0.5) * up - 0.5, (v + 0.5) * up - 0.5, 0.1)
        if ok:
            with_depth += 1
            rho = d / qz
            if abs(measured - rho) < NEAR_SIGMAS * sqrt(noise.var_depth + points.var_inv_depth[p]) + NEAR_SHARE * rho:
                near += 1
            elif measured > (1.0 + IN_FRONT) * rho:
                hidden += 1
                if agrees:
                    hidden_bright += 1
    return Agreement(seen, bright, with_depth, near, hidden, hidden_bright)


@kernel
def displacement(cam, points, index, T_a, T_b):
    """Mean distance in px between the projections of points at two poses; infinite where none is in front of both."""
    fx, fy, cx, cy = cam[0], cam[1], cam[2], cam[3]
    total = 0.0
    seen = 0
    for n in range(index.shape[0]):
        p = index[n]
        d = points.inv_depth[p]
        mx = (points.uv[p, 0] - cx) / fx
        my = (points.uv[p, 1] - cy) / fy
        xa, ya, za = moved(T_a, mx, my, d)
        xb, yb, zb = moved(T_b, mx, my, d)
        if za < 1e-3 or zb < 1e-3:
            continue
        total += sqrt((fx * (xa / za - xb / zb)) ** 2 + (fy * (ya / za - yb / zb)) ** 2)
        seen += 1
    return total / seen if seen > 0 else np.inf
