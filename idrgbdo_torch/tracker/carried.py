"""What the camera may carry: a thing that is in view from the first frame on and moves with the camera.

No earlier keyframe knows what is behind it, so nothing tells it from the world until the camera moves. Then its pixels
stay as they are, while a pose of the rest alone explains the rest and not them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import log2

import cv2
import numpy as np
from numpy.typing import NDArray

from ..frame import Frame, Keyframe
from ..kernels.se3 import inverse
from ..measurement import IN_FRONT, LEVELS, State, Subset
from .intruder import textured
from .keyframe import only
from .tracking import FREE, Pair, track_frame
from .verification import LIMITS, Verdict, verify

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

WIDTH = 160  # px, about which images are compared
CHANGED = 6.0  # gray levels of a pixel that shows something else
OTHER_DEPTH = 0.02  # 1/m, likewise
AROUND = 9  # px of a neighbourhood there
ALL = 0.85  # share of the texture in one that must be the same
SOME = 0.1  # share of it that is texture
LEAST = 0.02  # of the image, that a thing worth the trouble takes
MOVED = 0.03  # share of the texture that changes when the camera moves
APART_PX = 3.0  # between the rest's pose and the one of all, from which on they contradict each other
SEEN_MOVING_PX = 3.0  # by which the thing would have moved, were it part of the world
STAYS, GOES = 0.8, 0.5  # share of the thing's points that agree with a camera at rest; fewer agree with the rest's pose
BEHIND = 0.5  # share of what is around it that is farther
CHANGES = 0.5  # share of the rest's texture that no longer is the same when the rest can't be tracked
STILL = 0.5  # share of the thing that must be where it was, for it to be there still
FEWEST = 24  # points of the rest, and of the thing, that a pose can be judged by


@dataclass
class Carried:
    """Whether a segment's first keyframe shows such a thing."""

    keyframe: Keyframe
    T_kf_world: Array  # (4, 4)
    number: int  # of that keyframe
    texture: Mask  # (h, w) of its image on the level that is compared
    same: Mask  # (h, w) where all frames since showed the same
    T_frame_kf: Array = field(default_factory=lambda: np.eye(4))  # the rest's pose in the last frame that told it
    doubt: str = ""  # why the pose that explains most is not to be believed, empty where it is
    settled: bool = False  # it is known whether there is one
    thing: Image | None = None  # (H, W) m, how far that is, 0 beside it

    @staticmethod
    def of(keyframe: Keyframe, T_kf_world: Array, number: int, before: Carried | None) -> Carried:
        """Nothing is known yet but what was known before."""
        level = level_of(keyframe.frame)
        texture, thing = textured(keyframe.frame.images[level]), before.thing if before else None
        if thing is not None:
            texture &= depth_on(thing, texture, level) == 0.0
        return Carried(keyframe, T_kf_world, number, texture, np.ones_like(texture), thing=thing)

    @property
    def kept(self) -> Carried | None:
        """What stays known when the camera finds itself elsewhere."""
        return None if self.thing is None else replace(self, settled=True)

    def cleared(self, keyframe: Keyframe) -> Keyframe:
        """A new keyframe without the thing, as far as it is still there; with negative depth, see without_intruder."""
        mask = self._shown(keyframe.frame)
        return keyframe if mask is None else without(keyframe, mask)

    def beside(self, frame: Frame) -> Frame:
        """A frame whose depth is negative where the thing is, as far as it is still there."""
        mask = self._shown(frame)
        return frame if mask is None else replace(frame, depth=marked(frame.depth, mask))

    def _shown(self, frame: Frame) -> Mask | None:
        """(H, W) where a frame shows the thing; None where it does not."""
        if self.thing is None:
            return None
        depth, there = frame.depth, self.thing > 0.0
        mask: Mask = there & (np.abs(depth - self.thing) < IN_FRONT * self.thing)
        if mask.sum() < STILL * there.sum():
            return None
        mask |= there & (depth == 0.0)
        return mask

    def seen_in(self, pair: Pair, T_frame_world: Array, verdict: Verdict) -> Keyframe | None:
        """Look at the next frame, and at the pose (4, 4) that explains most of it, with its verdict.

        The keyframe without the thing once there is one; the frame's pose against that is T_frame_kf then.
        """
        if self.settled or not self.texture.any():
            return None
        first, frame, believed = self.keyframe.frame, pair.frame, not verdict.doubt(LIMITS.lost)
        now = unchanged(first, frame, self.same)
        moved = 1.0 - now[self.texture].mean()
        self.doubt = ""
        if moved < MOVED:
            return None
        same = self.same & coherent(now, self.texture)
        if believed:
            self.same = same
        if same.mean() < LEAST:
            self.settled = believed
            return None
        thing = outlined(first, same)
        if not in_front(nearest(thing, first), first, frame):
            return None
        pair = replace(pair, keyframe=self.keyframe)
        apart = self._told_apart(pair, T_frame_world @ inverse(self.T_kf_world), thing, now)
        if not (apart and in_front(thing, first, frame)):
            return None
        mask, known = whole(thing, first), np.float32(0.0) if self.thing is None else self.thing
        its = whole(nearest(thing, first), first)  # what is around it may come to be as far as that again
        self.settled, self.doubt, self.thing = True, "", np.where(its, np.abs(first.depth), known)
        return without(self.keyframe, mask)

    def _told_apart(self, pair: Pair, T_frame_kf: Array, thing: Mask, now: Mask) -> bool:
        """Whether a pose of the rest explains the rest and not the thing.

        Until it can be told, a pose (4, 4) of all is in doubt that contradicts that of the rest.
        """
        keyframe, mask = self.keyframe, whole(thing, self.keyframe.frame)
        u, v = keyframe.points.uv.astype(np.int64).T
        rest, its = only(keyframe, ~mask[v, u]), keyframe.witnesses[mask[v, u][keyframe.witnesses]]
        changed = ~now[self.texture & ~thing]
        fills = changed.size and changed.mean() > CHANGES
        self.doubt = "what fills the view may move with the camera" if fills else ""
        if min(len(rest.coarse), len(rest.witnesses), len(its)) < FEWEST:
            return False
        pair = replace(pair, keyframe=rest)
        tracked = track_frame(
            pair, State(self.T_frame_kf, np.zeros(2)), rest.coarse, Subset(rest.coarse, rest.points.patch.shape[2]),
            FREE, LEVELS,
        )  # fmt: skip
        if verify(pair, tracked).doubt(LIMITS.sure):
            return False
        self.T_frame_kf = tracked.T_frame_kf
        camera, points, rested = keyframe.frame.intrinsics[0], keyframe.points, State(np.eye(4), tracked.affine)
        apart = pair.backend.displacement(camera, points, keyframe.coarse, T_frame_kf, tracked.T_frame_kf)
        self.doubt = "part of the view may move with the camera" if apart > APART_PX else ""
        if pair.backend.displacement(camera, points, its, np.eye(4), tracked.T_frame_kf) < SEEN_MOVING_PX:
            return False
        shares = []
        for state in (rested, State(tracked.T_frame_kf, tracked.affine)):
            found = pair.backend.verify(pair.frame.view, LIMITS.level, points, its, state, pair.noise, LIMITS.gray)
            # in brightness and in depth: a smooth thing looks the same some pixels beside
            shares.append(found.bright / max(found.seen, 1) * found.near / max(found.with_depth, 1))
        return shares[0] >= STAYS and shares[1] <= GOES


