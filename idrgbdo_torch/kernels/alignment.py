"""Pose tracking in one call: the fused twin of photometric.py plus the Gauss-Newton loop of section 4.2."""

from __future__ import annotations

from math import exp, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from .lie import log_se3, retract
from .linear import solve_spd
from .sampling import sample, sample_inverse_depth

PATTERN_U = np.array([0.0, 0.0, -1.0, 1.0, -2.0, 2.0, -1.0, 0.0])
PATTERN_V = np.array([0.0, -2.0, -1.0, -1.0, 0.0, 0.0, 1.0, 2.0])


class Noise(NamedTuple):
    """What the kernels need of NoiseConfig, as plain numbers."""

    var_intensity: float  # gray levels^2
    var_pixel: float  # px^2, times the number of patch pixels that share it
    var_depth: float  # (1/m)^2, one sensor reading
    shared: float  # number of patch pixels that share one depth error
    c_h: float
    huber: float  # whitened
    outlier: float  # limit of a point's whitened residual, in robust standard deviations
    use_depth: bool
    paper_variance: bool
    blend: float  # share of the reference gradient in the Jacobian


class Points(NamedTuple):
    """Struct of arrays of reference points."""

    uv: np.ndarray  # (N, 2) float64 px, level 0
    inv_depth: np.ndarray  # (N,) float64 1/m
    var_inv_depth: np.ndarray  # (N,) float64 (1/m)^2
    patch: np.ndarray  # (L, N, P) float32 gray levels
    gradient: np.ndarray  # (L, N, P, 2) float32 gray levels/px of the reference


@njit(cache=True, nogil=True, inline="always")
def photometric_variance(gu, gv, du_dd, dv_dd, var_d, noise):
    """Twin of photometric.photometric_variance (Eq. 8)."""
    if noise.paper_variance:
        along = (gu * du_dd) ** 2 + (gv * dv_dd) ** 2
    else:
        along = (gu * du_dd + gv * dv_dd) ** 2
    return noise.var_intensity + noise.var_pixel * (gu * gu + gv * gv) + noise.shared * along * var_d


@njit(cache=True, nogil=True, inline="always")
def distortion_weight(area, c_h):
    """Twin of photometric.distortion_weight (Eq. 7)."""
    return exp(min(c_h * (area - 1.0) ** 2, 4.0))


@njit(cache=True, nogil=True)
def linearise(image, depth, cam, level, points, index, pixels, T, affine, scale, limit, noise, H, b, rms):
    """Normal equations of one level at one pose.

    cam: (4,) fx fy cx cy of this level. index: points to use. pixels: patch pixels to use (1 or 8).
    scale: robust scale of the whitened residuals; limit: saturation of a point's rms in units of scale.
    Fills H (8, 8), b (8,) = -J^T W r for [v, w, a, b] and rms (len(index),), -1 where a point is not seen.
    Returns (energy, points seen, points within the limit).
    """
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
    inv_scale2 = 1.0 / (scale * scale)
    for n in range(index.shape[0]):
        p = index[n]
        rms[n] = -1.0
        d = points.inv_depth[p]
        u0 = (points.uv[p, 0] + 0.5) * size - 0.5
        v0 = (points.uv[p, 1] + 0.5) * size - 0.5
        mx = (u0 - cx) / fx
        my = (v0 - cy) / fy
        # q = R m + t d is the transformed point times the inverse depth
        qx = T[0, 0] * mx + T[0, 1] * my + T[0, 2] + T[0, 3] * d
        qy = T[1, 0] * mx + T[1, 1] * my + T[1, 2] + T[1, 3] * d
        qz = T[2, 0] * mx + T[2, 1] * my + T[2, 2] + T[2, 3] * d
        if qz < 1e-3:
            continue
        iz = 1.0 / qz
        x = qx * iz
        y = qy * iz
        rho = d * iz  # inverse depth in the target
        # dp_i/dp_j at fixed inverse depth
        a00 = (T[0, 0] - x * T[2, 0]) * iz
        a01 = (T[0, 1] - x * T[2, 1]) * iz * fx / fy
        a10 = (T[1, 0] - y * T[2, 0]) * iz * fy / fx
        a11 = (T[1, 1] - y * T[2, 1]) * iz
        area = a00 * a11 - a01 * a10
        if area <= 0.0:
            continue
        h = distortion_weight(area, noise.c_h)
        du_dd = fx * (T[0, 3] - x * T[2, 3]) * iz
        dv_dd = fy * (T[1, 3] - y * T[2, 3]) * iz
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
            kx = qx + T[0, 0] * ou + T[0, 1] * ov
            ky = qy + T[1, 0] * ou + T[1, 1] * ov
            kz = qz + T[2, 0] * ou + T[2, 1] * ov
            if kz < 1e-3:
                inside = False
                break
            ok, value, gu, gv = sample(image, fx * kx / kz + cx, fy * ky / kz + cy)
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
            gu = (1.0 - noise.blend) * gu + noise.blend * su
            gv = (1.0 - noise.blend) * gv + noise.blend * sv
            w = inv_scale2 / variance
            s2 = r * r * w
            s = sqrt(s2)
            sum2 += s2
            if s > huber:
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
        J[0, 0] = fx * rho
        J[0, 1] = 0.0
        J[0, 2] = -fx * rho * x
        J[0, 3] = -fx * x * y
        J[0, 4] = fx * (1.0 + x * x)
        J[0, 5] = -fx * y
        J[1, 0] = 0.0
        J[1, 1] = fy * rho
        J[1, 2] = -fy * rho * y
        J[1, 3] = -fy * (1.0 + y * y)
        J[1, 4] = fy * x * y
        J[1, 5] = fy * x
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
                    if s > 6.0 * huber:  # another surface: constant cost, no weight
                        energy += 11.0 * huber * huber
                        continue
                    energy += huber * (2.0 * s - huber)
                    w *= huber / s
                else:
                    energy += s * s
                # dr/dxi = g . duv/dxi + rho^2 dP_z/dxi with dP_z/dxi = [0 0 1 | y/rho -x/rho 0]
                for i in range(6):
                    Jz[i] = gu * J[0, i] + gv * J[1, i]
                Jz[2] += rho * rho
                Jz[3] += rho * y
                Jz[4] -= rho * x
                for i in range(6):
                    wj = w * Jz[i]
                    for j in range(i, 6):
                        H[i, j] += wj * Jz[j]
                    b[i] -= wj * r
    for i in range(8):
        for j in range(i):
            H[i, j] = H[j, i]
    return energy, seen, kept


