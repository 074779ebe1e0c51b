"""Some pairs of a batch, one after the other: what a thread does of the twins of linearise.py, pairs.py and points.py.

Arrays of the batch have the pairs first. An inverse depth that is not positive is no point.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..measurement import FLOOR, Array, MotionPrior, Points, State, Subset, System, View
from .compiled import exact_kernel, kernel
from .linearise import linearise
from .se3 import inverse, retract
from .solver import dot, solve_spd
from .tracking import align, prior_terms

STILL = 1e-20  # squared standard deviations; a smaller step is rounding
PATIENCE = 60  # steps towards where nothing moves; Gauss-Newton halves the rest or better
BORDER = 4  # px, room for the patch and its gradients


class Starts(NamedTuple):
    """Where the search of B pairs starts, and what is known of them beforehand."""

    T: Array  # (B, 4, 4)
    information: Array  # (B, 6, 6)
    affine: Array  # (B, 2)
    affine_information: Array  # (B, 2, 2)


class Search(NamedTuple):
    """What became of B pairs; filled in place."""

    T: Array  # (B, 4, 4) at the end
    affine: Array  # (B, 2)
    H: Array  # (B, 8, 8) there, without priors
    rms: Array  # (B, N)
    iterations: Array  # (B,) int64
    T_found: Array  # (B, 4, 4) where the search settled, before the steps that autograd sees
    affine_found: Array  # (B, 2)
    scale: Array  # (B,)
    centre: Array  # (B, 2) the brightness prior of the finest level
    spread: Array  # (B, 2, 2) and its information

    @staticmethod
    def empty(B: int, N: int) -> Search:
        """Room for B pairs of N points."""
        return Search(
            np.empty((B, 4, 4)), np.empty((B, 2)), np.empty((B, 8, 8)), np.empty((B, N)), np.empty(B, np.int64),
            np.empty((B, 4, 4)), np.empty((B, 2)), np.empty(B), np.empty((B, 2)), np.empty((B, 2, 2)),
        )  # fmt: skip


class Systems(NamedTuple):
    """Normal equations of B pairs; filled in place."""

    H: Array  # (B, 8, 8)
    b: Array  # (B, 8)
    energy: Array  # (B,)
    rms: Array  # (B, N)

    @staticmethod
    def empty(B: int, N: int) -> Systems:
        """Room for B pairs of N points."""
        return Systems(np.empty((B, 8, 8)), np.empty((B, 8)), np.empty(B), np.empty((B, N)))


class Targets(NamedTuple):
    """What some targets show: six levels, as the tracker's frames have, or copies of the last."""

    images: tuple[Array, ...]  # a level: (n, H >> l, W >> l) float32
    depth: Array  # (n, H, W) float32
    cameras: Array  # (L, 4)


class At(NamedTuple):
    """Where B pairs are linearised."""

    T: Array  # (B, 4, 4)
    affine: Array  # (B, 2)
    scale: Array  # (B,) robust scales of the whitened residuals
    limit: float  # in units of them


class After(NamedTuple):
    """What follows a search: so many Gauss-Newton steps, or as many as it takes until nothing moves."""

    more: int
    still: bool


@kernel
def view_of(targets, b):
    """What one of them shows."""
    images = targets.images
    levels = (images[0][b], images[1][b], images[2][b], images[3][b], images[4][b], images[5][b])
    return View(levels, targets.depth[b], targets.cameras)


@kernel
def points_of(points, weight, b):
    """The points of pair b, and which of them are any, with their weights if there are such."""
    one = Points(
        points.uv[b], points.inv_depth[b], points.var_inv_depth[b], points.patch[b], points.gradient[b], points.slope[b]
    )
    which = np.empty(one.inv_depth.shape[0], dtype=np.int64)
    count = 0
    for n in range(which.shape[0]):
        if one.inv_depth[n] > 0.0 and np.isfinite(one.inv_depth[n]):
            which[count] = n
            count += 1
    return one, Subset(which[:count], one.patch.shape[2], weight_of(weight, b))


@kernel
def weight_of(weight, b):
    """The weights of pair b, if there are any."""
    if weight is None:
        return None
    return weight[b]


