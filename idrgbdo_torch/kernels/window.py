"""Fused linearisation of the sliding window: every point of every keyframe against every other keyframe."""

from __future__ import annotations

from math import exp, sqrt

import numpy as np

from ..measurement import STEP
from . import equations as of
from . import patch as at
from .compiled import exact_kernel
from .equations import (
    add_depths,
    add_patches,
    add_up,
    depth_equations,
    measure_depths,
    new_equations,
    pose_jacobians,
)
from .patch import LANES, Brightness, Room, forget_unseen, lanes_for, new_room, patch_sums, place_again
from .se3 import adjoint, inverse
from .solver import dot, multiply


@exact_kernel
def linearise_window(views, state, points, pairs, limit, noise, system):
    """Normal equations of the window: views Views, state WindowState, points WindowPoints; fills a WindowSystem.

    pairs (K, K) bool: which hosts' points take part against which targets, on the diagonal with their own sensor's
    measurement. limit: of a point's rms. Returns the energy.
    """
    T_cam_world, T_linear, affine = state.T, state.T_linear, state.affine
    K, N = state.inv_depth.shape
    system.H[:] = 0.0
    system.b[:] = 0.0
    system.Hd[:] = 0.0
    system.bd[:] = 0.0
    system.cross[:] = 0.0
    system.rms[:] = -1.0
    chunks = (N + LANES - 1) // LANES
    whole = new_room(points.patch.shape[2])
    rows = np.zeros((chunks, whole.points.shape[0]))
    pixels = np.zeros((chunks, whole.pixels.shape[0]), np.float32)
    chain = np.zeros((STEP, STEP))  # increments of the relative state by those of the host
    energy = 0.0
    for host in range(K):
        if not pairs[host].any():
            continue
        if pairs[host, host]:
            energy += own_sensor(points, state.inv_depth, host, system)
        for chunk in range(chunks):
            room = Room(rows[chunk], pixels[chunk], whole.places, LANES, whole.used)
            host_rows(points, state.inv_depth, host, chunk * LANES, room)
        for target in range(K):
            if target == host or not pairs[host, target]:
                continue
            T = multiply(T_cam_world[target], inverse(T_cam_world[host]))
            T0 = multiply(T_linear[target], inverse(T_linear[host]))
            gain = exp(affine[target, 0] - affine[host, 0])
            chain[:6, :6] = -adjoint(T0)
            chain[6, 6] = -1.0
            chain[7, 7] = -gain
            bright = Brightness(gain, affine[host, 1], affine[target, 1], 1.0)
            equations = new_equations()
            for chunk in range(chunks):
                room = lanes_for(Room(rows[chunk], pixels[chunk], whole.places, LANES, whole.used), N - chunk * LANES)
                pair = (host, target, chunk * LANES)
                energy += linearise_pair(views, (T, T0), bright, pair, limit, noise, room, equations, system)
                add_cross(pair, room, equations.jacobians, chain, system)
            add_pair(host, target, chain, equations, system)
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
def host_rows(points, inv_depth, host, first, room):
    """Fill what some points of a host say of themselves; their inverse depth is a state, whose noise must not count a
    second time."""
    rows, pixels = room.points, room.pixels
    for n in range(min(room.lanes, inv_depth.shape[1] - first)):
        p = first + n
        d = inv_depth[host, p]
        rows[at.LIVE + n] = 1.0 if points.valid[host, p] and d > 1e-3 else 0.0
        rows[at.U + n], rows[at.V + n] = points.uv[host, p, 0], points.uv[host, p, 1]
        rows[at.D + n] = d
        rows[at.SLOPE_U + n], rows[at.SLOPE_V + n] = points.slope[host, p, 0], points.slope[host, p, 1]
        for k in range(room.used):
            row = at.PIXEL_ROWS * k + n
            pixels[at.VALUE + row] = points.patch[host, p, k]
            pixels[at.GRADIENT_U + row] = points.gradient[host, p, k, 0]
            pixels[at.GRADIENT_V + row] = points.gradient[host, p, k, 1]


