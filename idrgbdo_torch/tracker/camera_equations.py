"""What two keyframes say of the camera: one keyframe's points in the image and the depth of the other, linear about
what the camera is said to be.

Once for a new keyframe, so numpy over all points at once is fast enough and there is no compiled twin. The unknowns are
    pose and brightness of the pair [v, w, a, b], which are eliminated,
    the camera's (see UNKNOWNS), which are what is asked for,
    and each point's inverse depth, which is eliminated first; the sensor's value of it is one more measurement.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from ..definitions.camera import Pinhole
from ..definitions.convert import inverse_of_depth
from ..definitions.image import sample_surface, sample_with_gradient
from ..frame import Frame, Keyframe
from ..measurement import FLOOR, OTHER_SURFACE, PATTERNS, STEP, WIDE, Noise
from .backends import Backend
from .candidates import PLANE_RADIUS
from .instant import flow

Array = NDArray[np.float64]

UNKNOWNS = ("focal", "center_u", "center_v", "growth", "delay", "readout", "shift_u", "shift_v", "depth_readout")
"""Of the camera: logarithm of a factor on fx and fy; px added to the principal point; growth of the depth, 1/m, as
camera.toml has it; by how much later than said the depth is taken, and how much longer than said a readout lasts, s;
by how many px the depth lies too far to the right and too low; how long the depth image's own readout lasts, s."""
FOCAL, CENTER_U, CENTER_V, GROWTH, DELAY, READOUT, SHIFT_U, SHIFT_V, DEPTH_READOUT, DEPTH = range(STEP, STEP + 10)
COLUMNS = STEP + 10  # of a Jacobian
EVERY = 2  # witnesses for one that is used: 128 spread over the image
LEAST_AREA = 0.05  # of a host's pixel in the target: anything less is seen edge-on
LEAST_KEPT = 0.5  # share of the points that must agree, or the pair says nothing


@dataclass(frozen=True)
class Moving:
    """A keyframe and how it moved when it was taken."""

    keyframe: Keyframe
    velocity: Array  # (6,) [v, w] as Motion.velocity has it, m/s and rad/s


class Says(NamedTuple):
    """Normal equations of the camera's unknowns, about what it is said to be."""

    information: Array  # (9, 9)
    vector: Array  # (9,)


class Hosted(NamedTuple):
    """Points of the host, N of them."""

    uv: Array  # (N, 2) px from the principal point
    x: Array  # (N,) at depth 1
    y: Array
    d: Array  # 1/m, as the sensor has it
    variance: Array
    slope: Array  # (N, 2) 1/m per px
    patch: Array  # (N, P)
    gradient: Array  # (N, P, 2)
    flow: tuple[Array, Array, Array]  # px/s right and down, relative change of depth in 1/s
    late: Array  # of the readout that has passed when a point's row is seen, from the middle row on


class Placed(NamedTuple):
    """The same points in the target."""

    x: Array  # (N,) at depth 1
    y: Array
    z: Array  # depth over that in the host
    rho: Array  # 1/m
    warp: tuple[Array, Array, Array, Array]  # du/du, du/dv, dv/du, dv/dv of target by host
    area: Array
    along: tuple[Array, Array]  # px m, how they move with the host's inverse depth
    slope: Array  # (N, 2) 1/m per px of the target, of the plane that is fitted in the host
    live: NDArray[np.bool_]


