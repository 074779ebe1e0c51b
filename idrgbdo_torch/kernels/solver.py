"""Small dense linear algebra without exceptions: failure is a value here."""

from __future__ import annotations

from math import isfinite, sqrt

import numpy as np

from .compiled import exact_kernel, kernel


@exact_kernel
def multiply(A, B):
    """A B of two small matrices, without BLAS: setting up a call costs more than the product."""
    out = np.zeros((A.shape[0], B.shape[1]))
    for i in range(A.shape[0]):
        for k in range(A.shape[1]):
            a = A[i, k]
            for j in range(B.shape[1]):
                out[i, j] += a * B[k, j]
    return out


@exact_kernel
def put(values, out):
    """Copy into an array of the same shape: by `out[:] = values` numba compiles what it would say of other shapes too,
    text and all, which takes seconds."""
    for at in np.ndindex(values.shape):
        out[at] = values[at]


@exact_kernel
def add(values, out):
    """Add to an array of the same shape, see put."""
    for at in np.ndindex(values.shape):
        out[at] += values[at]


@kernel
def dot(a, b):
    """a^T b of two short vectors."""
    total = 0.0
    for i in range(a.shape[0]):
        total += a[i] * b[i]
    return total


@kernel
def factor(A, least):
    """(ok, L) with L L^T = A (n, n); not ok where a pivot is not above least, or not finite."""
    n = A.shape[0]
    L = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                if not (s > least * least and isfinite(s)):
                    return False, L
                L[i, i] = sqrt(s)
            else:
                L[i, j] = s / L[j, j]
    return True, L


@kernel
def solve_spd(A, b):
    """(ok, x) of A x = b by Cholesky; not ok where A is not positive definite or not finite."""
    n = A.shape[0]
    x = np.zeros(n)
    ok, L = factor(A, 0.0)
    if not ok:
        return False, x
    for i in range(n):
        s = b[i]
        for k in range(i):
            s -= L[i, k] * x[k]
        x[i] = s / L[i, i]
    for i in range(n - 1, -1, -1):
        s = x[i]
        for k in range(i + 1, n):
            s -= L[k, i] * x[k]
        x[i] = s / L[i, i]
    for i in range(n):
        if not isfinite(x[i]):
            return False, x
    return True, x


@kernel
def forward(L, B):
    """L^-1 B of a lower triangle (n, n) and (n, m)."""
    X = B.copy()
    for i in range(X.shape[0]):
        row = X[i]
        for k in range(i):
            add_multiple(-L[i, k], X[k], row)
        for j in range(row.shape[0]):
            row[j] /= L[i, i]
    return X


@kernel
def add_multiple(factor, row, out):
    """Add a row, which may be shorter, times a factor."""
    for j in range(row.shape[0]):
        out[j] += factor * row[j]


@kernel
def inverse_spd(A):
    """Inverse of a symmetric positive definite matrix; zeros where it is not."""
    n = A.shape[0]
    out = np.zeros((n, n))
    ok, L = factor(A, 0.0)
    if not ok:
        return out
    X = np.zeros((n, n))  # L^-1, a lower triangle
    for i in range(n):
        X[i, i] = 1.0
        for k in range(i):
            add_multiple(-L[i, k], X[k, : k + 1], X[i])
        for j in range(i + 1):
            X[i, j] /= L[i, i]
        for k in range(i + 1):  # X^T X
            add_multiple(X[i, k], X[i, : k + 1], out[k])
    for i in range(n):
        for j in range(i):
            out[j, i] = out[i, j]
    return out
