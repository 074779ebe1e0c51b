"""Motions of one pair: twins of definitions/se3.py. A pose is twelve numbers, R | t row by row; a twist is six."""

from __future__ import annotations

import triton
import triton.language as tl

TINY = tl.constexpr(1e-30)  # rad^2, instead of no rotation: what is divided by it vanishes there


@triton.jit
def rotation_series(angle2):
    """sin t / t, (1 - cos t) / t^2 and (t - sin t) / t^3 from t^2.

    Near 0 the last one cancels, by as much as what it is multiplied with is small.
    """
    x = tl.maximum(angle2, TINY)
    t = tl.sqrt(x)
    sinc = tl.sin(t) / t
    half = tl.sin(0.5 * t) / (0.5 * t)
    return sinc, 0.5 * half * half, (1.0 - sinc) / x


@triton.jit
def retract(v0, v1, v2, x, y, z, T):
    """exp([v, (x, y, z)]) T."""
    sinc, versine, cubic = rotation_series(x * x + y * y + z * z)
    R = rotation(x, y, z, sinc, versine)
    V = rotation(x, y, z, versine, cubic)
    t0, t1, t2 = rotated(V, v0, v1, v2)
    return (
        R[0] * T[0] + R[1] * T[4] + R[2] * T[8], R[0] * T[1] + R[1] * T[5] + R[2] * T[9],
        R[0] * T[2] + R[1] * T[6] + R[2] * T[10], R[0] * T[3] + R[1] * T[7] + R[2] * T[11] + t0,
        R[3] * T[0] + R[4] * T[4] + R[5] * T[8], R[3] * T[1] + R[4] * T[5] + R[5] * T[9],
        R[3] * T[2] + R[4] * T[6] + R[5] * T[10], R[3] * T[3] + R[4] * T[7] + R[5] * T[11] + t1,
        R[6] * T[0] + R[7] * T[4] + R[8] * T[8], R[6] * T[1] + R[7] * T[5] + R[8] * T[9],
        R[6] * T[2] + R[7] * T[6] + R[8] * T[10], R[6] * T[3] + R[7] * T[7] + R[8] * T[11] + t2,
    )  # fmt: skip


@triton.jit
def rotation(x, y, z, once, twice):
    """I + once W + twice W^2 of the skew matrix W of (x, y, z), nine numbers row by row."""
    xx, yy, zz = x * x, y * y, z * z
    xy, xz, yz = twice * x * y, twice * x * z, twice * y * z
    return (
        1.0 - twice * (yy + zz), xy - once * z, xz + once * y,
        xy + once * z, 1.0 - twice * (xx + zz), yz - once * x,
        xz - once * y, yz + once * x, 1.0 - twice * (xx + yy),
    )  # fmt: skip


@triton.jit
def rotated(R, x, y, z):
    """R (x, y, z), of nine numbers row by row."""
    return R[0] * x + R[1] * y + R[2] * z, R[3] * x + R[4] * y + R[5] * z, R[6] * x + R[7] * y + R[8] * z


@triton.jit
def log_between(T, A):
    """The twist of T A^-1, of twelve numbers each; for rotations that are less than half a turn.

    The angle is 4 atan x; halving x three times leaves little for the series.
    """
    r00 = T[0] * A[0] + T[1] * A[1] + T[2] * A[2]
    r01 = T[0] * A[4] + T[1] * A[5] + T[2] * A[6]
    r02 = T[0] * A[8] + T[1] * A[9] + T[2] * A[10]
    r10 = T[4] * A[0] + T[5] * A[1] + T[6] * A[2]
    r11 = T[4] * A[4] + T[5] * A[5] + T[6] * A[6]
    r12 = T[4] * A[8] + T[5] * A[9] + T[6] * A[10]
    r20 = T[8] * A[0] + T[9] * A[1] + T[10] * A[2]
    r21 = T[8] * A[4] + T[9] * A[5] + T[10] * A[6]
    r22 = T[8] * A[8] + T[9] * A[9] + T[10] * A[10]
    t0 = T[3] - (r00 * A[3] + r01 * A[7] + r02 * A[11])
    t1 = T[7] - (r10 * A[3] + r11 * A[7] + r12 * A[11])
    t2 = T[11] - (r20 * A[3] + r21 * A[7] + r22 * A[11])
    real = 0.5 * tl.sqrt(tl.maximum(1.0 + r00 + r11 + r22, TINY))
    x, y, z = (r21 - r12) / (4.0 * real), (r02 - r20) / (4.0 * real), (r10 - r01) / (4.0 * real)
    n2 = x * x + y * y + z * z
    whole = tl.sqrt(n2 + real * real) + real
    a2 = n2 / (whole * whole)
    angle = 4.0 / whole  # over n
    for _ in tl.static_range(3):
        more = 1.0 + tl.sqrt(1.0 + a2)
        a2 = a2 / (more * more)
        angle = angle * 2.0 / more
    series = 1 / 13 - a2 * (1 / 15 - a2 / 17)
    series = 1.0 - a2 * (1 / 3 - a2 * (1 / 5 - a2 * (1 / 7 - a2 * (1 / 9 - a2 * (1 / 11 - a2 * series)))))
    angle = angle * series
    x, y, z = angle * x, angle * y, angle * z
    angle2 = x * x + y * y + z * z
    sinc, versine, _cubic = rotation_series(angle2)
    back = rotation(x, y, z, -0.5, (1.0 - 0.5 * sinc / versine) / tl.maximum(angle2, TINY))
    v0, v1, v2 = rotated(back, t0, t1, t2)
    return v0, v1, v2, x, y, z
