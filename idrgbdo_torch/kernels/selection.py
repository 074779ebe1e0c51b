"""Fused Algorithm 1: whitened rows of every candidate, and the greedy choice among them."""

from __future__ import annotations

from math import log, sqrt

import numpy as np

from ..measurement import GRADIENT_NOISE, Rows
from .compiled import kernel
from .photometric import along_depth, distortion, distortion_weight, moved, photometric_variance, pose_jacobian
from .solver import inverse_spd

CHUNK = 128  # points whose gains are computed together
BLOCK = 32  # points that share a leader in the greedy choice


@kernel
def whitened_rows(cam, width, height, margin, points, index, T, noise):
    """Rows A (M, 3, 6) whose A^T A is a point's information at pose T, and who is seen: the margin inside the image.

    The first two rows carry the patch, L^T J_geo with L L^T = G (design: rank 2 a patch), the third the depth residual.
    """
    fx, fy, cx, cy = cam[0], cam[1], cam[2], cam[3]
    pixels = points.patch.shape[2]
    n = index.shape[0]
    A = np.zeros((n, 3, 6))
    seen = np.zeros(n, dtype=np.bool_)
    where = np.zeros((n, 2))
    J = np.empty((2, 6))
    for m in range(n):
        p = index[m]
        d = points.inv_depth[p]
        mx = (points.uv[p, 0] - cx) / fx
        my = (points.uv[p, 1] - cy) / fy
        qx, qy, qz = moved(T, mx, my, d)
        if qz < 1e-3:
            continue
        iz = 1.0 / qz
        x = qx * iz
        y = qy * iz
        u = fx * x + cx
        v = fy * y + cy
        if not (u >= margin and v >= margin and u <= width - 1 - margin and v <= height - 1 - margin):
            continue
        area = distortion(T, x, y, iz, fx, fy)[4]
        if area <= 0.0:
            continue
        seen[m] = True
        where[m, 0] = u
        where[m, 1] = v
        rho = d * iz
        h = distortion_weight(area, noise.c_h)
        du_dd, dv_dd = along_depth(T, x, y, iz, fx, fy)
        var_d = points.var_inv_depth[p]
        G00 = G01 = G11 = 0.0
        for k in range(pixels):
            gu = np.float64(points.gradient[0, p, k, 0])
            gv = np.float64(points.gradient[0, p, k, 1])
            w = 1.0 / (h * photometric_variance(gu, gv, du_dd, dv_dd, var_d, noise))
            # noise alone looks like a gradient too: on a bare wall it must not pass for information
            w *= max(0.0, 1.0 - GRADIENT_NOISE * noise.var_intensity / (gu * gu + gv * gv + 1e-9))
            G00 += w * gu * gu
            G01 += w * gu * gv
            G11 += w * gv * gv
        L00 = sqrt(G00)
        L10 = G01 / L00 if L00 > 0.0 else 0.0
        L11 = sqrt(max(0.0, G11 - L10 * L10))
        pose_jacobian(fx, fy, x, y, rho, J)
        for i in range(6):
            A[m, 0, i] = L00 * J[0, i] + L10 * J[1, i]
            A[m, 1, i] = L11 * J[1, i]
        if noise.use_depth:
            s = sqrt(1.0 / (noise.var_depth + iz**4 * var_d))
            A[m, 2, 2] = s * rho * rho
            A[m, 2, 3] = s * rho * y
            A[m, 2, 4] = -s * rho * x
    return Rows(A, seen, where)


@kernel
def gain_bits(A, n, C, AC):
    """1/2 log2 det(I_3 + A_n C A_n^T): what point n adds, in bits (Eq. 17); AC (3, 6) is overwritten."""
    for r in range(3):
        for i in range(6):
            AC[r, i] = 0.0
        for j in range(6):
            a = A[n, r, j]
            for i in range(6):
                AC[r, i] += a * C[j, i]
    s00 = s11 = s22 = 1.0
    s01 = s02 = s12 = 0.0
    for i in range(6):
        s00 += AC[0, i] * A[n, 0, i]
        s01 += AC[0, i] * A[n, 1, i]
        s02 += AC[0, i] * A[n, 2, i]
        s11 += AC[1, i] * A[n, 1, i]
        s12 += AC[1, i] * A[n, 2, i]
        s22 += AC[2, i] * A[n, 2, i]
    det = s00 * (s11 * s22 - s12 * s12) - s01 * (s01 * s22 - s12 * s02) + s02 * (s01 * s12 - s11 * s02)
    return 0.5 * log(max(det, 1.0)) / log(2.0)


@kernel
def all_gains(columns, C):
    """gain_bits of every point (N,), from its rows with the points last, (3, 6, N)."""
    n = columns.shape[2]
    out = np.empty(n)
    AC = np.empty((3, 6, CHUNK))
    S = np.empty((6, CHUNK))
    for first in range(0, n, CHUNK):
        size = min(CHUNK, n - first)
        for r in range(3):
            for i in range(6):
                c0, c1, c2, c3, c4, c5 = C[0, i], C[1, i], C[2, i], C[3, i], C[4, i], C[5, i]
                for m in range(size):
                    p = first + m
                    AC[r, i, m] = (
                        (columns[r, 0, p] * c0 + columns[r, 1, p] * c1)
                        + (columns[r, 2, p] * c2 + columns[r, 3, p] * c3)
                        + (columns[r, 4, p] * c4 + columns[r, 5, p] * c5)
                    )
        pair = 0
        for r in range(3):
            for q in range(r, 3):
                one = 1.0 if r == q else 0.0
                for m in range(size):
                    p = first + m
                    S[pair, m] = (
                        one
                        + (AC[r, 0, m] * columns[q, 0, p] + AC[r, 1, m] * columns[q, 1, p])
                        + (AC[r, 2, m] * columns[q, 2, p] + AC[r, 3, m] * columns[q, 3, p])
                        + (AC[r, 4, m] * columns[q, 4, p] + AC[r, 5, m] * columns[q, 5, p])
                    )
                pair += 1
        for m in range(size):
            s00, s01, s02, s11, s12, s22 = S[0, m], S[1, m], S[2, m], S[3, m], S[4, m], S[5, m]
            det = s00 * (s11 * s22 - s12 * s12) - s01 * (s01 * s22 - s12 * s02) + s02 * (s01 * s12 - s11 * s02)
            out[first + m] = 0.5 * log(max(det, 1.0)) / log(2.0)
    return out


