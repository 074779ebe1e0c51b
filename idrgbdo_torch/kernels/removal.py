"""Which keyframe a window can spare: the fused twin of definitions/removal.py."""

from __future__ import annotations

from math import log, sqrt

import numpy as np

from ..measurement import LINK_FLOOR, UNKNOWN
from .compiled import kernel
from .solver import factor, inverse_spd

NOTHING_LEFT = 1e-12  # share of what was known under which nothing is left


@kernel
def next_view_bits(information, links, adjoints):
    """Twin of removal.next_view_bits: (K,) bits, from (6K, 6K), (K, 6, 6) and (K, 6, 6); nan where that fails."""
    K = links.shape[0]
    bits = np.full(K, np.nan)
    ok, covariance = inverse_of_any_scale(information, UNKNOWN)
    if not ok:
        return bits
    placings = np.empty((6 * K, 6 * K))
    for k in range(K):
        for m in range(k + 1):
            place(covariance[6 * k : 6 * k + 6, 6 * m : 6 * m + 6], adjoints[k], adjoints[m], placings, (6 * k, 6 * m))
    link = np.empty((6, 6))
    for k in range(K):
        for i in range(6):
            for j in range(6):
                link[i, j] = links[k, i, j]
            largest = links[0, i, i]
            for m in range(1, K):
                largest = max(largest, links[m, i, i])
            link[i, i] += LINK_FLOOR * largest
        own = inverse_spd(link)
        for i in range(6):
            for j in range(6):
                placings[6 * k + i, 6 * k + j] += own[i, j]
    ok, W = inverse_of_any_scale(placings, 0.0)
    if not ok:
        return bits
    each, total = np.zeros((K, 6, 6)), np.zeros((6, 6))
    for k in range(K):
        for i in range(6):
            for j in range(6):
                for m in range(K):
                    each[k, i, j] += W[6 * m + i, 6 * k + j]
                total[i, j] += each[k, i, j]
    ok, whole = factor(total, 0.0)
    if not ok:
        return bits
    for k in range(K):
        ok, own = factor(W[6 * k : 6 * k + 6, 6 * k : 6 * k + 6], 0.0)
        if ok:
            bits[k] = bits_without(each[k], own, whole)
    return bits


@kernel
def bits_without(rows, own, whole):
    """What a view loses with a keyframe, in bits.

    rows (6, 6): those of the view. own, whole: Cholesky factors (6, 6) of the keyframe's own block, and of all that the
    view knows, in whose units the loss is rows own^-1 rows^T.
    """
    loss = np.empty((6, 6))
    for i in range(6):
        for r in range(6):  # own^-1 rows^T, a column of it
            s = rows[i, r]
            for j in range(r):
                s -= own[r, j] * loss[i, j]
            loss[i, r] = s / own[r, r]
    for r in range(6):
        for i in range(6):  # whole^-1 of that from the left
            s = loss[i, r]
            for j in range(i):
                s -= whole[i, j] * loss[j, r]
            loss[i, r] = s / whole[i, i]
    left = np.zeros((6, 6))
    for i in range(6):
        for j in range(6):
            for r in range(6):
                left[i, j] -= loss[i, r] * loss[j, r]
        left[i, i] += 1.0
    total = 0.0
    for i in range(6):  # the determinant, by Cholesky in place
        pivot = left[i, i]
        for k in range(i):
            pivot -= left[i, k] * left[i, k]
        pivot = sqrt(max(pivot, NOTHING_LEFT))
        left[i, i] = pivot
        for j in range(i + 1, 6):
            s = left[j, i]
            for k in range(i):
                s -= left[j, k] * left[i, k]
            left[j, i] = s / pivot
        total -= log(pivot)
    return total / log(2.0)


@kernel
def place(block, A, B, out, at):
    """Fill A block B^T at a place of out, and its transpose at the mirrored one."""
    half = np.zeros((6, 6))
    for i in range(6):
        for k in range(6):
            a = A[i, k]
            for j in range(6):
                half[i, j] += a * block[k, j]
    for i in range(6):
        for j in range(6):
            s = 0.0
            for k in range(6):
                s += half[i, k] * B[j, k]
            out[at[0] + i, at[1] + j] = s
            out[at[1] + j, at[0] + i] = s


@kernel
def inverse_of_any_scale(A, unknown):
    """(ok, A^-1) of a symmetric positive definite matrix, whose unit diagonal gets so much on top; else not ok."""
    n = A.shape[0]
    scale = np.empty(n)
    for i in range(n):
        scale[i] = 1.0 / sqrt(max(A[i, i], 1e-12))
    unit = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            unit[i, j] = scale[i] * A[i, j] * scale[j]
        unit[i, i] += unknown
    out = np.zeros((n, n))
    ok, L = factor(unit, 0.0)
    if not ok:
        return False, out
    X = np.zeros((n, n))  # L^-1
    for i in range(n):
        row = X[i]
        row[i] = 1.0
        for k in range(i):
            subtract(L[i, k], X[k], row, k + 1)
        for j in range(i + 1):
            row[j] /= L[i, i]
    for k in range(n):  # X^T X, the lower half
        for i in range(k + 1):
            subtract(-X[k, i], X[k], out[i], i + 1)
    for i in range(n):
        for j in range(i + 1):
            out[i, j] *= scale[i] * scale[j]
            out[j, i] = out[i, j]
    return True, out


@kernel
def subtract(factor, row, out, count):
    """Subtract the first numbers of a row times a factor."""
    for j in range(count):
        out[j] -= factor * row[j]
