"""Which keyframe a window can spare: the fused twin of definitions/removal.py."""

from __future__ import annotations

from math import log

import numpy as np

from ..measurement import LINK_FLOOR, UNKNOWN
from .compiled import kernel
from .marginalization import unit_diagonal
from .solver import add, factor, forward, inverse_spd, multiply, put


@kernel
def next_view_bits(information, links, adjoints):
    """Twin of removal.next_view_bits: (K,) bits, from (6K, 6K), (K, 6, 6) and (K, 6, 6); nan where that fails."""
    K = links.shape[0]
    bits = np.full(K, np.nan)
    placings = inverse_of_any_scale(information, UNKNOWN)
    if placings[0, 0] == 0.0:
        return bits
    for k in range(K):  # adjoints of both sides, in place
        for m in range(k + 1):
            block, across = (
                placings[6 * k : 6 * k + 6, 6 * m : 6 * m + 6],
                placings[6 * m : 6 * m + 6, 6 * k : 6 * k + 6],
            )
            put(multiply(multiply(adjoints[k], block), adjoints[m].T), block)
            put(block.T, across)
        add(inverse_spd(floored(links, k)), placings[6 * k : 6 * k + 6, 6 * k : 6 * k + 6])
    W = inverse_of_any_scale(placings, 0.0)
    each, total = np.zeros((K, 6, 6)), np.zeros((6, 6))
    for k in range(K):
        for m in range(K):
            add(W[6 * m : 6 * m + 6, 6 * k : 6 * k + 6], each[k])
        add(each[k], total)
    ok, whole = factor(total, 0.0)
    for k in range(K):
        known, own = factor(W[6 * k : 6 * k + 6, 6 * k : 6 * k + 6], 0.0)
        if ok and known:
            bits[k] = bits_without(each[k], own, whole)
    return bits


@kernel
def floored(links, k):
    """(6, 6) information of a link, with a share of the best known of all on its diagonal."""
    out = links[k].copy()
    for i in range(6):
        out[i, i] += LINK_FLOOR * links[:, i, i].max()
    return out


@kernel
def bits_without(rows, own, whole):
    """What a view loses with a keyframe, in bits; infinite where nothing is left.

    rows (6, 6): those of the view. own, whole: Cholesky factors (6, 6) of the keyframe's own block, and of all that the
    view knows, in whose units the loss is rows own^-1 rows^T.
    """
    loss = forward(whole, np.ascontiguousarray(forward(own, np.ascontiguousarray(rows.T)).T))
    ok, left = factor(np.eye(6) - multiply(loss, loss.T), 0.0)
    if not ok:
        return np.inf
    total = 0.0
    for i in range(6):
        total -= log(left[i, i])
    return total / log(2.0)


@kernel
def inverse_of_any_scale(A, unknown):
    """A^-1 of a symmetric positive definite matrix, whose unit diagonal gets so much on top; zeros where it is not."""
    n = A.shape[0]
    unit, scale = unit_diagonal(A, np.arange(n))
    for i in range(n):
        unit[i, i] += unknown
    out = inverse_spd(unit)
    for i in range(n):
        for j in range(n):
            out[i, j] *= scale[i] * scale[j]
    return out
