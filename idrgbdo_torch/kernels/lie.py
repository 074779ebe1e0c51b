"""Twins of se3.exp, se3.log, se3.adjoint and se3.retract for one (4, 4) pose."""

from __future__ import annotations

from math import acos, cos, sin, sqrt

import numpy as np

from .compiled import kernel
from .linear import multiply


@kernel
def retract(xi, T):
    """exp(xi) T, twist [v, w] (Eq. 1)."""
    vx, vy, vz, wx, wy, wz = xi[0], xi[1], xi[2], xi[3], xi[4], xi[5]
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
    W = np.array([[0.0, -wz, wy], [wz, 0.0, -wx], [-wy, wx, 0.0]])
    W2 = multiply(W, W)
    eye = np.eye(3)
    R = eye + a * W + b * W2
    V = eye + b * W + c * W2
    out = np.eye(4)
    # one Newton step back to a rotation: rounding would otherwise grow from frame to frame
    M = multiply(R, T[:3, :3])
    out[:3, :3] = 1.5 * M - 0.5 * multiply(M, multiply(M.T, M))
    for i in range(3):
        out[i, 3] = (
            R[i, 0] * T[0, 3] + R[i, 1] * T[1, 3] + R[i, 2] * T[2, 3] + V[i, 0] * vx + V[i, 1] * vy + V[i, 2] * vz
        )
    return out


@kernel
def inverse(T):
    """Inverse of a rigid transform."""
    out = np.eye(4)
    for i in range(3):
        for j in range(3):
            out[i, j] = T[j, i]
        out[i, 3] = -(T[0, i] * T[0, 3] + T[1, i] * T[1, 3] + T[2, i] * T[2, 3])
    return out


@kernel
def log_se3(T):
    """Twist [v, w] of T for rotations well below pi (priors and steps; se3.log is the general one)."""
    cos_theta = 0.5 * (T[0, 0] + T[1, 1] + T[2, 2] - 1.0)
    cos_theta = min(1.0, max(-1.0, cos_theta))
    w = np.array([T[2, 1] - T[1, 2], T[0, 2] - T[2, 0], T[1, 0] - T[0, 1]])
    s = 0.5 * sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])  # sin theta
    if s < 1e-6:
        w *= 0.5
        theta2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
        k = 1.0 / 12.0
    else:
        theta = acos(cos_theta) if cos_theta < 0.9 else np.arcsin(min(1.0, s))
        w *= theta / (2.0 * s)
        theta2 = theta * theta
        k = 1.0 / theta2 - (1.0 + cos_theta) / (2.0 * theta * s)
    W = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    V_inv = np.eye(3) - 0.5 * W + k * multiply(W, W)
    out = np.empty(6)
    for i in range(3):
        out[i] = V_inv[i, 0] * T[0, 3] + V_inv[i, 1] * T[1, 3] + V_inv[i, 2] * T[2, 3]
        out[3 + i] = w[i]
    return out


@kernel
def adjoint(T):
    """Adjoint of T for twists [v, w]: exp(Ad_T xi) = T exp(xi) T^-1."""
    R = T[:3, :3]
    t = T[:3, 3]
    S = np.array([[0.0, -t[2], t[1]], [t[2], 0.0, -t[0]], [-t[1], t[0], 0.0]])
    out = np.zeros((6, 6))
    out[:3, :3] = R
    out[3:, 3:] = R
    out[:3, 3:] = multiply(S, R)
    return out
