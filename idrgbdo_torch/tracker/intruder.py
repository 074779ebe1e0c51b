"""Something moves in front of the view: which points it hides, and which points of a new keyframe are its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ..frame import Frame, Keyframe
from ..kernels.se3 import inverse
from ..measurement import IN_FRONT, Points

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]
Window = dict[int, tuple[Keyframe, Array]]  # keyframes by number, with T_kf_world (4, 4)

AROUND = ((0, 0), (-4, 0), (4, 0), (0, -4), (0, 4))  # px, where the depth about a point must all say the same
MOST_AROUND = 3  # of these, of which none may say the contrary
OF_IT = 0.1  # share of a surface that intrudes, from which on all of it does, as far as it is not known to stand
INTRUDERS = 0.03  # share of a keyframe's points that stand where was nothing, from which on they are left out
LEFT = 0.2  # share of its points that must be left
STEP = 4  # px between the pixels that are looked at to outline an intruder
MARGIN = 12  # px by which its outline is widened
FAR_M = 1e3  # m, farther than anything
BLOCKED = 0.15  # share of the image that an intruder fills, from which on nothing new begins on it


def some_views(window: Window, T_frame_world: Array) -> list[tuple[Array, Frame]]:
    """The newest, a middle and the oldest keyframe of a window, with T_kf_frame (4, 4) of a frame."""
    known, T_world_frame = list(window.values()), inverse(T_frame_world)
    some = [known[k] for k in sorted({len(known) - 1, len(known) // 2, 0})]
    return [(T @ T_world_frame, keyframe.frame) for keyframe, T in some]


def placed(uv: Array, inv_depth: Array, T_frame_kf: Array, frame: Frame) -> tuple[Mask, Index, Index, Array]:
    """Where points of a keyframe, (N, 2) px and (N,) 1/m, fall in a frame: whether inside, column, row, depth (m)."""
    fx, fy, cx, cy = frame.intrinsics[0]
    z = 1.0 / np.maximum(inv_depth, 1e-9)
    P = np.column_stack([(uv[:, 0] - cx) / fx * z, (uv[:, 1] - cy) / fy * z, z])
    P = P @ T_frame_kf[:3, :3].T + T_frame_kf[:3, 3]
    ahead = (inv_depth > 0.0) & (P[:, 2] > 1e-3)
    z = np.where(ahead, P[:, 2], 1.0)
    u, v = np.rint(fx * P[:, 0] / z + cx), np.rint(fy * P[:, 1] / z + cy)
    height, width = frame.depth.shape
    ahead &= (u >= 0) & (v >= 0) & (u < width) & (v < height)
    return ahead, np.where(ahead, u, 0).astype(np.int64), np.where(ahead, v, 0).astype(np.int64), z


def hidden(points: Points, T_frame_kf: Array, frame: Frame) -> Mask:
    """(N,): the keyframe's points that a frame at this pose (4, 4) sees something clearly nearer in place of."""
    inside, u, v, z = placed(points.uv, points.inv_depth, T_frame_kf, frame)
    there = frame.depth[v, u]
    out: Mask = inside & (there > 0.0) & (there * (1.0 + IN_FRONT) < z)
    return out


def intruding(uv: Array, inv_depth: Array, T_before_kf: Array, before: Frame) -> tuple[Mask, Mask]:
    """Of points of a new keyframe, (N,) each: those that stand where the one before, at this pose (4, 4), saw through
    or saw an intruder itself, all around; and those that it saw too.
    """
    inside, u, v, z = placed(uv, inv_depth, T_before_kf, before)
    height, width = before.depth.shape
    foreign, contrary = np.zeros(len(z), np.int64), ~inside
    for du, dv in AROUND:
        there = before.depth[(v + dv).clip(0, height - 1), (u + du).clip(0, width - 1)]
        not_it = (there > z * (1.0 + IN_FRONT)) | ((there < 0.0) & (z < -there * (1.0 + IN_FRONT)))
        foreign += not_it
        contrary |= (there > 0.0) & ~not_it
    same = inside & (np.abs(before.depth[v, u] - z) < IN_FRONT * z)
    return (foreign >= MOST_AROUND) & ~contrary, same