def pair_says(host: Moving, target: Moving, T: Array, noise: Noise, backend: Backend) -> Says | None:
    """The camera's normal equations from a pair of keyframes at T = T_target_host (4, 4); None where it says nothing.

    The pose need not be the best: one step of Gauss-Newton from it is part of the elimination.
    """
    camera = target.keyframe.frame.camera
    points = hosted(host, camera, noise, backend)
    if len(points.d) < STEP:
        return None
    placed = placed_in_target(points, T, camera)
    J = jacobians(points, placed, T, target.velocity, camera)
    patches = patch_equations(points, placed, T, target.keyframe.frame, noise, backend)
    if patches is None:
        return None
    G, c, kept = patches
    r, w, Jz = depth_rows(points, placed, T, J, target, noise, kept)
    J0 = np.zeros((len(kept), COLUMNS))  # the sensor's own inverse depth
    right, down, approach = points.flow
    along_slope = points.slope[:, 0] * right + points.slope[:, 1] * down
    J0[:, DEPTH], J0[:, GROWTH] = 1.0, 1.0
    J0[:, SHIFT_U], J0[:, SHIFT_V] = -points.slope[:, 0], -points.slope[:, 1]
    J0[:, DELAY], J0[:, READOUT] = -(along_slope + points.d * approach), points.late * along_slope
    J0[:, DEPTH_READOUT] = points.late * J0[:, DELAY]
    w0 = kept / points.variance

    GJ = G @ J
    H = J.reshape(-1, COLUMNS).T @ GJ.reshape(-1, COLUMNS) + (w[:, None] * Jz).T @ Jz + (w0[:, None] * J0).T @ J0
    b = np.einsum("nij,ni->j", J, c) - (w * r) @ Jz
    of_depth = (J[:, None, :, DEPTH] @ GJ)[:, 0] + (w * Jz[:, DEPTH])[:, None] * Jz + w0[:, None] * J0
    b_depth = (J[:, :, DEPTH] * c).sum(1) - w * r * Jz[:, DEPTH]
    share = of_depth[:, :DEPTH] / np.where(kept, of_depth[:, DEPTH], np.inf)[:, None]
    H = H[:DEPTH, :DEPTH] - share.T @ of_depth[:, :DEPTH]
    b = b[:DEPTH] - b_depth @ share
    own = np.linalg.solve(H[:STEP, :STEP] + FLOOR * np.eye(STEP), np.column_stack([H[:STEP, STEP:], b[:STEP]]))
    information = H[STEP:, STEP:] - H[STEP:, :STEP] @ own[:, :-1]
    vector = b[STEP:] - H[STEP:, :STEP] @ own[:, -1]
    if not (np.isfinite(information).all() and np.isfinite(vector).all()):
        return None
    return Says(0.5 * (information + information.T), vector)


def hosted(host: Moving, camera: Pinhole, noise: Noise, backend: Backend) -> Hosted:
    """The points of a keyframe that are spread over its image."""
    keyframe = host.keyframe
    which = keyframe.witnesses[::EVERY]
    which = which[keyframe.measured[which] > 1e-3]
    points = keyframe.points
    uv, d = points.uv[which], keyframe.measured[which].astype(np.float64)
    slope = backend.planes_at(keyframe.frame.depth, uv, PLANE_RADIUS, float(np.sqrt(noise.var_depth)))[2]
    from_centre = uv - [camera.cx, camera.cy]
    x, y = from_centre[:, 0] / camera.fx, from_centre[:, 1] / camera.fy
    patch, gradient = (part[0, which].astype(np.float64) for part in (points.patch, points.gradient))
    variance = keyframe.measured_variance[which].astype(np.float64)
    moves = flow(camera, x, y, d, host.velocity)
    return Hosted(from_centre, x, y, d, variance, slope, patch, gradient, moves, lateness(uv[:, 1], camera))


def lateness(v: Array, camera: Pinhole) -> Array:
    """Part of the readout between the middle row and rows v."""
    out: Array = (v + 0.5) / camera.height - 0.5
    return out


def placed_in_target(points: Hosted, T: Array, camera: Pinhole) -> Placed:
    """Where the points are in the target, and how their surroundings are distorted there."""
    fx, fy = camera.fx, camera.fy
    R, t = T[:3, :3], T[:3, 3]
    q = np.column_stack([points.x, points.y, np.ones_like(points.x)]) @ R.T + points.d[:, None] * t
    ahead = q[:, 2] > 1e-3
    z = np.where(ahead, q[:, 2], 1.0)
    x, y = q[:, 0] / z, q[:, 1] / z
    warp = (
        (R[0, 0] - x * R[2, 0]) / z, (R[0, 1] - x * R[2, 1]) / z * (fx / fy),
        (R[1, 0] - y * R[2, 0]) / z * (fy / fx), (R[1, 1] - y * R[2, 1]) / z,
    )  # fmt: skip
    area = warp[0] * warp[3] - warp[1] * warp[2]
    live = ahead & (area > LEAST_AREA)
    along = fx * (t[0] - x * t[2]) / z, fy * (t[1] - y * t[2]) / z
    # a plane is n . P = 1, and n . (x, y, 1) the inverse depth along it
    n_u, n_v = points.slope.T
    n = np.column_stack([fx * n_u, fy * n_v, points.d - n_u * points.uv[:, 0] - n_v * points.uv[:, 1]]) @ R.T
    slope = n[:, :2] / (1.0 + n @ t)[:, None] / [fx, fy]
    return Placed(x, y, z, points.d / z, warp, np.where(live, area, 1.0), along, slope, live)