def without(keyframe: Keyframe, mask: Mask) -> Keyframe:
    """A keyframe without what is in some pixels (H, W): no points, and negative depth, so that no one measures it."""
    u, v = keyframe.points.uv.astype(np.int64).T
    frame = replace(keyframe.frame, depth=marked(keyframe.frame.depth, mask))
    return replace(only(keyframe, ~mask[v, u]), frame=frame, intruded=True)


def marked(depth: Image, mask: Mask) -> Image:
    """(H, W) m, negative in a mask where that is no part of the world; 0 where it is farther than most of it, and may
    be one after all: a mask is no sharp one, and what is taken for the thing once makes others seem to belong to it.
    """
    far = np.abs(depth)
    its = far[mask & (far > 0.0)]
    near = far < (1.0 + IN_FRONT) * (np.median(its) if its.size else 0.0)
    out: Image = np.where(mask, np.where(near, -far, np.float32(0.0)), depth)
    return out


def level_of(frame: Frame) -> int:
    """The level of a pyramid that is about WIDTH wide."""
    return min(max(round(log2(frame.images[0].shape[1] / WIDTH)), 0), LEVELS - 1)


def depth_on(depth: Image, image: Image | Mask, level: int) -> Image:
    """(h, w) m of the pixels amid those of an image (h, w) on a level."""
    step, (height, width) = 1 << level, image.shape
    out: Image = depth[step // 2 :: step, step // 2 :: step][:height, :width]
    return out


def unchanged(first: Frame, frame: Frame, same: Mask) -> Mask:
    """(h, w) where a frame shows what the first showed, as bright and as deep, as far as the depth is known."""
    level = level_of(first)
    a, b = first.images[level], frame.images[level]
    if same.any():  # the exposure of what stays
        one, two = a[same], b[same]
        gain = two.std() / max(one.std(), np.float32(1.0))
        a = gain * a + (two.mean() - gain * one.mean())
    z, w = depth_on(first.depth, a, level), depth_on(frame.depth, a, level)
    deep = np.abs(w - z) < OTHER_DEPTH * (z * w)
    out: Mask = (np.abs(a - b) < CHANGED) & (deep | (z == 0.0) | (w == 0.0))
    return out


def coherent(now: Mask, texture: Mask) -> Mask:
    """(h, w) where nearly all of the texture around is unchanged, and there is some."""
    around = (AROUND, AROUND)
    there = cv2.boxFilter(texture.astype(np.float32), -1, around)
    out: Mask = (there > SOME) & (cv2.boxFilter((now & texture).astype(np.float32), -1, around) > ALL * there)
    return out


def outlined(first: Frame, same: Mask) -> Mask:
    """(h, w) of the thing that stays the same: with its gaps, and the border that the neighbourhoods took from it."""
    _, part, sizes, _ = cv2.connectedComponentsWithStats(same.astype(np.uint8))
    same = (part > 0) & (sizes[:, cv2.CC_STAT_AREA] >= LEAST * same.size)[part]
    inside = cv2.morphologyEx(same.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((AROUND, AROUND), np.uint8))
    inside = cv2.morphologyEx(inside, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    depth = depth_on(first.depth, same, level_of(first))
    wide = np.ones((2 * AROUND - 1, 2 * AROUND - 1), np.uint8)
    nearby = cv2.dilate(np.where(inside > 0, depth, np.float32(0.0)), wide)
    one_of_it = (depth < (1.0 + IN_FRONT) * nearby) | (cv2.dilate(inside, np.ones((3, 3), np.uint8)) > 0)
    out: Mask = (inside > 0) | ((nearby > 0.0) & one_of_it)
    return out


def whole(thing: Mask, frame: Frame) -> Mask:
    """(H, W) of a mask (h, w)."""
    height, width = frame.depth.shape
    out: Mask = cv2.resize(thing.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST) > 0
    return out


def nearest(thing: Mask, first: Frame) -> Mask:
    """(h, w) of a mask without what is farther than most of it: what has hardly changed yet beside a thing."""
    depth = depth_on(first.depth, thing, level_of(first))
    its = depth[thing & (depth > 0.0)]
    out: Mask = thing & (depth < (1.0 + IN_FRONT) * (np.median(its) if its.size else 0.0))
    return out


def in_front(thing: Mask, first: Frame, frame: Frame) -> bool:
    """Whether most of what is around a thing is farther, in the first frame and now: else it moves, not the camera."""
    level = level_of(first)
    z, w = depth_on(first.depth, thing, level), depth_on(frame.depth, thing, level)
    its = cv2.dilate(np.where(thing, z, np.float32(0.0)), np.ones((7, 7), np.uint8))
    around = (its > 0.0) & ~thing & (z > 0.0) & (w > 0.0)
    farther = np.minimum(z, w)[around] > (1.0 + IN_FRONT) * its[around]
    return bool(farther.size and farther.mean() > BEHIND)
