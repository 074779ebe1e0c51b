"""Pose tracking in one call: the damped Gauss-Newton loop of section 4.2, coarse to fine."""

from __future__ import annotations

from math import sqrt

import numpy as np

from .compiled import kernel
from .linearise import linearise
from .se3 import compose, log_se3, retract
from .solver import dot, solve_spd


@kernel
def robust_scale(rms):
    """1.4826 MAD-like scale of the points' whitened rms, with a median rms of 0.9 counting as 1."""
    seen = np.empty(rms.shape[0])
    count = 0
    for n in range(rms.shape[0]):
        if rms[n] >= 0.0:
            seen[count] = rms[n]
            count += 1
    if count == 0:
        return 1.0
    return max(smallest(seen, count, count // 2) / 0.9, 0.5)


@kernel
def smallest(values, count, k):
    """The k-th smallest, from 0, of the first `count` values, which are reordered (Hoare's selection)."""
    low = 0
    high = count - 1
    while low < high:
        pivot = values[(low + high) // 2]
        i = low
        j = high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if k <= j:
            high = j
        elif k >= i:
            low = i
        else:
            break
    return values[k]


@kernel
def align(
    images, depth, cams, points, index_coarse, pixels_coarse, index_fine, T0, affine0, prior, T_prior_inv,
    affine_prior, noise, steps,
):  # fmt: skip
    """Coarse-to-fine damped Gauss-Newton from T0 (T_target_ref, (4, 4)).

    prior: (6, 6) information of T about T_prior (Eq. 19), affine_prior: (2, 2) information of the brightness about
    affine0. steps: (L,) most iterations per level, finest first; the pyramid may have more levels. Returns T, affine,
    H (8, 8) with the brightness prior but without the motion prior, rms of the fine points, scale, iterations, seen,
    kept, the last step's size in standard deviations.
    """
    T = T0.copy()
    affine = affine0.copy()
    affine_centre = affine0
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
    for level in range(steps.shape[0] - 1, -1, -1):
        coarse = level > 0
        index = index_coarse if coarse else index_fine
        pixels = pixels_coarse if coarse else points.patch.shape[2]
        image = images[level]
        cam = cams[level]
        if level == 0 or level == steps.shape[0] - 1:  # other points, or none so far to tell the scale
            rms = np.empty(index.shape[0])
            linearise(image, depth, cam, level, points, index, pixels, T, affine, 1.0, 1e9, noise, H, b, rms)
        rounds = 1 if coarse else 2  # the second one works with the outlier limit from the first
        for turn in range(rounds):
            settled = 1.0 if coarse else (0.5 if turn == 0 else 0.1)  # standard deviations
            scale = robust_scale(rms)
            limit = noise.outlier
            energy, seen, kept = linearise(
                image, depth, cam, level, points, index, pixels, T, affine, scale, limit, noise, H, b, rms
            )
            energy += prior_terms(H, b, T, affine, affine_centre, prior, T_prior_inv, affine_prior)
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
                change = sqrt(max(0.0, dot(step, b)))
                T_new = retract(step[:6], T)
                affine_new = affine + step[6:]
                energy_new, seen_new, kept_new = linearise(
                    image, depth, cam, level, points, index, pixels, T_new, affine_new, scale, limit, noise,
                    H_new, b_new, rms
                )  # fmt: skip
                energy_new += prior_terms(
                    H_new, b_new, T_new, affine_new, affine_centre, prior, T_prior_inv, affine_prior
                )
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
                if change < settled:
                    break
            total += iterations
        if level == 1:
            # many coarse points know the brightness better than a few fine ones: it becomes their prior
            affine_prior = brightness_information(H, affine_prior)
            affine_centre = affine.copy()
    # the information and the residuals at the accepted pose
    energy, seen, kept = linearise(
        images[level], depth, cams[level], level, points, index_fine, points.patch.shape[2], T, affine, scale,
        noise.outlier, noise, H, b, rms
    )  # fmt: skip
    for k in range(2):
        for j in range(2):
            H[6 + k, 6 + j] += affine_prior[k, j]
    return T, affine, H, rms, scale, total, seen, kept, change


@kernel
def prior_terms(H, b, T, affine, affine_centre, prior, T_prior_inv, affine_prior):
    """Add the motion prior (Eq. 19) and the brightness prior to H and b; returns their energy."""
    from_prior = log_se3(compose(T, T_prior_inv))
    energy = 0.0
    for i in range(6):
        pull = dot(prior[i], from_prior)
        energy += pull * from_prior[i]
        b[i] -= pull
        for j in range(6):
            H[i, j] += prior[i, j]
    off0 = affine[0] - affine_centre[0]
    off1 = affine[1] - affine_centre[1]
    for k in range(2):
        b[6 + k] -= affine_prior[k, 0] * off0 + affine_prior[k, 1] * off1
        for j in range(2):
            H[6 + k, 6 + j] += affine_prior[k, j]
    energy += (
        affine_prior[0, 0] * off0 * off0 + 2.0 * affine_prior[0, 1] * off0 * off1 + affine_prior[1, 1] * off1 * off1
    )
    return energy


@kernel
def brightness_information(H, least):
    """(2, 2) information of the brightness with the pose marginalised; `least` where that fails."""
    out = H[6:, 6:].copy()
    for k in range(2):
        ok, x = solve_spd(H[:6, :6].copy(), H[:6, 6 + k].copy())
        if not ok:
            return least
        for j in range(2):
            for i in range(6):
                out[j, k] -= H[6 + j, i] * x[i]
    out[0, 1] = out[1, 0] = 0.5 * (out[0, 1] + out[1, 0])
    if not (out[0, 0] > 0.0 and out[0, 0] * out[1, 1] > out[0, 1] * out[0, 1]):
        return least
    return out
