"""Where a frame's depth lies on the surface that a keyframe saw: point to plane, by projection, with no brightness."""

from __future__ import annotations

from math import sqrt

import numpy as np

from .candidates import fit_plane
from .compiled import kernel
from .se3 import compose, inverse, log_se3, retract
from .solver import solve_spd

ROUGH = 0.005  # share of its depth by which a surface is no plane
HUBER = 1.5  # standard deviations, from which on a point counts less
LAST = 0.05  # share of its depth by which a point is off its plane that does not agree


@kernel
def surface_planes(depth, intrinsics, step, radius, sigma):
    """(N, 6): points (m) on a grid of the depth image where a plane fits, and its unit normals there.

    step: px of the grid; radius, sigma: see fit_plane.
    """
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    out = np.empty(((height // step + 1) * (width // step + 1), 6))
    count = 0
    for v in range(radius, height - radius, step):
        for u in range(radius, width - radius, step):
            ok, d, du, dv = fit_plane(depth, u, v, radius, sigma)
            if not (ok and d > 0.0):
                continue
            # on a plane n P = 1 inverse depth is linear in pixels: n = (fx du, fy dv, what is left at the point)
            x, y = (u - cx) / fx, (v - cy) / fy
            n0, n1 = fx * du, fy * dv
            n2 = d - n0 * x - n1 * y
            length = sqrt(n0 * n0 + n1 * n1 + n2 * n2)  # n2 > 0 on all that faces the camera
            out[count, 0], out[count, 1], out[count, 2] = x / d, y / d, 1.0 / d
            out[count, 3], out[count, 4], out[count, 5] = n0 / length, n1 / length, n2 / length
            count += 1
    return out[:count]


@kernel
def align_surface(depth, intrinsics, planes, guess, held, sigma, gates):
    """(T (4, 4), information (6, 6) of a left increment, share of the planes in view, share of those that agree).

    Gauss-Newton on the distances, point to plane, of what the frame measures at the pixels where it sees the planes.
    depth: the frame's; planes: surface_planes() of the keyframe; guess: T_frame_kf, which held (6,) information holds;
    sigma: noise of a reading in 1/m; gates: (S,) share of its depth by which a point may be off, step by step.
    """
    T, back = guess, inverse(guess)
    H, b = np.zeros((6, 6)), np.zeros(6)
    for s in range(gates.shape[0]):
        surface_equations(depth, intrinsics, planes, T, sigma, gates[s], H, b)
        away = log_se3(compose(T, back))
        for k in range(6):
            H[k, k] += held[k]
            b[k] -= held[k] * away[k]
        ok, step = solve_spd(H, b)
        if not ok:
            break
        T = retract(step, T)
    seen, agree = surface_equations(depth, intrinsics, planes, T, sigma, LAST, H, b)
    return T, H, seen, agree


@kernel
def surface_equations(depth, intrinsics, planes, T, sigma, gate, H, b):
    """Fill the normal equations at a pose; returns the share of the planes in view, and of those that agree."""
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    for i in range(6):  # not b[:] = 0, see solver.put
        b[i] = 0.0
        for j in range(6):
            H[i, j] = 0.0
    J = np.empty(6)
    seen, agree = 0, 0
    for n in range(planes.shape[0]):
        X, Y, Z, a, c, e = planes[n, 0], planes[n, 1], planes[n, 2], planes[n, 3], planes[n, 4], planes[n, 5]
        x = T[0, 0] * X + T[0, 1] * Y + T[0, 2] * Z + T[0, 3]
        y = T[1, 0] * X + T[1, 1] * Y + T[1, 2] * Z + T[1, 3]
        z = T[2, 0] * X + T[2, 1] * Y + T[2, 2] * Z + T[2, 3]
        if z < 1e-3:
            continue
        u, v = fx * x / z + cx + 0.5, fy * y / z + cy + 0.5
        if not (u >= 0.0 and v >= 0.0 and u < width and v < height):
            continue
        iu, iv = int(u), int(v)
        measured = np.float64(depth[iv, iu])
        if not measured > 0.0:
            continue
        seen += 1
        p, q = (iu - cx) / fx * measured, (iv - cy) / fy * measured
        m0 = T[0, 0] * a + T[0, 1] * c + T[0, 2] * e
        m1 = T[1, 0] * a + T[1, 1] * c + T[1, 2] * e
        m2 = T[2, 0] * a + T[2, 1] * c + T[2, 2] * e
        r = m0 * (p - x) + m1 * (q - y) + m2 * (measured - z)
        if not abs(r) < gate * measured:
            continue
        agree += 1
        noise, rough = sigma * measured * measured * m2, ROUGH * measured
        variance = noise * noise + rough * rough
        weight = min(1.0, HUBER * sqrt(variance) / max(abs(r), 1e-9)) / variance
        J[0], J[1], J[2] = m0, m1, m2
        J[3], J[4], J[5] = q * m2 - measured * m1, measured * m0 - p * m2, p * m1 - q * m0
        for i in range(6):
            b[i] += weight * J[i] * r
            for j in range(i + 1):
                H[i, j] += weight * J[i] * J[j]
    for i in range(6):
        for j in range(i):
            H[j, i] = H[i, j]
    return seen / max(planes.shape[0], 1), agree / max(seen, 1)