@kernel
def select(rows, radius, m, most, information, bits, spread, c_z, distance):
    """Algorithm 1 over whitened rows, lazily: a gain can only shrink as points join, so a stale gain is a bound.

    radius: (N,) 0 at the principal point to 1; information: (6, 6) start, positive definite; spread: weight of the
    second term of Eq. 18 in bits; distance: px between chosen points (overlapping patches measure the same thing).
    After m points it goes on, up to `most`, while the worst entropy of the pose is above `bits`.
    Returns the chosen indices (<= most,) in order of choice.
    """
    A, seen, where = rows.A, rows.seen, rows.where
    n = A.shape[0]
    barred = np.empty(n)  # 0, or -infinity for a point that is out of the race
    u = np.empty(n)
    v = np.empty(n)
    for i in range(n):
        barred[i] = 0.0 if seen[i] else -np.inf
        u[i] = where[i, 0]
        v[i] = where[i, 1]
    chosen = np.empty(most, dtype=np.int64)
    if n == 0:
        return chosen[:0]
    count = 0
    L = information.copy()
    distance2 = distance * distance
    # one point per degree of freedom: the largest whitened derivative
    columns = np.empty((3, 6, n))  # points last, so that what is done to all of them becomes SIMD
    for i in range(n):
        for r in range(3):
            for k in range(6):
                columns[r, k, i] = A[i, r, k]
    for k in range(6):
        best = -1
        best_value = 0.0
        for i in range(n):
            square = columns[0, k, i] ** 2 + columns[1, k, i] ** 2 + columns[2, k, i] ** 2
            if square > best_value and barred[i] == 0.0:
                best_value = square
                best = i
        if count >= m:
            break
        if best < 0:  # no point sees this degree of freedom
            continue
        chosen[count] = best
        count += 1
        for r in range(3):
            for i in range(6):
                for j in range(6):
                    L[i, j] += A[best, r, i] * A[best, r, j]
        bar(barred, u, v, best, distance2)
    C = inverse_spd(L)
    AC = np.empty((3, 6))
    gains = all_gains(columns, C)
    fresh = np.full(n, count)  # how many points had been chosen when a gain was computed
    value = np.empty(n)
    blocks = (n + BLOCK - 1) // BLOCK
    leader = np.empty(blocks, dtype=np.int64)  # the best of each block, so that a correction costs a block, not all
    steps = max(1, m - 6)
    z = 1.0
    while count < m or (count < most and worst_entropy(C) > bits):
        for i in range(n):
            value[i] = gains[i] + spread / (c_z * (radius[i] - z) ** 2 + 1.0) + barred[i]
        for block in range(blocks):
            leader[block] = largest(value, block * BLOCK, min(n, (block + 1) * BLOCK))
        best = leader[0]
        while True:
            best = leader[0]
            for block in range(1, blocks):
                if value[leader[block]] > value[best]:
                    best = leader[block]
            if value[best] == -np.inf or fresh[best] == count:
                break
            gain = gain_bits(A, best, C, AC)
            value[best] += gain - gains[best]
            gains[best] = gain
            fresh[best] = count
            block = best // BLOCK
            leader[block] = largest(value, block * BLOCK, min(n, (block + 1) * BLOCK))
        if value[best] == -np.inf:
            break
        chosen[count] = best
        count += 1
        for r in range(3):  # C <- (C^-1 + a^T a)^-1, row by row
            shrink(C, A[best, r])
        bar(barred, u, v, best, distance2)
        z = max(0.0, z - 1.0 / steps)
    return chosen[:count]


@kernel
def worst_entropy(C):
    """log2 of the largest standard deviation of a covariance (6, 6), in m or rad."""
    worst = C[0, 0]
    for k in range(1, 6):
        worst = max(worst, C[k, k])
    return 0.5 * log(worst) / log(2.0)


@kernel
def largest(value, first, end):
    """Index of the largest of value[first:end], the first of equals."""
    best = first
    for i in range(first + 1, end):
        if value[i] > value[best]:
            best = i
    return best


@kernel
def shrink(C, a):
    """Sherman-Morrison, in place: the covariance after one more whitened row a (6,)."""
    Ca = np.zeros(6)
    inner = 1.0
    for i in range(6):
        for j in range(6):
            Ca[i] += C[i, j] * a[j]
        inner += a[i] * Ca[i]
    for i in range(6):
        for j in range(6):
            C[i, j] -= Ca[i] * Ca[j] / inner


@kernel
def bar(barred, u, v, best, distance2):
    """Take the chosen point and everything closer than the distance out of the race."""
    for i in range(barred.shape[0]):  # no branches, so that this becomes SIMD
        near = (u[i] - u[best]) ** 2 + (v[i] - v[best]) ** 2 < distance2
        barred[i] = -np.inf if near else barred[i]
    barred[best] = -np.inf