def without_intruder(keyframe: Keyframe, window: Window, T_kf_world: Array) -> Keyframe | None:
    """A new keyframe without the points that stand where keyframes of a window saw nothing.

    They belong to something that moved there, which must not be taken for the world. Its depth becomes negative, so
    that no one measures it, and the next keyframe knows it again. The same keyframe where such points are too few to
    be more than borders and noise, None where they leave too little of it.
    """
    points, frame = keyframe.points, keyframe.frame
    others = some_views(window, T_kf_world)
    foreign, _ = by_any(points.uv, points.inv_depth, others)
    if foreign.sum() <= INTRUDERS * len(foreign):  # nor where there are no points at all
        return keyframe
    outline = outlined(frame, others)
    about = cv2.dilate(outline, np.ones((2 * MARGIN + 1, 2 * MARGIN + 1), np.uint8)) > 0
    u, v = points.uv.astype(np.int64).T
    own = ~(foreign | about[v, u])
    if own.mean() < LEFT:
        return None
    stays = only(keyframe, own)
    depth = np.where(outline > 0, -frame.depth, np.where(about, np.float32(0.0), frame.depth))
    return replace(stays, frame=replace(frame, depth=depth), intruded=True)


def by_any(uv: Array, inv_depth: Array, others: Sequence[tuple[Array, Frame]]) -> tuple[Mask, Mask]:
    """intruding() by any of several, and seen by any of them where none says intruding."""
    foreign, seen = np.zeros(len(uv), np.bool_), np.zeros(len(uv), np.bool_)
    for T, other in others:
        intrudes, same = intruding(uv, inv_depth, T, other)
        foreign |= intrudes
        seen |= same
    return foreign, seen & ~foreign


def blocked(frame: Frame, window: Window, T_frame_world: Array) -> bool:
    """Whether something that a window's keyframes did not see there fills much of a frame's view."""
    return bool(outlined(frame, some_views(window, T_frame_world)).mean() > BLOCKED)


def outlined(frame: Frame, others: Sequence[tuple[Array, Frame]]) -> NDArray[np.uint8]:
    """(H, W), 1 where a frame sees what others, each at T_other_frame (4, 4), did not see there; and the rest of that
    surface, as far as they do not know it.
    """
    height, width = frame.depth.shape
    v, u = (x.ravel() for x in np.mgrid[0:height:STEP, 0:width:STEP])
    z = frame.depth[v, u].astype(np.float64)
    inv_depth = np.divide(1.0, z, out=np.zeros_like(z), where=z > 0.0)
    foreign, seen = by_any(np.column_stack([u, v]).astype(np.float64), inv_depth, others)
    size = -(-height // STEP), -(-width // STEP)
    depth = z.reshape(size)
    farthest = cv2.dilate(depth, np.ones((3, 3), np.uint8))
    nearest = cv2.erode(np.where(depth > 0.0, depth, FAR_M), np.ones((3, 3), np.uint8))
    coarse = cv2.morphologyEx(foreign.reshape(size).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    smooth = farthest < (1.0 + IN_FRONT / 2.0) * nearest
    unknown = (depth > 0.0) & ~seen.reshape(size) & smooth
    count, surface = cv2.connectedComponents((unknown | (coarse > 0)).astype(np.uint8), connectivity=4)
    of_it = np.bincount(surface.ravel(), coarse.ravel(), count) >= OF_IT * np.bincount(surface.ravel(), None, count)
    of_it[0] = False
    whole = (of_it[surface] | (coarse > 0)).astype(np.uint8)
    out: NDArray[np.uint8] = cv2.resize(whole, (width, height), interpolation=cv2.INTER_NEAREST)
    return out


def only(keyframe: Keyframe, mask: Mask) -> Keyframe:
    """A keyframe reduced to some of its points (N,)."""
    points, place = keyframe.points, np.cumsum(mask) - 1
    fewer = Points(
        points.uv[mask], points.inv_depth[mask], points.var_inv_depth[mask],
        np.ascontiguousarray(points.patch[:, mask]), np.ascontiguousarray(points.gradient[:, mask]), points.slope[mask],
    )  # fmt: skip
    return replace(
        keyframe, points=fewer, measured=keyframe.measured[mask], measured_variance=keyframe.measured_variance[mask],
        radius=keyframe.radius[mask], coarse=place[keyframe.coarse[mask[keyframe.coarse]]],
        witnesses=place[keyframe.witnesses[mask[keyframe.witnesses]]],
    )  # fmt: skip
