"""One round of the search on one level, from one pair's start to where it settles: twin of definitions/tracking.py."""

from __future__ import annotations

import triton
import triton.language as tl

from .linearise import linearise
from .se3 import log_between, retract
from .solver import entry, solve, vector_of

MOST_DAMPING = tl.constexpr(1e4)


# compiled once for all sizes
@triton.jit(do_not_specialize=["images", "points", "turn"])
def search(
    images, points, start_at, prior, turn, answer, DEPTH: tl.constexpr, PAPER: tl.constexpr, BLOCK: tl.constexpr
):  # fmt: skip
    """Program b searches for pair b: at most so many steps; with none, all that it does is to linearise at the start.

    images: of the level (B, h, w), h, w; inverse depth of level 0 (B, H, W), H, W.
    points: rows (B, 6, N), patch (B, N, 8), gradient (B, N, 8, 2), weight (B, N, 8), numbers, see linearise.py; N.
    start_at: T (B, 4, 4), affine (B, 2), scales (B,) of the residuals.
    prior: T (B, 4, 4), information (B, 6, 6), affine (B, 2), its information (B, 2, 2).
    turn: limit of a point's residual, what settles the search, most steps, and not 0 where each of them is taken,
    whatever becomes of the energy.
    answer, which it fills: T, affine, the last step in standard deviations (B,), H (B, 8, 8) with the prior, rms (B, N)
    of the last pose tried, iterations (B,).
    """
    pair = tl.program_id(0)
    T_start, affine_start, scales = start_at
    T_prior, information, affine_prior, affine_information = prior
    limit, settled, steps, every = turn
    T_out, affine_out, change_out, H_out, rms, iterations = answer
    shots = (images[0], images[1], images[2], images[3], images[4], images[5], DEPTH, PAPER)
    level = (points[0], points[1], points[2], points[3], points[4], rms, points[5])
    start, affine = T_start + pair * 16, affine_start + pair * 2
    T, a, c = pose_at(start), tl.load(affine), tl.load(affine + 1)
    T_known, about = pose_at(T_prior + pair * 16), affine_prior + pair * 2
    a_known, c_known = tl.load(about), tl.load(about + 1)
    i, j = tl.arange(0, 8)[:, None], tl.arange(0, 8)[None, :]
    known = tl.load(information + pair * 36 + 6 * i + j, mask=(i < 6) & (j < 6), other=0.0)
    known += tl.load(affine_information + pair * 4 + 2 * (i - 6) + j - 6, mask=(i >= 6) & (j >= 6), other=0.0)
    scale = tl.load(scales + pair)

    T_new, a_new, c_new = pose_at(start), tl.load(affine), tl.load(affine + 1)  # Triton would not carry an alias
    H, b = tl.zeros((8, 8), tl.float64), tl.zeros((8,), tl.float64)
    energy, seen, damping, change = 0.0 * scale, 0 * steps, 0.0 * scale, 0.0 * scale
    little = 0.1 + 0.0 * scale  # a plain 0.1 would be single precision
    taken = 0 * steps
    active = steps >= 0
    while active:  # the first turn is at the start; linearise stands here once, since compiling it takes long
        H_new, b_new, energy_new, seen_new = linearise(pair, shots, level, T_new, a_new, c_new, scale, limit, BLOCK)
        pull, push = pulled(T_new, T_known, a_new - a_known, c_new - c_known, known)
        energy_new += push
        # a point that leaves the image must not look like a gain
        lost = tl.maximum(seen - seen_new, 0) * 8
        better = (taken == 0) | (every > 0) | ((energy_new + lost <= energy) & (tl.abs(energy_new) < float("inf")))
        if better:
            T, a, c = T_new, a_new, c_new
            H, b, energy, seen = H_new + known, b_new - pull, energy_new, seen_new
            damping = tl.where(damping < 4e-4, 0.0, 0.25 * damping)
        else:
            damping = tl.maximum(4.0 * damping, little)
        active = (better | (damping <= MOST_DAMPING)) & ((taken == 0) | (change >= settled)) & (taken < steps)
        if active:
            taken += 1
            y, active = solve(H, b, damping)
            change = tl.where(active, tl.sqrt(tl.maximum(tl.sum(y * b), 0.0)), change)
            T_new = retract(entry(y, 0), entry(y, 1), entry(y, 2), entry(y, 3), entry(y, 4), entry(y, 5), T)
            a_new, c_new = a + entry(y, 6), c + entry(y, 7)
    out = T_out + pair * 16
    for k in tl.static_range(12):
        tl.store(out + k, T[k])
    for k in tl.static_range(4):
        tl.store(out + 12 + k, tl.load(start + 12 + k))
    tl.store(affine_out + pair * 2, a)
    tl.store(affine_out + pair * 2 + 1, c)
    tl.store(change_out + pair, change)
    tl.store(H_out + pair * 64 + 8 * i + j, H)
    tl.store(iterations + pair, taken)


@triton.jit
def pose_at(numbers):
    """Twelve numbers from an address on."""
    return (
        tl.load(numbers), tl.load(numbers + 1), tl.load(numbers + 2), tl.load(numbers + 3), tl.load(numbers + 4),
        tl.load(numbers + 5), tl.load(numbers + 6), tl.load(numbers + 7), tl.load(numbers + 8), tl.load(numbers + 9),
        tl.load(numbers + 10), tl.load(numbers + 11),
    )  # fmt: skip


@triton.jit
def pulled(T, T_known, a_off, c_off, information):
    """What is known beforehand, at a pose: information times the way off it (8,), and its energy."""
    v0, v1, v2, x, y, z = log_between(T, T_known)
    off = vector_of(v0, v1, v2, x, y, z, a_off, c_off)
    pull = tl.sum(information * off[None, :], axis=1)
    return pull, tl.sum(pull * off)