def jacobians(points: Hosted, placed: Placed, T: Array, velocity: Array, camera: Pinhole) -> Array:
    """(N, 4, 18) of a point's place [u, v] in the target's image, and of the brightness [a, b], by all unknowns.

    A camera file that is wrong moves a point twice: where it is taken to be in the world, and where that is seen. An
    image whose rows are late shows it further along its flow, in both images.
    """
    fx, fy = camera.fx, camera.fy
    x, y, rho = placed.x, placed.y, placed.rho
    uu, uv, vu, vv = placed.warp
    J = np.zeros((len(x), 4, COLUMNS))
    u, v = J[:, 0], J[:, 1]
    u[:, 0], u[:, 2], u[:, 3], u[:, 4], u[:, 5] = fx * rho, -fx * rho * x, -fx * x * y, fx * (1 + x * x), -fx * y
    v[:, 1], v[:, 2], v[:, 3], v[:, 4], v[:, 5] = fy * rho, -fy * rho * y, -fy * (1 + y * y), fy * x * y, fy * x
    J[:, 2, 6] = J[:, 3, 7] = 1.0
    from_u, from_v = points.uv.T
    u[:, FOCAL], v[:, FOCAL] = fx * x - uu * from_u - uv * from_v, fy * y - vu * from_u - vv * from_v
    u[:, CENTER_U], v[:, CENTER_U] = 1 - uu, -vu
    u[:, CENTER_V], v[:, CENTER_V] = -uv, 1 - vv
    right, down, _ = flow(camera, x, y, rho, velocity)
    late = lateness(fy * y + camera.cy, camera)
    back_u, back_v = points.late * points.flow[0], points.late * points.flow[1]
    u[:, READOUT] = late * right - uu * back_u - uv * back_v
    v[:, READOUT] = late * down - vu * back_u - vv * back_v
    u[:, DEPTH], v[:, DEPTH] = placed.along
    return J


def patch_equations(
    points: Hosted, placed: Placed, T: Array, frame: Frame, noise: Noise, backend: Backend
) -> tuple[Array, Array, NDArray[np.bool_]] | None:
    """What the patches say of [u, v, a, b]: G (N, 4, 4), c (N, 4), and which points were kept; None if too few."""
    camera, R, offsets = frame.camera, T[:3, :3], PATTERNS[noise.pattern]
    nearer = points.slope @ offsets.T if noise.pattern == WIDE else 0.0  # 1/m: a compact patch is as far as its centre
    q = [
        (of * placed.z)[:, None] + offsets @ (R[row, :2] / [camera.fx, camera.fy]) + T[row, 3] * nearer
        for row, of in enumerate((placed.x, placed.y, np.ones_like(placed.x)))
    ]
    z = np.maximum(q[2], 1e-3)
    uv = np.stack([camera.fx * q[0] / z + camera.cx, camera.fy * q[1] / z + camera.cy], axis=-1)
    image = torch.from_numpy(frame.images[0])
    value, slope, inside = (x.numpy() for x in sample_with_gradient(image, torch.from_numpy(uv)))
    right, down = slope[..., 0], slope[..., 1]
    seen = placed.live & inside.all(1)
    if seen.sum() < max(LEAST_KEPT * len(seen), STEP):
        return None
    gain = float(value[seen].std() / max(float(points.patch[seen].std()), 1e-6))
    shown = gain * points.patch
    r = value - shown - float(value[seen].mean() - shown[seen].mean())
    uu, uv, vu, vv = (part[:, None] for part in placed.warp)
    size = gain / placed.area[:, None]  # the host's gradient as the target would show it
    host_u = size * (vv * points.gradient[..., 0] - vu * points.gradient[..., 1])
    host_v = size * (uu * points.gradient[..., 1] - uv * points.gradient[..., 0])
    h = np.exp(np.minimum(noise.c_h * (placed.area - 1.0) ** 2, 4.0))[:, None]
    variance = h * (noise.var_intensity + noise.var_pixel * (host_u**2 + host_v**2))
    moved = host_u * placed.along[0][:, None] + host_v * placed.along[1][:, None]  # by an error of the inverse depth
    s = np.abs(r) / np.sqrt(variance + h * noise.shared * moved**2 * points.variance[:, None])
    rms = np.sqrt((s * s).mean(1))
    scale = backend.robust_scale(rms[seen])
    kept = seen & (rms <= noise.outlier * scale)
    if kept.sum() < max(LEAST_KEPT * len(kept), STEP):
        return None
    w = kept[:, None] * np.minimum(1.0, noise.huber * scale / np.maximum(s, 1e-9)) / (variance * scale**2)
    blend = noise.gradient_blend
    rows = np.stack(
        [
            (1 - blend) * right + blend * host_u,
            (1 - blend) * down + blend * host_v,
            -shown,
            np.full_like(r, -1.0),
        ],
        axis=1,
    )
    weighted = rows * w[:, None]
    return weighted @ rows.transpose(0, 2, 1), -(weighted @ r[..., None])[..., 0], kept


