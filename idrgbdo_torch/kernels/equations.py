"""Normal equations of a pose and a brightness from what patches and depths tell, in lanes (see patch.py).

Equations of LANES points are kept apart, a row of lanes for each number of the system, and added up at the end.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from ..measurement import OTHER_SURFACE, PIXELS, STEP, Array
from . import patch as at
from .compiled import exact_kernel
from .image import sample_inverse_depth
from .patch import LANES

# rows of the Jacobians: of u and v by [v, w] and brightness, the same times the patch's sums, and of the depth residual
JU, JV, GU, GV, JZ = (LANES * STEP * i for i in range(5))
CROSS = LANES * STEP * 5  # rows between the pose, the brightness and the inverse depth
GZ_U, GZ_V, RZ, WZ, HD, BD = (LANES * (STEP * 6 + i) for i in range(6))  # the measured inverse depth's gradient,
# residual and weight; normal equations of the inverse depth
JACOBIAN_ROWS = LANES * (STEP * 6 + 6)
HESSIAN, VECTOR = 0, LANES * STEP * STEP  # rows of the system
SYSTEM_ROWS = LANES * STEP * (STEP + 1)


class Equations(NamedTuple):
    """Jacobians of LANES points, and normal equations that grow lane by lane."""

    jacobians: Array  # (JACOBIAN_ROWS,)
    system: Array  # (SYSTEM_ROWS,) of H the upper half


@exact_kernel
def new_equations():
    """None so far."""
    return Equations(np.zeros(JACOBIAN_ROWS), np.zeros(SYSTEM_ROWS))


@exact_kernel
def pose_jacobians(camera, room, jacobians):
    """Fill duv/d[v, w] of a left increment, where the points are in the target."""
    fx, fy = camera[0], camera[1]
    rows = room.points
    for n in range(room.lanes):
        x, y, rho = rows[at.X + n], rows[at.Y + n], rows[at.RHO + n]
        jacobians[JU + n] = fx * rho
        jacobians[JU + 2 * LANES + n] = -fx * rho * x
        jacobians[JU + 3 * LANES + n] = -fx * x * y
        jacobians[JU + 4 * LANES + n] = fx * (1.0 + x * x)
        jacobians[JU + 5 * LANES + n] = -fx * y
        jacobians[JV + LANES + n] = fy * rho
        jacobians[JV + 2 * LANES + n] = -fy * rho * y
        jacobians[JV + 3 * LANES + n] = -fy * (1.0 + y * y)
        jacobians[JV + 4 * LANES + n] = fy * x * y
        jacobians[JV + 5 * LANES + n] = fy * x


@exact_kernel
def add_patches(room, equations):
    """Add the sums of patches; those of lanes that do not count must be 0."""
    rows, lanes = room.points, room.lanes
    jacobians, system = equations.jacobians, equations.system
    for j in range(6):
        ju, jv, gu, gv = JU + LANES * j, JV + LANES * j, GU + LANES * j, GV + LANES * j
        of_b = VECTOR + LANES * j
        for n in range(lanes):
            u, v = jacobians[ju + n], jacobians[jv + n]
            jacobians[gu + n] = rows[at.G00 + n] * u + rows[at.G01 + n] * v
            jacobians[gv + n] = rows[at.G01 + n] * u + rows[at.G11 + n] * v
            system[of_b + n] += rows[at.C0 + n] * u + rows[at.C1 + n] * v
    for n in range(lanes):
        jacobians[GU + 6 * LANES + n] = rows[at.G02 + n]
        jacobians[GU + 7 * LANES + n] = rows[at.G03 + n]
        jacobians[GV + 6 * LANES + n] = rows[at.G12 + n]
        jacobians[GV + 7 * LANES + n] = rows[at.G13 + n]
        system[HESSIAN + LANES * 54 + n] += rows[at.G22 + n]  # 54 = 6 * 8 + 6: H[6, 6]
        system[HESSIAN + LANES * 55 + n] += rows[at.G23 + n]
        system[HESSIAN + LANES * 63 + n] += rows[at.G33 + n]
        system[VECTOR + LANES * 6 + n] += rows[at.C2 + n]
        system[VECTOR + LANES * 7 + n] += rows[at.C3 + n]
    for i in range(6):
        ju, jv = JU + LANES * i, JV + LANES * i
        for j in range(i, STEP):
            gu, gv, of_h = GU + LANES * j, GV + LANES * j, HESSIAN + LANES * (STEP * i + j)
            for n in range(lanes):
                system[of_h + n] += jacobians[ju + n] * jacobians[gu + n] + jacobians[jv + n] * jacobians[gv + n]


@exact_kernel
def measure_depths(depth, camera, size, room, noise, jacobians, weights=None):
    """Fill the depth residuals of the points seen, their gradients and weights (0 where there is none); the energy.

    depth (H, W) m of level 0; size: of one of its pixels on this level; VAR_D: what the inverse depths leave open.
    weights: rows of lanes, of which the last is a factor on a depth's information.
    """
    fx, fy, cx, cy = camera
    rows = room.points
    up = 1.0 / size
    huber = noise.huber
    energy = 0.0
    for n in range(room.lanes):
        jacobians[RZ + n] = 0.0
        jacobians[WZ + n] = 0.0
        if rows[at.SEEN + n] == 0.0:
            continue
        u, v = fx * rows[at.X + n] + cx, fy * rows[at.Y + n] + cy
        ok, measured, gu, gv = sample_inverse_depth(depth, (u + 0.5) * up - 0.5, (v + 0.5) * up - 0.5, 0.05)
        if not ok:
            continue
        gu *= up
        gv *= up
        r = measured - rows[at.RHO + n]
        stretch = rows[at.IZ + n] ** 2  # d rho / d d, up to the small t_z term
        w = 1.0 / (noise.var_depth + stretch * stretch * rows[at.VAR_D + n] + noise.var_pixel * (gu * gu + gv * gv))
        if weights is not None:
            w *= weights[LANES * PIXELS + n]
        s = sqrt(r * r * w)
        if s > OTHER_SURFACE * huber:  # another surface: constant cost, no weight
            energy += (2.0 * OTHER_SURFACE - 1.0) * huber * huber
            continue
        m = min(s, huber)
        energy += m * (2.0 * s - m)
        jacobians[GZ_U + n] = gu
        jacobians[GZ_V + n] = gv
        jacobians[RZ + n] = r
        jacobians[WZ + n] = w * huber / max(s, huber)
    return energy


@exact_kernel
def add_depths(room, equations):
    """Add the depth residuals; with the pose, P_z moves by v_z + (y w_x - x w_y) / rho."""
    rows, lanes = room.points, room.lanes
    jacobians, system = equations.jacobians, equations.system
    for j in range(6):
        ju, jv, jz = JU + LANES * j, JV + LANES * j, JZ + LANES * j
        for n in range(lanes):
            jacobians[jz + n] = jacobians[GZ_U + n] * jacobians[ju + n] + jacobians[GZ_V + n] * jacobians[jv + n]
    for n in range(lanes):
        x, y, rho = rows[at.X + n], rows[at.Y + n], rows[at.RHO + n]
        jacobians[JZ + 2 * LANES + n] += rho * rho
        jacobians[JZ + 3 * LANES + n] += rho * y
        jacobians[JZ + 4 * LANES + n] -= rho * x
    for i in range(6):
        jz, of_b = JZ + LANES * i, VECTOR + LANES * i
        for n in range(lanes):
            system[of_b + n] -= jacobians[WZ + n] * jacobians[jz + n] * jacobians[RZ + n]
        for j in range(i, 6):
            kz, of_h = JZ + LANES * j, HESSIAN + LANES * (STEP * i + j)
            for n in range(lanes):
                system[of_h + n] += jacobians[WZ + n] * jacobians[jz + n] * jacobians[kz + n]


@exact_kernel
def depth_equations(T, room, jacobians, use_depth):
    """Fill what the inverse depths themselves get from patches and depths: CROSS, HD, BD.

    T: T_target_host where the Jacobians are taken.
    """
    rows, lanes = room.points, room.lanes
    for n in range(lanes):
        u, v = rows[at.DU + n], rows[at.DV + n]
        gu, gv = rows[at.G00 + n] * u + rows[at.G01 + n] * v, rows[at.G01 + n] * u + rows[at.G11 + n] * v
        jacobians[HD + n] = u * gu + v * gv
        jacobians[BD + n] = rows[at.C0 + n] * u + rows[at.C1 + n] * v
    for j in range(STEP):
        gu, gv, cross = GU + LANES * j, GV + LANES * j, CROSS + LANES * j
        for n in range(lanes):
            jacobians[cross + n] = rows[at.DU + n] * jacobians[gu + n] + rows[at.DV + n] * jacobians[gv + n]
    if not use_depth:
        return
    tz = T[2, 3]
    for n in range(lanes):
        along = jacobians[GZ_U + n] * rows[at.DU + n] + jacobians[GZ_V + n] * rows[at.DV + n]
        jd = along - rows[at.IZ + n] * (1.0 - rows[at.RHO + n] * tz)
        w = jacobians[WZ + n] * jd
        jacobians[HD + n] += w * jd
        jacobians[BD + n] -= w * jacobians[RZ + n]
        jacobians[WZ + n] = w  # from here on
    for j in range(6):
        jz, cross = JZ + LANES * j, CROSS + LANES * j
        for n in range(lanes):
            jacobians[cross + n] += jacobians[WZ + n] * jacobians[jz + n]


@exact_kernel
def add_up(system, H, b):
    """The sum over lanes: H (8, 8), both halves, and b (8,)."""
    for i in range(STEP):
        total = 0.0
        for n in range(LANES):
            total += system[VECTOR + LANES * i + n]
        b[i] = total
        for j in range(i, STEP):
            total = 0.0
            for n in range(LANES):
                total += system[HESSIAN + LANES * (STEP * i + j) + n]
            H[i, j] = total
            H[j, i] = total
