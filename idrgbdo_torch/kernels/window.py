"""Fused linearisation of the sliding window: every point of every keyframe against every other keyframe."""

from __future__ import annotations

from math import exp, sqrt

import numpy as np

from ..measurement import OTHER_SURFACE, PATTERN_U, PATTERN_V
from .compiled import kernel
from .image import sample, sample_inverse_depth
from .photometric import (
    along_depth,
    depth_jacobian,
    distortion,
    distortion_weight,
    moved,
    photometric_variance,
    pose_jacobian,
)
from .se3 import adjoint, inverse
from .solver import dot, multiply


@kernel
def linearise_window(views, state, points, hosts, limit, noise, system):
    """Normal equations of the window: views Views, state WindowState, points WindowPoints; fills a WindowSystem.

    hosts (K,) bool: whose points take part. limit: of a point's rms. Returns the energy.
    """
    images, depths, slots, cam = views.images, views.depths, views.slots, views.camera
    T_cam_world, T_linear, affine, inv_depth = state.T, state.T_linear, state.affine, state.inv_depth
    H, b, Hd, bd, cross, rms = system.H, system.b, system.Hd, system.bd, system.cross, system.rms
    K, N = inv_depth.shape
    fx, fy, cx, cy = cam[0], cam[1], cam[2], cam[3]
    H[:] = 0.0
    b[:] = 0.0
    Hd[:] = 0.0
    bd[:] = 0.0
    cross[:] = 0.0
    rms[:] = -1.0
    energy = 0.0
    huber = noise.huber
    huber2 = huber * huber
    J = np.empty((2, 7))  # [v, w, d]
    Jz = np.empty(7)
    with_d = np.empty(8)  # between [v, w, a, b] of the relative state and the inverse depth
    pixels = points.patch.shape[2]
    for host in range(K):
        if not hosts[host]:
            continue
        # the measurement of every point's own sensor
        for n in range(N):
            if points.valid[host, n]:
                r = inv_depth[host, n] - points.measured[host, n]
                w = 1.0 / points.variance[host, n]
                energy += w * r * r
                Hd[host, n] += w
                bd[host, n] -= w * r
        for target in range(K):
            if target == host:
                continue
            T = multiply(T_cam_world[target], inverse(T_cam_world[host]))
            T0 = multiply(T_linear[target], inverse(T_linear[host]))
            image = images[slots[target]]
            depth = depths[slots[target]]
            gain = exp(affine[target, 0] - affine[host, 0])
            chain = np.zeros((8, 8))  # increments of the relative state by those of the host
            chain[:6, :6] = -adjoint(T0)
            chain[6, 6] = -1.0
            chain[7, 7] = -gain
            pair = np.zeros((8, 8))
            pair_b = np.zeros(8)
            for n in range(N):
                if not points.valid[host, n]:
                    continue
                d = inv_depth[host, n]
                if d <= 1e-3:
                    continue
                mx = (points.uv[host, n, 0] - cx) / fx
                my = (points.uv[host, n, 1] - cy) / fy
                qx, qy, qz = moved(T, mx, my, d)
                if qz < 1e-3:
                    continue
                iz = 1.0 / qz
                x = qx * iz
                y = qy * iz
                rho = d * iz
                a00, a01, a10, a11, area = distortion(T, x, y, iz, fx, fy)
                if area <= 0.0:
                    continue
                h = distortion_weight(area, noise.c_h)
                b00, b01, b10, b11 = a11 / area, -a10 / area, -a01 / area, a00 / area
                G00 = G01 = G11 = G02 = G12 = G03 = G13 = G22 = G23 = G33 = 0.0
                c0 = c1 = c2 = c3 = 0.0
                e = 0.0
                sum2 = 0.0
                inside = True
                for k in range(pixels):
                    ou = PATTERN_U[k] / fx
                    ov = PATTERN_V[k] / fy
                    od = points.slope[host, n, 0] * PATTERN_U[k] + points.slope[host, n, 1] * PATTERN_V[k]
                    kz = qz + T[2, 0] * ou + T[2, 1] * ov + T[2, 3] * od
                    if kz < 1e-3:
                        inside = False
                        break
                    kx = qx + T[0, 0] * ou + T[0, 1] * ov + T[0, 3] * od
                    ky = qy + T[1, 0] * ou + T[1, 1] * ov + T[1, 3] * od
                    ikz = 1.0 / kz
                    ok, value, gu, gv = sample(image, fx * kx * ikz + cx, fy * ky * ikz + cy)
                    if not ok:
                        inside = False
                        break
                    reference = gain * (points.patch[host, n, k] - affine[host, 1])
                    r = value - reference - affine[target, 1]
                    ru = np.float64(points.gradient[host, n, k, 0])
                    rv = np.float64(points.gradient[host, n, k, 1])
                    su = b00 * ru + b01 * rv
                    sv = b10 * ru + b11 * rv
                    # inverse depth is a state here: its noise must not count a second time
                    variance = h * photometric_variance(su, sv, 0.0, 0.0, 0.0, noise)
                    gu = (1.0 - noise.gradient_blend) * gu + noise.gradient_blend * su
                    gv = (1.0 - noise.gradient_blend) * gv + noise.gradient_blend * sv
                    w = 1.0 / variance
                    s2 = r * r * w
                    sum2 += s2
                    if s2 > huber2:
                        s = sqrt(s2)
                        e += huber * (2.0 * s - huber)
                        w *= huber / s
                    else:
                        e += s2
                    G00 += w * gu * gu
                    G01 += w * gu * gv
                    G11 += w * gv * gv
                    G02 -= w * gu * reference
                    G12 -= w * gv * reference
                    G03 -= w * gu
                    G13 -= w * gv
                    G22 += w * reference * reference
                    G23 += w * reference
                    G33 += w
                    c0 -= w * gu * r
                    c1 -= w * gv * r
                    c2 += w * reference * r
                    c3 += w * r
                if not inside:
                    continue
                point = sqrt(sum2 / pixels)
                rms[host, n, target] = point
                if point > limit:
                    energy += limit * limit * pixels
                    continue
                energy += e
                # geometry at the linearisation point
                qx0, qy0, qz0 = moved(T0, mx, my, d)
                iz0 = 1.0 / max(qz0, 1e-3)
                x0 = qx0 * iz0
                y0 = qy0 * iz0
                rho0 = d * iz0
                pose_jacobian(fx, fy, x0, y0, rho0, J)
                J[0, 6], J[1, 6] = along_depth(T0, x0, y0, iz0, fx, fy)
                gd0 = J[0, 6] * G00 + J[1, 6] * G01
                gd1 = J[0, 6] * G01 + J[1, 6] * G11
                for i in range(6):
                    g0 = J[0, i] * G00 + J[1, i] * G01
                    g1 = J[0, i] * G01 + J[1, i] * G11
                    for j in range(i, 6):
                        pair[i, j] += g0 * J[0, j] + g1 * J[1, j]
                    pair[i, 6] += J[0, i] * G02 + J[1, i] * G12
                    pair[i, 7] += J[0, i] * G03 + J[1, i] * G13
                    pair_b[i] += J[0, i] * c0 + J[1, i] * c1
                    with_d[i] = gd0 * J[0, i] + gd1 * J[1, i]
                pair[6, 6] += G22
                pair[6, 7] += G23
                pair[7, 7] += G33
                pair_b[6] += c2
                pair_b[7] += c3
                with_d[6] = J[0, 6] * G02 + J[1, 6] * G12
                with_d[7] = J[0, 6] * G03 + J[1, 6] * G13
                Hd[host, n] += gd0 * J[0, 6] + gd1 * J[1, 6]
                bd[host, n] += J[0, 6] * c0 + J[1, 6] * c1
                if noise.use_depth:
                    ok, measured, gu, gv = sample_inverse_depth(depth, fx * x + cx, fy * y + cy, 0.05)
                    if ok:
                        r = measured - rho
                        w = 1.0 / (noise.var_depth + noise.var_pixel * (gu * gu + gv * gv))
                        s = sqrt(r * r * w)
                        if s > OTHER_SURFACE * huber:
                            energy += (2.0 * OTHER_SURFACE - 1.0) * huber * huber
                        else:
                            if s > huber:
                                energy += huber * (2.0 * s - huber)
                                w *= huber / s
                            else:
                                energy += s * s
                            depth_jacobian(gu, gv, x0, y0, rho0, J, Jz)
                            Jz[6] = gu * J[0, 6] + gv * J[1, 6] - iz0 * (1.0 - rho0 * T0[2, 3])
                            for i in range(6):
                                wj = w * Jz[i]
                                for j in range(i, 6):
                                    pair[i, j] += wj * Jz[j]
                                pair_b[i] -= wj * r
                                with_d[i] += wj * Jz[6]
                            Hd[host, n] += w * Jz[6] * Jz[6]
                            bd[host, n] -= w * Jz[6] * r
                for i in range(8):
                    cross[host, n, 8 * target + i] += with_d[i]
                for i in range(6):
                    s = 0.0
                    for j in range(6):
                        s += chain[j, i] * with_d[j]
                    cross[host, n, 8 * host + i] += s
                cross[host, n, 8 * host + 6] -= with_d[6]
                cross[host, n, 8 * host + 7] -= gain * with_d[7]
            for i in range(8):
                for j in range(i):
                    pair[i, j] = pair[j, i]
            across = multiply(pair, chain)
            on_host = multiply(chain.T, across)
            ho = 8 * host
            ta = 8 * target
            for i in range(8):
                for j in range(8):
                    H[ta + i, ta + j] += pair[i, j]
                    H[ta + i, ho + j] += across[i, j]
                    H[ho + i, ta + j] += across[j, i]
                    H[ho + i, ho + j] += on_host[i, j]
                b[ta + i] += pair_b[i]
                b[ho + i] += dot(chain[:, i], pair_b)
    return energy


@kernel
def eliminate_depths(system):
    """Schur complement of the inverse depths, whose block is diagonal: (8K, 8K) and (8K,) of poses and brightness."""
    H, b, Hd, cross, bd = system.H, system.b, system.Hd, system.cross, system.bd
    n = H.shape[0]
    K, N = Hd.shape
    out = H.copy()
    rhs = b.copy()
    for k in range(K):
        for p in range(N):
            if Hd[k, p] <= 0.0:
                continue
            row = cross[k, p]
            inverse_depth = 1.0 / Hd[k, p]
            for i in range(n):
                if row[i] == 0.0:
                    continue
                w = row[i] * inverse_depth
                rhs[i] -= w * bd[k, p]
                for j in range(i, n):
                    out[i, j] -= w * row[j]
    for i in range(n):
        for j in range(i):
            out[i, j] = out[j, i]
    return out, rhs
