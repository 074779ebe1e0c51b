"""Normal equations of a frame against a keyframe: the fused twin of photometric.py."""

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


@kernel
def linearise(view, level, points, subset, state, scale, limit, noise, system):
    """Normal equations of one level at one pose.

    view: View; subset: the points and pixels that count; state: State. scale: robust scale of the whitened residuals;
    limit: saturation of a point's rms in units of scale. Fills system: System.
    Returns (energy, points seen, points within the limit).
    """
    image, depth, cam = view.images[level], view.depth, view.cameras[level]
    index, pixels = subset.which, subset.pixels
    T, affine = state.T, state.affine
    H, b, rms = system.H, system.b, system.rms
    fx, fy, cx, cy = cam[0], cam[1], cam[2], cam[3]
    size = 0.5**level
    gain = exp(affine[0])
    H[:] = 0.0
    b[:] = 0.0
    J = np.empty((2, 6))
    Jz = np.empty(6)
    G = np.empty((4, 4))
    c = np.empty(4)
    energy = 0.0
    seen = 0
    kept = 0
    huber = noise.huber
    huber2 = huber * huber
    inv_scale2 = 1.0 / (scale * scale)
    for n in range(index.shape[0]):
        p = index[n]
        rms[n] = -1.0
        d = points.inv_depth[p]
        u0 = (points.uv[p, 0] + 0.5) * size - 0.5
        v0 = (points.uv[p, 1] + 0.5) * size - 0.5
        mx = (u0 - cx) / fx
        my = (v0 - cy) / fy
        qx, qy, qz = moved(T, mx, my, d)
        if qz < 1e-3:
            continue
        iz = 1.0 / qz
        x = qx * iz
        y = qy * iz
        rho = d * iz  # inverse depth in the target
        a00, a01, a10, a11, area = distortion(T, x, y, iz, fx, fy)
        if area <= 0.0:
            continue
        h = distortion_weight(area, noise.c_h)
        du_dd, dv_dd = along_depth(T, x, y, iz, fx, fy)
        var_d = points.var_inv_depth[p]
        G[:] = 0.0
        c[:] = 0.0
        e = 0.0
        sum2 = 0.0
        # a reference gradient seen from the target: (dp_i/dp_j)^-T g
        b00, b01, b10, b11 = a11 / area, -a10 / area, -a01 / area, a00 / area
        inside = True
        for k in range(pixels):
            ou = PATTERN_U[k] / fx
            ov = PATTERN_V[k] / fy
            od = (points.slope[p, 0] * PATTERN_U[k] + points.slope[p, 1] * PATTERN_V[k]) / size
            kx = qx + T[0, 0] * ou + T[0, 1] * ov + T[0, 3] * od
            ky = qy + T[1, 0] * ou + T[1, 1] * ov + T[1, 3] * od
            kz = qz + T[2, 0] * ou + T[2, 1] * ov + T[2, 3] * od
            if kz < 1e-3:
                inside = False
                break
            ikz = 1.0 / kz
            ok, value, gu, gv = sample(image, fx * kx * ikz + cx, fy * ky * ikz + cy)
            if not ok:
                inside = False
                break
            reference = gain * points.patch[level, p, k]
            r = value - reference - affine[1]
            # the variance comes from the reference: it must not change with the pose, or the cost would reward
            # places where the residual is merely less certain
            ru = np.float64(points.gradient[level, p, k, 0])
            rv = np.float64(points.gradient[level, p, k, 1])
            su = b00 * ru + b01 * rv
            sv = b10 * ru + b11 * rv
            variance = h * photometric_variance(su, sv, du_dd, dv_dd, var_d, noise)
            gu = (1.0 - noise.gradient_blend) * gu + noise.gradient_blend * su
            gv = (1.0 - noise.gradient_blend) * gv + noise.gradient_blend * sv
            w = inv_scale2 / variance
            s2 = r * r * w
            sum2 += s2
            if s2 > huber2:
                s = sqrt(s2)
                e += huber * (2.0 * s - huber)
                w *= huber / s
            else:
                e += s2
            wu = w * gu
            wv = w * gv
            G[0, 0] += wu * gu
            G[0, 1] += wu * gv
            G[1, 1] += wv * gv
            G[0, 2] -= wu * reference
            G[1, 2] -= wv * reference
            G[0, 3] -= wu
            G[1, 3] -= wv
            G[2, 2] += w * reference * reference
            G[2, 3] += w * reference
            G[3, 3] += w
            c[0] -= wu * r
            c[1] -= wv * r
            c[2] += w * reference * r
            c[3] += w * r
        if not inside:
            continue
        seen += 1
        point = sqrt(sum2 / pixels)
        rms[n] = point * scale
        if point > limit:
            energy += limit * limit * pixels
            continue
        kept += 1
        energy += e
        pose_jacobian(fx, fy, x, y, rho, J)
        for i in range(6):
            g0 = J[0, i] * G[0, 0] + J[1, i] * G[0, 1]
            g1 = J[0, i] * G[0, 1] + J[1, i] * G[1, 1]
            for j in range(i, 6):
                H[i, j] += g0 * J[0, j] + g1 * J[1, j]
            H[i, 6] += J[0, i] * G[0, 2] + J[1, i] * G[1, 2]
            H[i, 7] += J[0, i] * G[0, 3] + J[1, i] * G[1, 3]
            b[i] += J[0, i] * c[0] + J[1, i] * c[1]
        H[6, 6] += G[2, 2]
        H[6, 7] += G[2, 3]
        H[7, 7] += G[3, 3]
        b[6] += c[2]
        b[7] += c[3]
        if noise.use_depth:
            up = 1.0 / size
            ok, measured, gu, gv = sample_inverse_depth(
                depth, (fx * x + cx + 0.5) * up - 0.5, (fy * y + cy + 0.5) * up - 0.5, 0.05
            )
            if ok:
                r = measured - rho
                gu *= up
                gv *= up
                stretch = iz * iz  # d rho / d d, up to the small t_z term
                variance = noise.var_depth + stretch * stretch * var_d + noise.var_pixel * (gu * gu + gv * gv)
                w = 1.0 / variance
                s = sqrt(r * r * w)
                if s > huber:
                    if s > OTHER_SURFACE * huber:  # another surface: constant cost, no weight
                        energy += (2.0 * OTHER_SURFACE - 1.0) * huber * huber
                        continue
                    energy += huber * (2.0 * s - huber)
                    w *= huber / s
                else:
                    energy += s * s
                depth_jacobian(gu, gv, x, y, rho, J, Jz)
                for i in range(6):
                    wj = w * Jz[i]
                    for j in range(i, 6):
                        H[i, j] += wj * Jz[j]
                    b[i] -= wj * r
    for i in range(8):
        for j in range(i):
            H[i, j] = H[j, i]
    return energy, seen, kept
