"""Fused marginalisation (Eqs. 22, 23) and redundancy (Eq. 26): twins of marginalization.py for the window's sizes."""

from __future__ import annotations

from math import log, sqrt

import numpy as np

from .compiled import kernel
from .solver import factor

SINGULAR = 1e-6  # pivot of a matrix with unit diagonal under which it counts as singular


@kernel
def unit_diagonal(H, index):
    """The block H[index][:, index] scaled to a diagonal of ones, and the factors (n,); 0 where nothing is known."""
    n = index.shape[0]
    scale = np.zeros(n)
    for i in range(n):
        if H[index[i], index[i]] > 1e-12:
            scale[i] = 1.0 / sqrt(H[index[i], index[i]])
    out = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            out[i, j] = scale[i] * H[index[i], index[j]] * scale[j]
    return out, scale


@kernel
def marginalize(H, b, keep, gone):
    """Twin of marginalization.marginalize: (ok, H*, b*) of the variables keep (m,) once those of gone (k,) are out.

    Not ok where either block is singular: the definition knows what to do then.
    """
    m, k = keep.shape[0], gone.shape[0]
    block, scale = unit_diagonal(H, gone)
    ok, L = factor(block, SINGULAR)
    out = np.empty((m, m))
    rhs = np.empty(m)
    if not ok:
        return False, out, rhs
    W = np.empty((k, m + 1))  # L^-1 [H_ba | b_b], scaled
    for i in range(k):
        for j in range(m + 1):
            W[i, j] = scale[i] * (H[gone[i], keep[j]] if j < m else b[gone[i]])
        for p in range(i):
            for j in range(m + 1):
                W[i, j] -= L[i, p] * W[p, j]
        for j in range(m + 1):
            W[i, j] /= L[i, i]
    for i in range(m):
        rhs[i] = b[keep[i]]
        for j in range(m):
            out[i, j] = 0.5 * (H[keep[i], keep[j]] + H[keep[j], keep[i]])
    for p in range(k):
        for i in range(m):
            rhs[i] -= W[p, i] * W[p, m]
            for j in range(m):
                out[i, j] -= W[p, i] * W[p, j]
    rest, _ = unit_diagonal(out, np.arange(m))
    ok, _ = factor(rest, 0.0)
    return ok, out, rhs


@kernel
def redundancy(information):
    """Twin of marginalization.redundancy_bits: (ok, psi (K,)) in bits from the (6K, 6K) information of the poses."""
    K = information.shape[0] // 6
    psi = np.zeros(K)
    unit, _ = unit_diagonal(information, np.arange(6 * K))
    alone = np.empty(K)
    pair = np.empty((12, 12))
    for i in range(K):
        ok, L = factor(unit[6 * i : 6 * i + 6, 6 * i : 6 * i + 6], 0.0)
        if not ok:
            return False, psi
        alone[i] = 0.0
        for d in range(6):
            alone[i] += log(L[d, d])
    for i in range(K):
        for j in range(i + 1, K):
            for r in range(6):
                for c in range(6):
                    pair[r, c] = unit[6 * i + r, 6 * i + c]
                    pair[r, 6 + c] = unit[6 * i + r, 6 * j + c]
                    pair[6 + r, c] = unit[6 * j + r, 6 * i + c]
                    pair[6 + r, 6 + c] = unit[6 * j + r, 6 * j + c]
            ok, L = factor(pair, 0.0)
            if not ok:
                return False, psi
            mutual = alone[i] + alone[j]
            for d in range(12):
                mutual -= log(L[d, d])
            psi[i] += mutual / log(2.0)
            psi[j] += mutual / log(2.0)
    return True, psi
