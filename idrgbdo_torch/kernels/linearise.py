"""Normal equations of a frame against a keyframe: the fused twin of photometric.py."""

from __future__ import annotations

from math import exp, sqrt

import numpy as np

from ..measurement import COMPACT, PIXELS
from . import patch as at
from .compiled import exact_kernel
from .equations import add_depths, add_patches, add_up, measure_depths, new_equations, pose_jacobians
from .patch import LANES, Brightness, forget_unseen, lanes_for, new_room, patch_sums


@exact_kernel
def linearise(view, level, points, subset, state, scale, limit, noise, system):
    """Normal equations of one level at one pose.

    view: View; subset: the points and pixels that count; state: State. scale: robust scale of the whitened residuals;
    limit: saturation of a point's rms in units of scale. Fills system: System. Where the subset has no weights they are
    not even compiled.
    Returns (energy, points seen, points within the limit).
    """
    image, cam = view.images[level], view.cameras[level]
    camera = (cam[0], cam[1], cam[2], cam[3])
    index, count = subset.which, subset.pixels
    rms = system.rms
    bright = Brightness(exp(state.affine[0]), 0.0, state.affine[1], 1.0 / (scale * scale))
    whole = new_room(count, noise.pattern if level == 0 else COMPACT)
    equations = new_equations()
    weights = new_weights(subset.weight)
    energy = 0.0
    seen = 0
    kept = 0
    for first in range(0, index.shape[0], LANES):
        room = lanes_for(whole, index.shape[0] - first)
        host_rows(points, index, first, level, room)
        host_weights(subset.weight, index, first, room, weights)
        patch_sums(image, camera, state.T, bright, noise, room, weights)
        rows = room.points
        for n in range(min(room.lanes, index.shape[0] - first)):
            rms[first + n] = -1.0
            if rows[at.SEEN + n] == 0.0:
                continue
            seen += 1
            point = sqrt(rows[at.SQUARES + n] / count)
            rms[first + n] = point * scale
            if point > limit:
                energy += limit * limit * count
                rows[at.SEEN + n] = 0.0
                continue
            kept += 1
            energy += rows[at.ENERGY + n]
        forget_unseen(room)
        pose_jacobians(camera, room, equations.jacobians)
        add_patches(room, equations)
        if noise.use_depth:
            energy += measure_depths(view.depth, camera, 0.5**level, room, noise, equations.jacobians, weights)
            add_depths(room, equations)
    add_up(equations.system, system.H, system.b)
    return energy, seen, kept


@exact_kernel
def host_rows(points, index, first, level, room):
    """Fill what a keyframe's points, some of index from first, say of themselves on a level."""
    rows, pixels = room.points, room.pixels
    size = 0.5**level
    for n in range(room.lanes):
        rows[at.LIVE + n] = 1.0 if first + n < index.shape[0] else 0.0
        p = index[min(first + n, index.shape[0] - 1)]
        rows[at.U + n] = (points.uv[p, 0] + 0.5) * size - 0.5
        rows[at.V + n] = (points.uv[p, 1] + 0.5) * size - 0.5
        rows[at.D + n] = points.inv_depth[p]
        rows[at.VAR_D + n] = points.var_inv_depth[p]
        # a patch of a coarse level is larger than what is known to be plane
        rows[at.SLOPE_U + n] = points.slope[p, 0] if level == 0 else 0.0
        rows[at.SLOPE_V + n] = points.slope[p, 1] if level == 0 else 0.0
        for k in range(room.used):
            row = at.PIXEL_ROWS * k + n
            pixels[at.VALUE + row] = points.patch[level, p, k]
            pixels[at.GRADIENT_U + row] = points.gradient[level, p, k, 0]
            pixels[at.GRADIENT_V + row] = points.gradient[level, p, k, 1]


@exact_kernel
def new_weights(weight):
    """Room for the weights of LANES points, if there are any: a row a pixel, then their mean."""
    if weight is None:
        return None
    return np.ones(LANES * (PIXELS + 1))


@exact_kernel
def host_weights(weight, index, first, room, weights):
    """Fill the weights of some points of index from first, if there are any."""
    if weight is None:
        return
    for n in range(room.lanes):
        p = index[min(first + n, index.shape[0] - 1)]
        total = 0.0
        for k in range(PIXELS):
            weights[LANES * k + n] = weight[p, k]
            total += weight[p, k]
        weights[LANES * PIXELS + n] = total / PIXELS
