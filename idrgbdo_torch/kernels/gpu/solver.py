"""Small systems of one pair: twin of solve() in definitions/solver.py."""

from __future__ import annotations

import triton
import triton.language as tl

from ... import measurement

FLOOR = tl.constexpr(measurement.FLOOR)
MIN_PIVOT = tl.constexpr(1e-13)  # of definitions/solver.py
SIZE = tl.constexpr(8)


@triton.jit
def entry(vector, k: tl.constexpr):
    """Number k of a vector (8,)."""
    return tl.sum(tl.where(tl.arange(0, SIZE) == k, vector, 0.0))


@triton.jit
def vector_of(x0, x1, x2, x3, x4, x5, x6, x7):
    """(8,) of eight numbers."""
    c = tl.arange(0, SIZE)
    low = tl.where(c == 0, x0, tl.where(c == 1, x1, tl.where(c == 2, x2, x3)))
    high = tl.where(c == 4, x4, tl.where(c == 5, x5, tl.where(c == 6, x6, x7)))
    return tl.where(c < 4, low, high)


@triton.jit
def solve(H, b, damping):
    """The step y (8,) with (H + FLOOR + damping diag H) y = b, zero where there is none; and whether there is one.

    By elimination on the unit-diagonal system; its pivots are the squares of the Cholesky factor's diagonal.
    """
    i, j = tl.arange(0, SIZE)[:, None], tl.arange(0, SIZE)[None, :]
    H = tl.where(i == j, H + FLOOR, H)
    diagonal = tl.sum(tl.where(i == j, H, 0.0), axis=1)
    good = (tl.min(diagonal) > 0.0) & (tl.sum(tl.abs(H)) < float("inf")) & (tl.sum(tl.abs(b)) < float("inf"))
    scale = 1.0 / tl.sqrt(tl.where(good, diagonal, 1.0))  # units drop out
    A = tl.where(good, scale[:, None] * H * scale[None, :], 0.0) + tl.where(i == j, tl.where(good, damping, 1.0), 0.0)
    right = tl.where(good, scale * b, 0.0)
    for k in tl.static_range(SIZE):
        here = tl.arange(0, SIZE) == k
        row = tl.sum(tl.where(i == k, A, 0.0), axis=0)
        pivot = entry(row, k)
        good = good & (pivot > MIN_PIVOT)
        column = tl.sum(tl.where(j == k, A, 0.0), axis=1)
        factor = tl.where(here, 0.0, column / tl.where(good, pivot, 1.0))
        A = A - factor[:, None] * row[None, :]
        right = right - factor * entry(right, k)
    pivots = tl.sum(tl.where(i == j, A, 0.0), axis=1)
    y = scale * right / tl.where(good, pivots, 1.0)
    return tl.where(good, y, 0.0), good
