"""Something moves in front of the view: which points it hides, and which points of a new keyframe are its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..frame import Frame, Keyframe
from ..kernels.se3 import inverse
from ..measurement import IN_FRONT, Points
from .glances import FEWEST_KNOWN, STEP, Looked, Sight, fallen, look, moved, sight
from .keyframe import only
from .verification import LIMITS

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]
Window = dict[int, tuple[Keyframe, Array]]  # keyframes by number, with T_kf_world (4, 4)

OF_IT = 0.1  # share of a surface that intrudes, from which on all of it does, as far as it is not known to stand
MOST_OF_IT = 0.8  # share of what is known of one, from which on what was seen of it before is no part of the world
SLOPE = 3.0  # gray levels/px, from which on a pixel is texture: what has none never changes
STRONG = 6.0  # and where it has enough to look otherwise two pixels beside
FEW = 8  # points that may look otherwise by chance
SUSPECT = 0.25  # share of a surface that came into view and looks otherwise, from which on it is a stranger,
LOOKED_INTO = 0.1  # and share of all points that did, from which on that is looked into
INTRUDERS = 0.03  # share of a keyframe's points that stand where was nothing, from which on they are left out
LEFT = 0.2  # share of its points that must be left
MARGIN = 12  # px by which its outline is widened
FAR_M = 1e3  # m, farther than anything
BLOCKED = 0.15  # share of the image that an intruder fills, from which on nothing new begins on it


def some_views(window: Window, T_frame_world: Array) -> list[Sight]:
    """What the newest, a middle and the oldest keyframe of a window saw, from a frame at this pose (4, 4)."""
    known, T_world_frame = list(window.values()), inverse(T_frame_world)
    some = [known[k] for k in sorted({len(known) - 1, len(known) // 2, 0})]
    return [sight(keyframe.frame, T @ T_world_frame) for keyframe, T in some]


def placed(uv: Array, inv_depth: Array, T_frame_kf: Array, frame: Frame) -> tuple[Mask, Index, Index, Array]:
    """Where points of a keyframe, (N, 2) px and (N,) 1/m, fall in a frame: whether inside, column, row, depth (m)."""
    return fallen(uv, inv_depth, frame.intrinsics[0], sight(frame, T_frame_kf))


def hidden(points: Points, T_frame_kf: Array, frame: Frame) -> Mask:
    """(N,): the keyframe's points that a frame at this pose (4, 4) sees something clearly nearer in place of."""
    inside, u, v, z = placed(points.uv, points.inv_depth, T_frame_kf, frame)
    there = frame.depth[v, u]
    out: Mask = inside & (there > 0.0) & (there * (1.0 + IN_FRONT) < z)
    return out


def looks(uv: Array, inv_depth: Array, intrinsics: Array, others: Sequence[Sight]) -> list[Looked]:
    """Points of a frame, (N, 2) px and (N,) 1/m, in several sights."""
    return [look(uv, inv_depth, intrinsics, other) for other in others]


def by_any(looked: Sequence[Looked], count: int) -> tuple[Mask, Mask]:
    """(N,) each: points that stand where any of several sights saw nothing, and those that any saw else."""
    foreign, seen = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    for one in looked:
        foreign |= one.foreign
        seen |= one.same
    return foreign, seen & ~foreign


def known_before(looked: Sequence[Looked], count: int) -> Mask:
    """(N,): points of a frame that earlier keyframes saw too."""
    out = np.zeros(count, np.bool_)
    for one in looked:
        if one.value is None:
            out |= one.same
    return out


def without_intruder(keyframe: Keyframe, others: Sequence[Sight]) -> Keyframe | None:
    """A new keyframe without the points that stand where others saw nothing.

    They belong to something that moved there, which must not be taken for the world. Its depth becomes negative, so
    that no one measures it, and the next keyframe knows it again. The same keyframe where such points are too few to
    be more than borders and noise, None where they leave too little of it.
    """
    points, frame = keyframe.points, keyframe.frame
    looked = looks(points.uv, points.inv_depth, frame.intrinsics[0], others)
    foreign, _ = by_any(looked, len(points.uv))
    if foreign.sum() <= INTRUDERS * len(foreign) and not has_newcomers(keyframe, looked):
        return keyframe  # also where there are no points at all
    outline = outlined(frame, others)
    about = cv2.dilate(outline, np.ones((2 * MARGIN + 1, 2 * MARGIN + 1), np.uint8)) > 0
    u, v = points.uv.astype(np.int64).T
    own = ~(foreign | about[v, u])
    if own.mean() < LEFT:
        return None
    stays = only(keyframe, own)
    depth = np.where(outline > 0, -frame.depth, np.where(about, np.float32(0.0), frame.depth))
    return replace(stays, frame=replace(frame, depth=depth), intruded=True)


def has_newcomers(keyframe: Keyframe, looked: Sequence[Looked]) -> bool:
    """Whether many points that no earlier keyframe knows were not where they are in the last frames."""
    uv = keyframe.points.uv
    known = known_before(looked, len(uv))
    if (~known).sum() <= FEW:
        return False
    unlike, judged = moved(uv, keyframe.frame, looked, known)
    new = judged & ~known
    share = LOOKED_INTO + at_any_rate(unlike, judged & known)
    return bool((unlike & new).sum() > max(FEW, share * new.sum()))


