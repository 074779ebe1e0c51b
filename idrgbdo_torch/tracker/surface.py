"""Where depth alone puts a frame: on the surface that a keyframe saw. It starts a search, and it speaks for its result.

Brightness leads home from some pixels away, and only where it stays what it was; a surface does from far, whatever the
light does, where it is no mere plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from ..frame import Frame
from ..kernels.se3 import inverse
from ..kernels.surface import LAST, align_surface, surface_planes
from ..measurement import Noise
from .backends import Backend
from .members import Members
from .tracking import Pair

Array = NDArray[np.float64]

ACROSS = 64  # planes in a row of the image
RADIUS = 3  # px, neighbourhood that a plane is fitted to
FEWEST = 100  # planes that are a surface
GATES = np.repeat([0.3, 0.15, 0.08, LAST], 5)  # share of its depth by which a point may be off its plane, step by step
HELD = np.array([1.0 / 0.5**2] * 3 + [1.0 / 0.3**2] * 3)  # information by which a guess holds what the surface does not
SHARE = 0.02  # of the information that counts: neighbouring planes err alike
ONE_SURFACE = 0.9  # share of the planes in view that agree, from which on both views see the same surface
SHAPED = 0.005  # share of the normals' squares in each direction; walls and floors have none without their noise
NEAREST = 1e-3  # m in front of the camera that a point is
MUCH = 0.4  # share of a keyframe's planes in view, from which on it is asked
MEDIAN = 2.0 * np.log(2.0)  # of the squared length of two independent normal numbers


@dataclass(frozen=True)
class Surface:
    """What a frame shows of the world's surface."""

    planes: Array  # (N, 6) of surface_planes()
    shaped: bool  # faces all directions, so that depth alone tells a pose


@dataclass(frozen=True)
class Laid:
    """A frame laid on the surface of a keyframe."""

    T_frame_kf: Array  # (4, 4)
    information: Array  # (6, 6) of a left increment, as far as it counts
    agree: float  # share of the planes in view that the frame's depth agrees with


def surface(frame: Frame, sigma: float) -> Surface:
    """That of a frame, which keeps it, as it may be looked at again. sigma: noise of a reading in 1/m."""
    kept: Surface | None = vars(frame).get("_surface")
    if kept is None:
        step = max(RADIUS, frame.depth.shape[1] // ACROSS)
        planes = surface_planes(frame.depth, camera_of(frame), step, RADIUS, sigma)
        kept = Surface(planes, len(planes) >= FEWEST and least_facing(planes[:, 3:]) > SHAPED)
        vars(frame)["_surface"] = kept  # beside its fields, as cached_property does
    return kept


def camera_of(frame: Frame) -> Array:
    """(4,) fx fy cx cy, to be written to: numba compiles anew for what is not."""
    return np.array(frame.intrinsics[0])


def least_facing(normals: Array) -> float:
    """Share of the squares of normals (N, 3) in the direction that fewest face, less their noise.

    That is known from neighbours, most of which lie on the same plane.
    """
    noise = np.median((np.diff(normals, axis=0) ** 2).sum(axis=1)) / (2.0 * MEDIAN)
    return float(np.linalg.eigvalsh(normals.T @ normals / len(normals))[0] - noise)


def lay(pair: Pair, guesses: Sequence[Array]) -> Laid | None:
    """The frame on the keyframe's surface, from the best of some guesses of T_frame_kf; None where that has none."""
    sigma = sqrt(pair.noise.var_depth)
    there = surface(pair.keyframe.frame, sigma).planes
    if len(there) < FEWEST:
        return None
    found = (
        align_surface(pair.frame.depth, camera_of(pair.frame), there, np.ascontiguousarray(T), HELD, sigma, GATES)
        for T in guesses
    )
    T, H, _, agree = max(found, key=lambda one: one[2] * one[3])  # of few planes in view all agree anywhere
    return Laid(T, SHARE * H, agree)


def lies_on_surface(pair: Pair, T_frame_kf: Array) -> bool:
    """Whether depth alone is sure of a pose (4, 4): both show the same surface there, of a shape that tells it.

    It is the shape of what both see: of a corner that the keyframe saw, the frame may see one wall.
    """
    there = surface(pair.keyframe.frame, sqrt(pair.noise.var_depth))
    if not there.shaped or on_surface(pair, T_frame_kf)[1] <= ONE_SURFACE:
        return False
    common = there.planes[in_view(there.planes[:, :3], T_frame_kf, pair.frame)]
    return len(common) >= FEWEST and least_facing(common[:, 3:]) > SHAPED


def in_view(points: Array, T_frame_kf: Array, frame: Frame) -> NDArray[np.bool_]:
    """(N,): the points (N, 3) in m of a keyframe in whose place a frame at a pose (4, 4) measures depth."""
    height, width = frame.depth.shape
    fx, fy, cx, cy = camera_of(frame)
    x, y, z = T_frame_kf[:3, :3] @ points.T + T_frame_kf[:3, 3:]
    out: NDArray[np.bool_] = z > NEAREST
    z = np.where(out, z, 1.0)
    u, v = np.floor(fx * x / z + cx + 0.5), np.floor(fy * y / z + cy + 0.5)
    out &= (u >= 0) & (v >= 0) & (u < width) & (v < height)
    out[out] = frame.depth[v[out].astype(np.int64), u[out].astype(np.int64)] > 0.0
    return out


def on_surface(pair: Pair, T_frame_kf: Array) -> tuple[float, float]:
    """Shares: of a keyframe's planes that the frame sees from a pose (4, 4), of those that its depth agrees with."""
    sigma = sqrt(pair.noise.var_depth)
    there, camera = surface(pair.keyframe.frame, sigma).planes, camera_of(pair.frame)
    T = np.ascontiguousarray(T_frame_kf)
    *_, seen, agree = align_surface(pair.frame.depth, camera, there, T, HELD, sigma, GATES[:0])
    return float(seen), float(agree)


def lies_on_all(frame: Frame, T_frame_world: Array, members: Members, noise: Noise, backend: Backend) -> bool:
    """Whether all keyframes of a window that see much of what a frame sees show it the same surface, two at least."""
    asked = 0
    for keyframe, T_kf_world in zip(members.keyframes, members.T, strict=True):
        seen, agree = on_surface(Pair(frame, keyframe, noise, backend), T_frame_world @ inverse(T_kf_world))
        if seen > MUCH:
            if agree < ONE_SURFACE:
                return False
            asked += 1
    return asked >= 2
