"""The window's normal equations from those of its pairs, brought to the present state, and their Schur complement."""

from __future__ import annotations

import numpy as np

from ..measurement import STEP
from .compiled import exact_kernel, kernel
from .se3 import inverse, log_se3
from .solver import dot, multiply


@exact_kernel
def distances(pairs, state):
    """How far each pair (K, K) is from where it was taken: squared standard deviations, the mean over its unknowns.

    Infinite for a pair that is not taken, 0 on the diagonal.
    """
    K, N = state.inv_depth.shape
    away, b, bd = np.empty(STEP), np.empty(STEP), np.empty(N)
    out = np.zeros((K, K))
    for host in range(K):
        for target in range(K):
            if pairs.taken[host, target]:
                increment(pairs, state, host, target, away)
                _, squared = shifted(pairs, state.inv_depth, host, target, away, b, bd)
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
    away, b, bd = np.empty(STEP), np.empty(STEP), np.empty(N)
    energy = 0.0
    for host in range(K):
        if which[host, host]:
            energy += own_sensor(points, state.inv_depth, host, system)
        for target in range(K):
            if which[host, target] and pairs.taken[host, target]:
                increment(pairs, state, host, target, away)
                change, _ = shifted(pairs, state.inv_depth, host, target, away, b, bd)
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
    away[:6] = log_se3(multiply(T, inverse(pairs.at_T[host, target])))
    before, now = pairs.at_affine[host, target], state.affine
    away[6] = (now[target, 0] - now[host, 0]) - (before[1, 0] - before[0, 0])
    away[7] = (now[target, 1] - before[1, 1]) + pairs.chain[host, target, 7, 7] * (now[host, 1] - before[0, 1])


@exact_kernel
def shifted(pairs, inv_depth, host, target, away, b, bd):
    """Fill the right sides b (8,) and bd (N,) of a pair after an increment; by what the energy changes, and the
    increment in squared standard deviations."""
    H, cross, Hd = pairs.H[host, target], pairs.cross[host, target], pairs.Hd[host, target]
    at_b, at_bd, at_depth = pairs.b[host, target], pairs.bd[host, target], pairs.at_inv_depth[host, target]
    along, squared = 0.0, 0.0
    for i in range(STEP):
        H_away = dot(H[i], away)
        b[i] = at_b[i] - H_away
        along += away[i] * at_b[i]
        squared += away[i] * H_away
    for p in range(bd.shape[0]):
        depth = inv_depth[host, p] - at_depth[p]
        row = cross[p]
        with_pose = 0.0
        for i in range(STEP):
            with_pose += row[i] * away[i]
            b[i] -= row[i] * depth
        bd[p] = at_bd[p] - Hd[p] * depth - with_pose
        along += depth * at_bd[p]
        squared += depth * (Hd[p] * depth + 2.0 * with_pose)
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
    ho, ta = STEP * host, STEP * target
    for p in range(bd.shape[0]):
        if Hd[p] == 0.0:
            continue
        system.Hd[host, p] += Hd[p]
        system.bd[host, p] += bd[p]
        row, cross = rows[p], system.cross[host, p]
        r0, r1, r2, r3, r4, r5 = row[0], row[1], row[2], row[3], row[4], row[5]
        for j in range(3):  # a chain is an adjoint, whose lower left is zero, and two numbers for brightness
            cross[ho + j] += chain[0, j] * r0 + chain[1, j] * r1 + chain[2, j] * r2
        for j in range(3, 6):
            of_v = chain[0, j] * r0 + chain[1, j] * r1 + chain[2, j] * r2
            cross[ho + j] += of_v + chain[3, j] * r3 + chain[4, j] * r4 + chain[5, j] * r5
        cross[ho + 6] += chain[6, 6] * row[6]
        cross[ho + 7] += chain[7, 7] * row[7]
        for i in range(STEP):
            cross[ta + i] += row[i]


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
        for p in range(N):
            weights[p] = 1.0 / system.Hd[k, p] if system.Hd[k, p] > 0.0 else 0.0
        columns = system.cross[k].T.copy()  # (8K, N)
        for one in range(K):
            seen[one] = columns[STEP * one].any()
            if seen[one]:
                for i in range(STEP * one, STEP * (one + 1)):
                    weighted[i] = weights * columns[i]
                    rhs[i] -= dot(weighted[i], system.bd[k])
        for one in range(K):
            for two in range(one, K):
                if seen[one] and seen[two]:
                    for i in range(STEP * one, STEP * (one + 1)):
                        for j in range(STEP * two, STEP * (two + 1), 4):
                            subtract_products(out[i], j, weighted[i], columns)
    for i in range(out.shape[0]):
        for j in range(i):
            out[i, j] = out[j, i]
    return out, rhs


@kernel
def subtract_products(out, j, row, columns):
    """Subtract a row's products with four columns from out[j : j + 4]."""
    c0, c1, c2, c3 = columns[j], columns[j + 1], columns[j + 2], columns[j + 3]
    s0 = s1 = s2 = s3 = 0.0
    for p in range(row.shape[0]):
        x = row[p]
        s0 += x * c0[p]
        s1 += x * c1[p]
        s2 += x * c2[p]
        s3 += x * c3[p]
    out[j] -= s0
    out[j + 1] -= s1
    out[j + 2] -= s2
    out[j + 3] -= s3