@exact_kernel
def linearise_pair(views, poses, bright, pair, limit, noise, room, equations, system):
    """Some points of one host against one target, into the lanes' equations; rms into the system. The energy.

    poses: T_target_host (4, 4) where residuals are taken, and where Jacobians are; pair: host, target, first point.
    """
    host, target, first = pair
    slot, cam = views.slots[target], views.camera
    camera = (cam[0], cam[1], cam[2], cam[3])
    patch_sums(views.images[slot], camera, poses[0], bright, noise, room)
    rows, jacobians = room.points, equations.jacobians
    energy = 0.0
    for n in range(min(room.lanes, system.rms.shape[1] - first)):
        if rows[at.SEEN + n] == 0.0:
            continue
        point = sqrt(rows[at.SQUARES + n] / room.used)
        system.rms[host, first + n, target] = point
        if point > limit:
            energy += limit * limit * room.used
            rows[at.SEEN + n] = 0.0
        else:
            energy += rows[at.ENERGY + n]
    if noise.use_depth:
        energy += measure_depths(views.depths[slot], camera, 1.0, room, noise, jacobians)
    place_again(camera, poses[1], rows, room.lanes)
    forget_unseen(room)
    pose_jacobians(camera, room, jacobians)
    add_patches(room, equations)
    if noise.use_depth:
        add_depths(room, equations)
    depth_equations(poses[1], room, jacobians, noise.use_depth)
    return energy


@exact_kernel
def add_cross(pair, room, jacobians, chain, system):
    """What ties the inverse depths of some points to a pair of keyframes."""
    host, target, first = pair
    rows = room.points
    for n in range(min(room.lanes, system.rms.shape[1] - first)):
        if rows[at.SEEN + n] == 0.0:
            continue
        system.Hd[host, first + n] += jacobians[of.HD + n]
        system.bd[host, first + n] += jacobians[of.BD + n]
        cross = system.cross[host, first + n]
        for i in range(STEP):
            with_d = jacobians[of.CROSS + LANES * i + n]
            cross[STEP * target + i] += with_d
            for j in range(STEP):
                cross[STEP * host + j] += chain[i, j] * with_d


@exact_kernel
def add_pair(host, target, chain, equations, system):
    """The equations of a relative state as ones of two keyframes."""
    pair, pair_b = np.zeros((STEP, STEP)), np.zeros(STEP)
    add_up(equations.system, pair, pair_b)
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
def times(system, step, depth_step):
    """The matrix of a system times steps: of poses and brightness (8K,), of inverse depths (K, N).

    Not numpy's product, whose last bits depend on where its arrays lie.
    """
    n = system.H.shape[0]
    K, N = system.Hd.shape
    of_poses = np.zeros(n)
    of_depths = system.Hd * depth_step
    for i in range(n):
        of_poses[i] = dot(system.H[i], step)
    for k in range(K):
        for p in range(N):
            row, d = system.cross[k, p], depth_step[k, p]
            of_depths[k, p] += dot(row, step)
            for i in range(n):
                of_poses[i] += d * row[i]
    return of_poses, of_depths


@exact_kernel
def eliminate_depths(system):
    """Schur complement of the inverse depths, whose block is diagonal: (8K, 8K) and (8K,) of poses and brightness."""
    out = system.H.copy()
    rhs = system.b.copy()
    K, N = system.Hd.shape
    for k in range(K):
        for p in range(N):
            Hd = system.Hd[k, p]
            if Hd <= 0.0:
                continue
            row = system.cross[k, p]
            for other in range(K):
                start = STEP * other
                if row[start] == 0.0 and row[start + 1] == 0.0:
                    continue  # not seen there
                subtract_block(out, row, start, 1.0 / Hd)
                w = system.bd[k, p] / Hd
                for i in range(STEP):
                    rhs[start + i] -= w * row[start + i]
    for i in range(out.shape[0]):
        for j in range(i):
            out[i, j] = out[j, i]
    return out, rhs


@exact_kernel
def subtract_block(out, row, start, weight):
    """Subtract weight row^T row from out (n, n), eight rows of it from the diagonal on.

    Eight numbers are read before any is written: the compiler does them at once only if nothing can come between.
    """
    for block in range(start // STEP, out.shape[0] // STEP):
        c = STEP * block
        r0, r1, r2, r3 = row[c], row[c + 1], row[c + 2], row[c + 3]
        r4, r5, r6, r7 = row[c + 4], row[c + 5], row[c + 6], row[c + 7]
        for i in range(STEP):
            w = weight * row[start + i]
            o = out[start + i]
            o0, o1, o2, o3 = o[c] - w * r0, o[c + 1] - w * r1, o[c + 2] - w * r2, o[c + 3] - w * r3
            o4, o5, o6, o7 = o[c + 4] - w * r4, o[c + 5] - w * r5, o[c + 6] - w * r6, o[c + 7] - w * r7
            o[c], o[c + 1], o[c + 2], o[c + 3] = o0, o1, o2, o3
            o[c + 4], o[c + 5], o[c + 6], o[c + 7] = o4, o5, o6, o7
