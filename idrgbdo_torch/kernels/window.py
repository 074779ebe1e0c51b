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
from .solver import multiply, put


@exact_kernel
def linearise_window(views, state, points, which, limit, noise, pairs):
    """Normal equations of pairs of keyframes: views Views, state WindowState, points WindowPoints; fills WindowPairs.

    which (K, K) bool: which hosts' points against which targets; the other pairs stay as they are. limit: of a point's
    rms.
    """
    T_cam_world, T_linear, affine = state.T, state.T_linear, state.affine
    K, N = state.inv_depth.shape
    chunks = (N + LANES - 1) // LANES
    whole = new_room(points.patch.shape[2], noise.pattern)
    rows = np.zeros((chunks, whole.points.shape[0]))
    pixels = np.zeros((chunks, whole.pixels.shape[0]), np.float32)
    for host in range(K):
        if not which[host].any():
            continue
        for chunk in range(chunks):
            room = Room(rows[chunk], pixels[chunk], whole.places, LANES, whole.used, whole.pattern)
            host_rows(points, state.inv_depth, host, chunk * LANES, room)
        for target in range(K):
            if target == host or not which[host, target]:
                continue
            T = multiply(T_cam_world[target], inverse(T_cam_world[host]))
            T0 = multiply(T_linear[target], inverse(T_linear[host]))
            gain = exp(affine[target, 0] - affine[host, 0])
            bright = Brightness(gain, affine[host, 1], affine[target, 1], 1.0)
            equations = new_equations()
            energy = 0.0
            for chunk in range(chunks):
                room = Room(rows[chunk], pixels[chunk], whole.places, LANES, whole.used, whole.pattern)
                room = lanes_for(room, N - chunk * LANES)
                pair = (host, target, chunk * LANES)
                energy += linearise_pair(views, (T, T0), bright, pair, limit, noise, room, equations, pairs)
                keep_points(pair, room, equations.jacobians, pairs)
            add_up(equations.system, pairs.H[host, target], pairs.b[host, target])
            pairs.energy[host, target] = energy
            chain = pairs.chain[host, target]
            chain[:] = 0.0
            on_pose = adjoint(T0)
            for i in range(6):
                for j in range(6):
                    chain[i, j] = -on_pose[i, j]
            chain[6, 6] = -1.0
            chain[7, 7] = -gain
            pairs.taken[host, target] = True
            put(T, pairs.at_T[host, target])
            put(affine[host], pairs.at_affine[host, target, 0])
            put(affine[target], pairs.at_affine[host, target, 1])
            put(state.inv_depth[host], pairs.at_inv_depth[host, target])


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
def linearise_pair(views, poses, bright, pair, limit, noise, room, equations, pairs):
    """Some points of one host against one target, into the lanes' equations; rms into the pairs. The energy.

    poses: T_target_host (4, 4) where residuals are taken, and where Jacobians are; pair: host, target, first point.
    """
    host, target, first = pair
    cam = views.camera
    camera = (cam[0], cam[1], cam[2], cam[3])
    patch_sums(views.images[target], camera, poses[0], bright, noise, room)
    rows, jacobians = room.points, equations.jacobians
    energy = 0.0
    rms = pairs.rms[host, target]
    for n in range(min(room.lanes, rms.shape[0] - first)):
        rms[first + n] = -1.0
        if rows[at.SEEN + n] == 0.0:
            continue
        point = sqrt(rows[at.SQUARES + n] / room.used)
        rms[first + n] = point
        if point > limit:
            energy += limit * limit * room.used
            rows[at.SEEN + n] = 0.0
        else:
            energy += rows[at.ENERGY + n]
    if noise.use_depth:
        energy += measure_depths(views.depths[target], camera, 1.0, room, noise, jacobians)
    place_again(camera, poses[1], rows, room.lanes)
    forget_unseen(room)
    pose_jacobians(camera, room, jacobians)
    add_patches(room, equations)
    if noise.use_depth:
        add_depths(room, equations)
    depth_equations(poses[1], room, jacobians, noise.use_depth)
    return energy


@exact_kernel
def keep_points(pair, room, jacobians, pairs):
    """What some points' inverse depths get from a pair of keyframes, and what ties them to it."""
    host, target, first = pair
    Hd, bd, cross = pairs.Hd[host, target], pairs.bd[host, target], pairs.cross[host, target]
    rows = room.points
    count = min(room.lanes, Hd.shape[0] - first)
    keep_row(rows[at.SEEN :], jacobians[of.HD :], Hd[first : first + count])
    keep_row(rows[at.SEEN :], jacobians[of.BD :], bd[first : first + count])
    for i in range(STEP):
        keep_row(rows[at.SEEN :], jacobians[of.CROSS + LANES * i :], cross[i][first : first + count])


@exact_kernel
def keep_row(seen, row, out):
    """Fill the numbers of the points that are seen, 0 for the others."""
    for n in range(out.shape[0]):
        out[n] = row[n] if seen[n] != 0.0 else 0.0