@njit(cache=True, nogil=True)
def robust_scale(rms):
    """1.4826 MAD-like scale of the points' whitened rms, with a median rms of 0.9 counting as 1."""
    seen = rms[rms >= 0.0]
    if seen.size == 0:
        return 1.0
    return max(np.median(seen) / 0.9, 0.5)


@njit(cache=True, nogil=True)
def align(images, depth, cams, points, index_coarse, index_fine, T0, affine0, prior, T_prior_inv, affine_prior, noise, steps):
    """Coarse-to-fine damped Gauss-Newton from T0 (T_target_ref, (4, 4)).

    prior: (6, 6) information of T about T_prior (Eq. 19), affine_prior: (2,) information of the brightness about
    affine0. steps: (L,) most iterations per level. Returns T, affine, H (8, 8) without prior, rms of the fine points,
    scale, iterations, seen, kept, the last step's size in standard deviations.
    """
    T = T0.copy()
    affine = affine0.copy()
    H = np.empty((8, 8))
    b = np.empty(8)
    H_new = np.empty((8, 8))
    b_new = np.empty(8)
    rms = np.empty(index_fine.shape[0])
    scale = 1.0
    total = 0
    seen = 0
    kept = 0
    change = 0.0
    for level in range(cams.shape[0] - 1, -1, -1):
        if level > 0:
            index = index_coarse
            pixels = points.patch.shape[2]
            rms = np.empty(index.shape[0])
        else:
            index = index_fine
            pixels = points.patch.shape[2]
            rms = np.empty(index.shape[0])
        image = images[level]
        cam = cams[level]
        for _ in range(2):  # the second round works with the outlier limit from the first
            linearise(image, depth, cam, level, points, index, pixels, T, affine, 1.0, 1e9, noise, H, b, rms)
            scale = robust_scale(rms)
            limit = noise.outlier
            energy, seen, kept = linearise(
                image, depth, cam, level, points, index, pixels, T, affine, scale, limit, noise, H, b, rms
            )
            energy += prior_terms(H, b, T, affine, affine0, prior, T_prior_inv, affine_prior)
            damping = 0.0
            iterations = 0
            while iterations < steps[level]:
                iterations += 1
                A = H.copy()
                for i in range(8):
                    A[i, i] += damping * A[i, i] + 1e-9
                solved, step = solve_spd(A, b)
                if not solved:
                    break
                change = sqrt(max(0.0, np.dot(step, b)))
                T_new = retract(step[:6], T)
                affine_new = affine + step[6:]
                energy_new, seen_new, kept_new = linearise(
                    image, depth, cam, level, points, index, pixels, T_new, affine_new, scale, limit, noise,
                    H_new, b_new, rms
                )  # fmt: skip
                energy_new += prior_terms(H_new, b_new, T_new, affine_new, affine0, prior, T_prior_inv, affine_prior)
                # a point that leaves the image must not look like a gain
                lost = max(0, seen - seen_new)
                if np.isfinite(energy_new) and energy_new + lost * pixels <= energy:
                    T = T_new
                    affine = affine_new
                    energy = energy_new
                    seen = seen_new
                    kept = kept_new
                    H, H_new = H_new, H
                    b, b_new = b_new, b
                    damping *= 0.25
                    if damping < 1e-4:
                        damping = 0.0
                else:
                    damping = max(4.0 * damping, 0.1)
                    if damping > 1e4:
                        break
                if change < 0.03:
                    break
            total += iterations
            if level > 0:
                break
    # the information and the residuals at the accepted pose
    energy, seen, kept = linearise(
        images[0], depth, cams[0], 0, points, index_fine, points.patch.shape[2], T, affine, scale, noise.outlier, noise,
        H, b, rms
    )  # fmt: skip
    return T, affine, H, rms, scale, total, seen, kept, change


@njit(cache=True, nogil=True)
def prior_terms(H, b, T, affine, affine0, prior, T_prior_inv, affine_prior):
    """Add the motion prior (Eq. 19) and the brightness prior to H and b; returns their energy."""
    from_prior = log_se3(T @ T_prior_inv)
    pull = prior @ from_prior
    energy = np.dot(from_prior, pull)
    for i in range(6):
        b[i] -= pull[i]
        for j in range(6):
            H[i, j] += prior[i, j]
    for k in range(2):
        off = affine[k] - affine0[k]
        H[6 + k, 6 + k] += affine_prior[k]
        b[6 + k] -= affine_prior[k] * off
        energy += affine_prior[k] * off * off
    return energy
