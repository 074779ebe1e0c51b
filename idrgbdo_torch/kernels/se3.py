"""Twins of se3.exp, se3.log, se3.adjoint and se3.retract for one (4, 4) pose.

Products are written out: numba would take `@` from scipy's BLAS, which is slower at this size and to compile.
"""

from __future__ import annotations

from math import acos, asin, cos, sin, sqrt

import numpy as np

from .compiled import exact_kernel, kernel
from .solver import put


@kernel
def retract(xi, T):
    """exp(xi) T, twist [v, w] (Eq. 1)."""
    wx, wy, wz = xi[3], xi[4], xi[5]
    theta2 = wx * wx + wy * wy + wz * wz
    if theta2 < 1e-8:
        a = 1.0 - theta2 / 6.0
        b = 0.5 - theta2 / 24.0
        c = 1.0 / 6.0 - theta2 / 120.0
    else:
        theta = sqrt(theta2)
        a = sin(theta) / theta
        b = (1.0 - cos(theta)) / theta2
        c = (1.0 - a) / theta2
    R = np.empty((3, 3))
    V = np.empty((3, 3))
    rodrigues(wx, wy, wz, theta2, a, b, R)
    rodrigues(wx, wy, wz, theta2, b, c, V)
    out = np.zeros((4, 4))
    for i in range(3):
        for j in range(4):
            out[i, j] = R[i, 0] * T[0, j] + R[i, 1] * T[1, j] + R[i, 2] * T[2, j]
        out[i, 3] += V[i, 0] * xi[0] + V[i, 1] * xi[1] + V[i, 2] * xi[2]
    out[3, 3] = 1.0
    # one Newton step back to a rotation: rounding would otherwise grow from frame to frame
    for i in range(3):
        for j in range(3):
            R[i, j] = out[0, i] * out[0, j] + out[1, i] * out[1, j] + out[2, i] * out[2, j]
    for i in range(3):
        x, y, z = out[i, 0], out[i, 1], out[i, 2]
        for j in range(3):
            out[i, j] = 1.5 * out[i, j] - 0.5 * (x * R[0, j] + y * R[1, j] + z * R[2, j])
    return out


@kernel
def rodrigues(wx, wy, wz, theta2, a, b, out):
    """out (3, 3) = I + a W + b W W with W the skew matrix of w, whose square is w w^T - |w|^2 I."""
    d = 1.0 - b * theta2
    out[0, 0] = d + b * wx * wx
    out[1, 1] = d + b * wy * wy
    out[2, 2] = d + b * wz * wz
    out[0, 1] = b * wx * wy - a * wz
    out[1, 0] = b * wx * wy + a * wz
    out[0, 2] = b * wx * wz + a * wy
    out[2, 0] = b * wx * wz - a * wy
    out[1, 2] = b * wy * wz - a * wx
    out[2, 1] = b * wy * wz + a * wx


@kernel
def inverse(T):
    """Inverse of a rigid transform."""
    out = np.zeros((4, 4))
    for i in range(3):
        for j in range(3):
            out[i, j] = T[j, i]
        out[i, 3] = -(T[0, i] * T[0, 3] + T[1, i] * T[1, 3] + T[2, i] * T[2, 3])
    out[3, 3] = 1.0
    return out


@kernel
def compose(A, B):
    """A B of two rigid transforms."""
    out = np.zeros((4, 4))
    for i in range(3):
        for j in range(4):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]
        out[i, 3] += A[i, 3]
    out[3, 3] = 1.0
    return out


@kernel
def log_se3(T):
    """Twist [v, w] of T for rotations well below pi (priors and steps; se3.log is the general one)."""
    cos_theta = 0.5 * (T[0, 0] + T[1, 1] + T[2, 2] - 1.0)
    cos_theta = min(1.0, max(-1.0, cos_theta))
    wx, wy, wz = T[2, 1] - T[1, 2], T[0, 2] - T[2, 0], T[1, 0] - T[0, 1]
    s = 0.5 * sqrt(wx * wx + wy * wy + wz * wz)  # sin theta
    if s < 1e-6:
        scale = 0.5
        theta2 = s * s
        k = 1.0 / 12.0
    else:
        theta = acos(cos_theta) if cos_theta < 0.9 else asin(min(1.0, s))
        scale = theta / (2.0 * s)
        theta2 = theta * theta
        k = 1.0 / theta2 - (1.0 + cos_theta) / (2.0 * theta * s)
    wx *= scale
    wy *= scale
    wz *= scale
    V_inv = np.empty((3, 3))
    rodrigues(wx, wy, wz, theta2, -0.5, k, V_inv)
    out = np.empty(6)
    for i in range(3):
        out[i] = V_inv[i, 0] * T[0, 3] + V_inv[i, 1] * T[1, 3] + V_inv[i, 2] * T[2, 3]
    out[3] = wx
    out[4] = wy
    out[5] = wz
    return out


@kernel
def adjoint(T):
    """Adjoint of T for twists [v, w]: exp(Ad_T xi) = T exp(xi) T^-1."""
    x, y, z = T[0, 3], T[1, 3], T[2, 3]
    out = np.zeros((6, 6))
    for j in range(3):
        for i in range(3):
            out[i, j] = T[i, j]
            out[3 + i, 3 + j] = T[i, j]
        out[0, 3 + j] = y * T[2, j] - z * T[1, j]
        out[1, 3 + j] = z * T[0, j] - x * T[2, j]
        out[2, 3 + j] = x * T[1, j] - y * T[0, j]
    return out


@exact_kernel
def increments(T, T_0):
    """Left increments (K, 6) that take poses T_0 (K, 4, 4) to T."""
    out = np.empty((T.shape[0], 6))
    for k in range(T.shape[0]):
        put(log_se3(compose(T[k], inverse(T_0[k]))), out[k])
    return out


@exact_kernel
def retracted(xi, T):
    """Poses T (K, 4, 4) after left increments (K, 6)."""
    out = np.empty_like(T)
    for k in range(T.shape[0]):
        put(retract(xi[k], T[k]), out[k])
    return out


@exact_kernel
def adjoints_to_last(T):
    """(K, 6, 6) adjoints of T_last_k for poses T_k_world (K, 4, 4)."""
    out = np.empty((T.shape[0], 6, 6))
    for k in range(T.shape[0]):
        put(adjoint(compose(T[-1], inverse(T[k]))), out[k])
    return out
