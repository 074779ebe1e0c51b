"""The window's normal equations from those of its pairs, brought to the present state, and their Schur complement."""

from __future__ import annotations

import numpy as np

from ..measurement import STEP
from .compiled import exact_kernel, kernel
from .se3 import inverse, log_se3
from .solver import dot, multiply, put


@exact_kernel
def distances(pairs, state):
    """How far each pair (K, K) is from where it was taken: squared standard deviations, the mean over its unknowns.

    Infinite for a pair that is not taken, 0 on the diagonal.
    """
    K, N = state.inv_depth.shape
    away, b, bd, room = np.empty(STEP), np.empty(STEP), np.empty(N), np.empty((3, N))
    out = np.zeros((K, K))
    for host in range(K):
        for target in range(K):
            if pairs.taken[host, target]:
                increment(pairs, state, host, target, away)
                _, squared = shifted(pairs, state.inv_depth, (host, target), away, b, bd, room)
                out[host, target] = squared / (STEP + N)
            elif host != target:
                out[host, target] = np.inf
    return out


@exact_kernel
def assemble(pairs, state, points, which, system):
    """Fill a WindowSystem with what pairs say at a state; returns the energy there.

    which (K, K) bool: the pairs that take part if they are taken, on the diagonal hosts' own sensor's measurements.
    """
    K, N = state.inv_depth.shape
    system.H[:] = 0.0
    system.b[:] = 0.0
    system.Hd[:] = 0.0
    system.bd[:] = 0.0
    system.cross[:] = 0.0
    away, b, bd, room = np.empty(STEP), np.empty(STEP), np.empty(N), np.empty((3, N))
    energy = 0.0
    for host in range(K):
        if which[host, host]:
            energy += own_sensor(points, state.inv_depth, host, system)
        for target in range(K):
            if which[host, target] and pairs.taken[host, target]:
                increment(pairs, state, host, target, away)
                change, _ = shifted(pairs, state.inv_depth, (host, target), away, b, bd, room)
                energy += pairs.energy[host, target] + change
                add_pair(pairs, host, target, b, system)
                add_points(pairs, host, target, bd, system)
    return energy


@exact_kernel
def own_sensor(points, inv_depth, host, system):
    """The measurement of every point's own sensor, into the system; its energy."""
    energy = 0.0
    for n in range(inv_depth.shape[1]):
        if points.valid[host, n]:
            r = inv_depth[host, n] - points.measured[host, n]
            w = 1.0 / points.variance[host, n]
            energy += w * r * r
            system.Hd[host, n] += w
            system.bd[host, n] -= w * r
    return energy


@exact_kernel
def increment(pairs, state, host, target, away):
    """Fill away (8,): the increment of a pair's relative state since it was taken."""
    T = multiply(state.T[target], inverse(state.T[host]))
    put(log_se3(multiply(T, inverse(pairs.at_T[host, target]))), away[:6])
    before, now = pairs.at_affine[host, target], state.affine
    away[6] = (now[target, 0] - now[host, 0]) - (before[1, 0] - before[0, 0])
    away[7] = (now[target, 1] - before[1, 1]) + pairs.chain[host, target, 7, 7] * (now[host, 1] - before[0, 1])


@exact_kernel
def shifted(pairs, inv_depth, pair, away, b, bd, room):
    """Fill the right sides b (8,) and bd (N,) of a pair after an increment; by what the energy changes, and the
    increment in squared standard deviations. room (3, N) is overwritten."""
    host, target = pair
    H, cross, Hd = pairs.H[host, target], pairs.cross[host, target], pairs.Hd[host, target]
    at_b, at_bd, at_depth = pairs.b[host, target], pairs.bd[host, target], pairs.at_inv_depth[host, target]
    depth, with_pose, pull, here = room[0], room[1], room[2], inv_depth[host]
    for p in range(bd.shape[0]):
        depth[p] = here[p] - at_depth[p]
        with_pose[p] = 0.0
    along, squared = 0.0, 0.0
    for i in range(STEP):
        H_away = dot(H[i], away)
        along += away[i] * at_b[i]
        squared += away[i] * H_away
        row, by = cross[i], away[i]
        b[i] = at_b[i] - H_away - dot(row, depth)
        for p in range(bd.shape[0]):
            with_pose[p] += row[p] * by
    for p in range(bd.shape[0]):
        bd[p] = at_bd[p] - Hd[p] * depth[p] - with_pose[p]
    for p in range(bd.shape[0]):
        pull[p] = Hd[p] * depth[p] + 2.0 * with_pose[p]
    along += dot(depth, at_bd)
    squared += dot(depth, pull)
    return squared - 2.0 * along, squared