def at_any_rate(unlike: Mask, judged: Mask) -> float:
    """Up to which share points may look otherwise that did not move: twice that of those that surely did not.

    Where the camera is not as its file says, or the pose is off, or all is blurred, the world looks otherwise too.
    """
    return 2.0 * float(unlike[judged].mean()) if judged.any() else 1.0


def blocked(frame: Frame, others: Sequence[Sight]) -> bool:
    """Whether something that others did not see there fills much of a frame's view."""
    return bool(outlined(frame, others).mean() > BLOCKED)


def outlined(frame: Frame, others: Sequence[Sight]) -> NDArray[np.uint8]:
    """(H, W), 1 where a frame sees what others did not see there; and the rest of that surface: as far as they do not
    know it, or all where most of what is known of it was not there. And surfaces that came into view and moved since.
    """
    height, width = frame.depth.shape
    uv, z = cells(frame)
    looked = looks(uv, reciprocal(z).ravel(), frame.intrinsics[0], others)
    foreign, seen = by_any(looked, len(uv))
    there, seen = smooth(z), seen.reshape(z.shape)
    opened = cv2.morphologyEx(foreign.reshape(z.shape).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    core = opened > 0
    whole = core | surfaces((there & ~seen) | core, core, np.ones(z.shape), OF_IT)
    whole |= surfaces(there | core, core, seen | core, MOST_OF_IT)
    known = known_before(looked, len(uv))
    unlike, judged = moved(uv, frame, looked, known)
    share = SUSPECT + at_any_rate(unlike, judged & known)
    judged &= ~known & at(textured(frame.images[1]), uv)
    whole |= surfaces(there & ~known.reshape(z.shape), unlike & judged, judged, share, FEWEST_KNOWN)
    out: NDArray[np.uint8] = cv2.resize(whole.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
    return out


def agreement(frame: Frame, others: Sequence[Sight]) -> float:
    """Share of a frame's texture that keyframes know, which looks as it did in the last frames; 1 where that is little.

    These points had no part in finding the pose.
    """
    uv, z = cells(frame)
    strong = at(textured(frame.images[1], STRONG), uv)
    uv = uv[strong]
    looked = looks(uv, reciprocal(z).ravel()[strong], frame.intrinsics[0], others)
    known = known_before(looked, len(uv))
    unlike, judged = moved(uv, frame, looked, known)
    judged &= known
    return 1.0 - float(unlike[judged].mean()) if judged.sum() >= LIMITS.left else 1.0


def cells(frame: Frame) -> tuple[Array, Array]:
    """Pixels in steps, (N, 2) px, and how far they are, (h, w) m."""
    height, width = frame.depth.shape
    v, u = np.mgrid[0:height:STEP, 0:width:STEP]
    return np.column_stack([u.ravel(), v.ravel()]).astype(np.float64), frame.depth[v, u].astype(np.float64)


def reciprocal(z: Array) -> Array:
    """1/m of a depth, 0 where that is unknown."""
    return np.divide(1.0, z, out=np.zeros_like(z), where=z > 0.0)


def at(mask: Mask, uv: Array) -> Mask:
    """(N,) of a mask on level 1 at pixels (N, 2)."""
    height, width = mask.shape
    u, v = (uv.astype(np.int64) // 2).T
    out: Mask = mask[v.clip(0, height - 1), u.clip(0, width - 1)]
    return out


def smooth(depth: Array) -> Mask:
    """Where a depth image (h, w), m, 0 unknown, has no step to a neighbour."""
    farthest = cv2.dilate(depth, np.ones((3, 3), np.uint8))
    nearest = cv2.erode(np.where(depth > 0.0, depth, FAR_M), np.ones((3, 3), np.uint8))
    out: Mask = (depth > 0.0) & (farthest < (1.0 + IN_FRONT / 2.0) * nearest)
    return out


def surfaces(part: Mask, its: NDArray[Any], of_all: NDArray[Any], share: float, least: int = 1) -> Mask:
    """The connected surfaces of cells (h, w) of which so large a share is something.

    its, of_all: (h, w) or (h * w,), what is something, and of what; surfaces with less than `least` of that stay out.
    """
    count, surface = cv2.connectedComponents(part.astype(np.uint8), connectivity=4)
    some, whole = (np.bincount(surface.ravel(), weights.ravel(), count) for weights in (its, of_all))
    chosen = (some > 0) & (some >= share * whole) & (whole >= least)
    chosen[0] = False
    out: Mask = chosen[surface]
    return out


def textured(image: NDArray[np.float32], slope: float = SLOPE) -> Mask:
    """(h, w) where an image has slopes, gray levels/px."""
    slopes = [np.abs(cv2.Sobel(image, cv2.CV_32F, dx, 1 - dx, scale=0.125)) for dx in (1, 0)]
    out: Mask = np.maximum(*slopes) > slope
    return out