def depth_rows(
    points: Hosted, placed: Placed, T: Array, J: Array, target: Moving, noise: Noise, kept: NDArray[np.bool_]
) -> tuple[Array, Array, Array]:
    """r (N,), weight (N,) and J (N, 18) of the target's inverse depths against those that the points have there.

    The depth image has a readout of its own, which is none unless it is asked for.
    """
    camera = target.keyframe.frame.camera
    u, v = camera.fx * placed.x + camera.cx, camera.fy * placed.y + camera.cy
    measured, on_surface = surface_at(target.keyframe.frame.depth, u, v)
    x, y, z, rho, t = placed.x, placed.y, placed.z, placed.rho, T[:3, 3]
    slope_u, slope_v = placed.slope.T
    right, down, approach = flow(camera, x, y, rho, target.velocity)
    late = lateness(v, camera)
    Jz = slope_u[:, None] * J[:, 0] + slope_v[:, None] * J[:, 1]
    Jz[:, READOUT] -= late * (slope_u * right + slope_v * down)
    # what moves in the host moves away by the last row of R
    to_u, to_v = T[2, 0] / camera.fx * rho / z, T[2, 1] / camera.fy * rho / z
    Jz[:, 2] += rho * rho
    Jz[:, 3] += rho * y
    Jz[:, 4] -= rho * x
    Jz[:, FOCAL] -= to_u * points.uv[:, 0] + to_v * points.uv[:, 1]
    Jz[:, CENTER_U] -= to_u
    Jz[:, CENTER_V] -= to_v
    Jz[:, READOUT] -= points.late * (to_u * points.flow[0] + to_v * points.flow[1])
    stretch = (1.0 - rho * t[2]) / z
    Jz[:, DEPTH] -= stretch
    Jz[:, GROWTH] -= 1.0
    Jz[:, SHIFT_U] += slope_u
    Jz[:, SHIFT_V] += slope_v
    later = slope_u * right + slope_v * down + rho * approach
    Jz[:, DELAY] += later
    Jz[:, DEPTH_READOUT] += late * later
    variance = noise.var_depth + noise.var_pixel * (slope_u**2 + slope_v**2)
    r = np.where(on_surface, measured - rho, 0.0)
    s = np.abs(r) / np.sqrt(variance + stretch**2 * points.variance)
    used = kept & on_surface & (s < OTHER_SURFACE * noise.huber)
    return r, used * np.minimum(1.0, noise.huber / np.maximum(s, 1e-9)) / variance, Jz


def surface_at(depth: NDArray[np.float32], u: Array, v: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Inverse depths (N,) at pixels of a depth image (H, W), and where they are valid; few of its pixels are needed."""
    height, width = depth.shape
    left = np.clip(np.floor(u), 0, width - 2).astype(np.int64)
    top = np.clip(np.floor(v), 0, height - 2).astype(np.int64)
    cells = depth[top[:, None, None] + [[0], [1]], left[:, None, None] + [[0, 1]]]
    uv = torch.from_numpy(np.column_stack([u - left, v - top]))
    value, _, valid = sample_surface(inverse_of_depth(cells), uv)
    return value.numpy(), valid.numpy()