@exact_kernel
def add_pair(pairs, host, target, pair_b, system):
    """The equations of a relative state as ones of two keyframes."""
    pair, chain = pairs.H[host, target], pairs.chain[host, target]
    across = multiply(pair, chain)
    on_host = multiply(chain.T, across)
    H, b = system.H, system.b
    ho, ta = STEP * host, STEP * target
    for i in range(STEP):
        for j in range(STEP):
            H[ta + i, ta + j] += pair[i, j]
            H[ta + i, ho + j] += across[i, j]
            H[ho + i, ta + j] += across[j, i]
            H[ho + i, ho + j] += on_host[i, j]
        b[ta + i] += pair_b[i]
        b[ho + i] += dot(chain[:, i], pair_b)


@exact_kernel
def add_points(pairs, host, target, bd, system):
    """What a host's inverse depths get from a target, and what ties them to both."""
    chain, rows, Hd = pairs.chain[host, target], pairs.cross[host, target], pairs.Hd[host, target]
    cross, own_Hd, own_bd = system.cross[host], system.Hd[host], system.bd[host]
    ho, ta = STEP * host, STEP * target
    for p in range(bd.shape[0]):
        own_Hd[p] += Hd[p]
        own_bd[p] += bd[p]
    for j in range(3):  # a chain is an adjoint, whose lower left is zero, and two numbers for brightness
        a, b, c = chain[0, j], chain[1, j], chain[2, j]
        for p in range(bd.shape[0]):
            cross[ho + j, p] += a * rows[0, p] + b * rows[1, p] + c * rows[2, p]
    for j in range(3, 6):
        a, b, c, d, e, f = chain[0, j], chain[1, j], chain[2, j], chain[3, j], chain[4, j], chain[5, j]
        for p in range(bd.shape[0]):
            of_v = a * rows[0, p] + b * rows[1, p] + c * rows[2, p]
            cross[ho + j, p] += of_v + d * rows[3, p] + e * rows[4, p] + f * rows[5, p]
    for j in range(6, STEP):
        a = chain[j, j]
        for p in range(bd.shape[0]):
            cross[ho + j, p] += a * rows[j, p]
    for j in range(STEP):
        for p in range(bd.shape[0]):
            cross[ta + j, p] += rows[j, p]


@exact_kernel
def eliminate_depths(system):
    """Schur complement of the inverse depths, whose block is diagonal: (8K, 8K) and (8K,) of poses and brightness."""
    out = system.H.copy()
    rhs = system.b.copy()
    K, N = system.Hd.shape
    seen = np.zeros(K, np.bool_)
    weights = np.zeros(N)
    weighted = np.zeros((STEP * K, N))
    for k in range(K):
        rows, known = system.cross[k], system.Hd[k]
        if not known.any():
            continue
        for p in range(N):
            weights[p] = 1.0 / known[p] if known[p] > 0.0 else 0.0
        for one in range(K):
            seen[one] = not nothing(rows[STEP * one : STEP * (one + 1)])
            if seen[one]:
                for i in range(STEP * one, STEP * (one + 1)):
                    for p in range(N):
                        weighted[i, p] = weights[p] * rows[i, p]
                    rhs[i] -= dot(weighted[i], system.bd[k])
        for one in range(K):
            for two in range(one, K):
                if seen[one] and seen[two]:
                    subtract_block(out, STEP * one, STEP * two, weighted, rows)
    for i in range(out.shape[0]):
        for j in range(i):
            out[i, j] = out[j, i]
    return out, rhs


@exact_kernel
def nothing(rows):
    """Whether all is zero."""
    for i in range(rows.shape[0]):
        row = rows[i]
        if dot(row, row) != 0.0:
            return False
    return True


@kernel
def subtract_block(out, first, other, weighted, rows):
    """Subtract the products of STEP weighted rows from the first one on with STEP others, two by four at a time."""
    for i in range(first, first + STEP, 2):
        for j in range(other, other + STEP, 4):
            s0 = s1 = s2 = s3 = t0 = t1 = t2 = t3 = 0.0
            for p in range(rows.shape[1]):
                a, b = weighted[i, p], weighted[i + 1, p]
                s0 += a * rows[j, p]
                s1 += a * rows[j + 1, p]
                s2 += a * rows[j + 2, p]
                s3 += a * rows[j + 3, p]
                t0 += b * rows[j, p]
                t1 += b * rows[j + 1, p]
                t2 += b * rows[j + 2, p]
                t3 += b * rows[j + 3, p]
            out[i, j] -= s0
            out[i, j + 1] -= s1
            out[i, j + 2] -= s2
            out[i, j + 3] -= s3
            out[i + 1, j] -= t0
            out[i + 1, j + 1] -= t1
            out[i + 1, j + 2] -= t2
            out[i + 1, j + 3] -= t3