@kernel
def align_pairs(targets, points, weight, prior, noise, steps, after, first, out):
    """Pairs first, first + 1 and so on, as many as there are Targets. Fills out, the arrays of a Search.

    prior: T (B, 4, 4), information (B, 6, 6), affine (B, 2), affine_information (B, 2, 2). after: After.
    """
    for k in range(targets.depth.shape[0]):
        b = first + k
        view = view_of(targets, k)
        one, subset = points_of(points, weight, b)
        known = MotionPrior(inverse(prior.T[b]), prior.information[b], prior.affine_information[b])
        start = State(prior.T[b], prior.affine[b])
        found = align(view, one, subset, subset, start, known, noise, steps)
        out.T_found[b] = found.T
        out.affine_found[b] = found.affine
        out.scale[b] = found.scale
        out.iterations[b] = found.iterations
        out.centre[b] = found.affine_centre
        out.spread[b] = found.affine_information
        state = State(found.T, found.affine)
        system = System(found.H, np.empty(8), np.empty(subset.which.shape[0]))
        state = stepped(view, one, subset, state, known, found, noise, after, system)
        out.T[b] = state.T
        out.affine[b] = state.affine
        linearise(view, 0, one, subset, state, found.scale, noise.outlier, noise, system)
        out.H[b] = system.H
        out.rms[b] = -1.0
        for n in range(subset.which.shape[0]):
            out.rms[b, subset.which[n]] = system.rms[n]


@kernel
def stepped(view, points, subset, state, prior, found, noise, after, system):
    """Gauss-Newton steps on the finest level from where the search ended; of many only such as near a root."""
    size = np.inf
    best = state
    still = after.still
    for _ in range(PATIENCE if still else after.more):
        linearise(view, 0, points, subset, state, found.scale, noise.outlier, noise, system)
        prior_terms(system, state, found.affine_centre, prior, found.affine_information)
        for i in range(8):
            system.H[i, i] += FLOOR
        solved, step = solve_spd(system.H, system.b)
        if not solved:
            break
        if still:
            size_new = dot(step, system.b)
            if not size_new < size:
                return best
            size = size_new
            best = state
            if size < STILL:
                return best
        state = State(retract(step[:6], state.T), state.affine + step[6:])
    return best if still else state


@kernel
def linearise_pairs(targets, level, points, weight, at, noise, first, out):
    """Pairs first, first + 1 and so on, as many as there are Targets. Fills out, the arrays of a Systems.

    at: At.
    """
    for k in range(targets.depth.shape[0]):
        b = first + k
        view = view_of(targets, k)
        one, subset = points_of(points, weight, b)
        system = System(out.H[b], out.b[b], np.empty(subset.which.shape[0]))
        energy, _seen, _kept = linearise(
            view, level, one, subset, State(at.T[b], at.affine[b]), at.scale[b], at.limit, noise, system
        )
        out.energy[b] = energy
        out.rms[b] = -1.0
        for n in range(subset.which.shape[0]):
            out.rms[b, subset.which[n]] = system.rms[n]


@exact_kernel
def strongest_of_cells(gray, depth, cell, spread, uv, inv_depth):
    """Fill uv (N, 2) and inv_depth (N,): the strongest gradient of each square cell amid one surface, else 0.

    spread: largest over smallest depth around such a pixel.
    """
    height, width = gray.shape
    half = np.float32(0.5)
    n = 0
    for v0 in range(BORDER, height - BORDER, cell):
        for u0 in range(BORDER, width - BORDER, cell):
            best = np.float32(0.0)
            best_u, best_v = u0, v0
            for v in range(v0, min(v0 + cell, height - BORDER)):
                for u in range(u0, min(u0 + cell, width - BORDER)):
                    gu = half * (gray[v, u + 1] - gray[v, u - 1])
                    gv = half * (gray[v + 1, u] - gray[v - 1, u])
                    score = gu * gu + gv * gv
                    if score > best and one_surface(depth, u, v, spread):
                        best = score
                        best_u, best_v = u, v
            uv[n, 0] = best_u
            uv[n, 1] = best_v
            inv_depth[n] = 1.0 / np.float64(depth[best_v, best_u]) if best > 0.0 else 0.0
            n += 1


@exact_kernel
def one_surface(depth, u, v, spread):
    """Whether all 5x5 depths around a pixel are there and differ little."""
    low = depth[v, u]
    high = low
    for j in range(v - 2, v + 3):
        for i in range(u - 2, u + 3):
            z = depth[j, i]
            if not z > 0.0:
                return False
            low = min(low, z)
            high = max(high, z)
    return high <= np.float32(spread) * low
