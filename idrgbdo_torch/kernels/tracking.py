"""Pose tracking in one call: the damped Gauss-Newton loop of section 4.2, coarse to fine."""

from __future__ import annotations

from math import sqrt

import numpy as np

from ..measurement import FLOOR, SETTLED, SETTLED_COARSE, Aligned, Heard, State, System
from .compiled import kernel
from .linearise import linearise
from .se3 import compose, inverse, log_se3, retract
from .solver import add, dot, solve_spd


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
def align(view, points, coarse, fine, start, prior, noise, steps):
    """Coarse-to-fine damped Gauss-Newton of a view against a keyframe's points, from a State (Aligned).

    coarse, fine: Subsets for the finest level and for the others. prior: MotionPrior, of the brightness about the
    start's. steps: (L,) most iterations per level, finest first; the pyramid may have more levels. What level 1 says of
    the pose counts on the finest level too, by the share noise.coarse.
    """
    state = State(start.T.copy(), start.affine.copy())
    affine_centre = start.affine
    affine_prior = prior.affine_information
    rms = np.empty(fine.which.shape[0])
    system = System(np.empty((8, 8)), np.empty(8), rms)
    trial = System(np.empty((8, 8)), np.empty(8), rms)
    scale = 1.0
    total = 0
    seen = 0
    kept = 0
    change = 0.0
    heard = Heard(prior.T_inverse, np.zeros((6, 6)), np.zeros(6))  # nothing so far
    for level in range(steps.shape[0] - 1, -1, -1):
        finest = level == 0
        subset = fine if finest else coarse
        if finest or level == steps.shape[0] - 1:  # other points, or none so far to tell the scale
            rms = np.empty(subset.which.shape[0])
            system = System(system.H, system.b, rms)
            trial = System(trial.H, trial.b, rms)
            linearise(view, level, points, subset, state, 1.0, 1e9, noise, system)
        rounds = 2 if finest else 1  # the second one works with the outlier limit from the first
        for turn in range(rounds):
            settled = SETTLED[turn] if finest else SETTLED_COARSE
            scale = robust_scale(rms)
            limit = noise.outlier
            energy, seen, kept = linearise(view, level, points, subset, state, scale, limit, noise, system)
            energy += prior_terms(system, state, affine_centre, prior, affine_prior)
            if finest:
                energy += heard_terms(system, state, heard)
            damping = 0.0
            iterations = 0
            while iterations < steps[level]:
                iterations += 1
                A = system.H.copy()
                for i in range(8):
                    A[i, i] += damping * A[i, i] + FLOOR
                solved, step = solve_spd(A, system.b)
                if not solved:
                    break
                change = sqrt(max(0.0, dot(step, system.b)))
                new = State(retract(step[:6], state.T), state.affine + step[6:])
                energy_new, seen_new, kept_new = linearise(view, level, points, subset, new, scale, limit, noise, trial)
                energy_new += prior_terms(trial, new, affine_centre, prior, affine_prior)
                if finest:
                    energy_new += heard_terms(trial, new, heard)
                # a point that leaves the image must not look like a gain
                lost = max(0, seen - seen_new)
                if np.isfinite(energy_new) and energy_new + lost * subset.pixels <= energy:
                    state = new
                    energy = energy_new
                    seen = seen_new
                    kept = kept_new
                    system, trial = trial, system
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
            if noise.coarse > 0.0:
                heard = heard_of_pose(system, state, prior, noise.coarse)
            # many coarse points know the brightness better than a few fine ones: it becomes their prior
            affine_prior = brightness_information(system.H, affine_prior)
            affine_centre = state.affine.copy()
    # the information and the residuals at the accepted pose
    energy, seen, kept = linearise(view, level, points, fine, state, scale, noise.outlier, noise, system)
    for k in range(2):
        for j in range(2):
            system.H[6 + k, 6 + j] += affine_prior[k, j]
    add(heard.H, system.H[:6, :6])
    return Aligned(
        state.T, state.affine, system.H, system.rms, scale, total, seen, kept, change, affine_centre, affine_prior
    )


@kernel
def prior_terms(system, state, affine_centre, prior, affine_prior):
    """Add the motion prior (Eq. 19) and the brightness prior to the system; returns their energy."""
    H, b = system.H, system.b
    from_prior = log_se3(compose(state.T, prior.T_inverse))
    energy = 0.0
    for i in range(6):
        pull = dot(prior.information[i], from_prior)
        energy += pull * from_prior[i]
        b[i] -= pull
        for j in range(6):
            H[i, j] += prior.information[i, j]
    off0 = state.affine[0] - affine_centre[0]
    off1 = state.affine[1] - affine_centre[1]
    for k in range(2):
        b[6 + k] -= affine_prior[k, 0] * off0 + affine_prior[k, 1] * off1
        for j in range(2):
            H[6 + k, 6 + j] += affine_prior[k, j]
    energy += (
        affine_prior[0, 0] * off0 * off0 + 2.0 * affine_prior[0, 1] * off0 * off1 + affine_prior[1, 1] * off1 * off1
    )
    return energy


@kernel
def heard_of_pose(system, state, prior, share):
    """A share of what the points of a level say of the pose where its search ended, brightness marginalised (Heard).

    system: with the priors, of which the motion's is taken off again.
    """
    H, b = system.H, system.b
    from_prior = log_se3(compose(state.T, prior.T_inverse))
    out = Heard(inverse(state.T), np.zeros((6, 6)), np.zeros(6))
    det = H[6, 6] * H[7, 7] - H[6, 7] * H[7, 6]
    if not det > 0.0:
        return out
    for i in range(6):
        on_gain = (H[i, 6] * H[7, 7] - H[i, 7] * H[7, 6]) / det
        on_offset = (H[i, 7] * H[6, 6] - H[i, 6] * H[6, 7]) / det
        own = b[i] + dot(prior.information[i], from_prior)
        out.b[i] = share * (own - on_gain * b[6] - on_offset * b[7])
        for j in range(6):
            own = H[i, j] - prior.information[i, j]
            out.H[i, j] = share * (own - on_gain * H[6, j] - on_offset * H[7, j])
    return out


@kernel
def heard_terms(system, state, heard):
    """Add what was Heard of the pose to the system; returns its energy, up to a constant."""
    H, b = system.H, system.b
    off = log_se3(compose(state.T, heard.T_inverse))
    energy = 0.0
    for i in range(6):
        pull = dot(heard.H[i], off)
        energy += (pull - 2.0 * heard.b[i]) * off[i]
        b[i] += heard.b[i] - pull
        for j in range(6):
            H[i, j] += heard.H[i, j]
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
