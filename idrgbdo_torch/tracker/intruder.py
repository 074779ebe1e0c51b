"""Something moves in front of the view: which points it hides, and which points of a new keyframe are its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ..frame import Frame, Keyframe
from ..measurement import IN_FRONT, Points

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

AROUND = ((0, 0), (-4, 0), (4, 0), (0, -4), (0, 4))  # px, where the depth about a point must all say the same
INTRUDERS = 0.03  # share of a keyframe's points that stand where was nothing, from which on they are left out
STEP = 4  # px between the pixels that are looked at to outline an intruder
MARGIN = 3  # such steps by which its outline is widened


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


def intruding(uv: Array, inv_depth: Array, T_before_kf: Array, before: Frame) -> Mask:
    """(N,): points of a new keyframe that stand where the one before, at this pose (4, 4), saw through, all around, or
    saw an intruder itself.
    """
    inside, u, v, z = placed(uv, inv_depth, T_before_kf, before)
    height, width = before.depth.shape
    through, of_it = inside.copy(), inside.copy()
    for du, dv in AROUND:
        there = before.depth[(v + dv).clip(0, height - 1), (u + du).clip(0, width - 1)]
        through &= there > z * (1.0 + IN_FRONT)
        of_it &= (there < 0.0) & (z < -there * (1.0 + IN_FRONT))
    return through | of_it


def without_intruder(keyframe: Keyframe, others: Sequence[tuple[Array, Frame]]) -> Keyframe:
    """A new keyframe without the points that stand where others, each at T_other_kf (4, 4), saw nothing.

    They belong to something that moved there, which must not be taken for the world. Its depth becomes negative, so
    that no one measures it, and the next keyframe knows it again. The same keyframe where such points are too few to
    be more than borders and noise.
    """
    points, frame = keyframe.points, keyframe.frame
    foreign = np.zeros(len(points.uv), np.bool_)
    for T, other in others:
        foreign |= intruding(points.uv, points.inv_depth, T, other)
    if foreign.mean() <= INTRUDERS:
        return keyframe
    outline = outlined(frame, others)
    u, v = points.uv.astype(np.int64).T
    stays = only(keyframe, ~(foreign | outline[v, u]))
    depth = np.where(outline, -np.abs(frame.depth), frame.depth)
    return replace(stays, frame=replace(frame, depth=depth))


def outlined(frame: Frame, others: Sequence[tuple[Array, Frame]]) -> Mask:
    """(H, W): where a frame sees what others, each at T_other_frame (4, 4), did not see there."""
    height, width = frame.depth.shape
    v, u = (x.ravel() for x in np.mgrid[0:height:STEP, 0:width:STEP])
    z = frame.depth[v, u].astype(np.float64)
    inv_depth = np.divide(1.0, z, out=np.zeros_like(z), where=z > 0.0)
    foreign = np.zeros(len(z), np.bool_)
    for T, other in others:
        foreign |= intruding(np.column_stack([u, v]).astype(np.float64), inv_depth, T, other)
    coarse = foreign.reshape(-(-height // STEP), -(-width // STEP)).astype(np.uint8)
    coarse = cv2.morphologyEx(coarse, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    coarse = cv2.dilate(coarse, np.ones((2 * MARGIN + 1, 2 * MARGIN + 1), np.uint8))
    whole = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_NEAREST)
    return whole.astype(np.bool_)


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
