"""What the last frames saw and how far it was: whoever moves shows it from one frame to the next.

Something that comes in where no keyframe has looked yet hides nothing that is known. But the frames before saw through
the place where it stands now; or, where it comes in as fast as the view turns, they saw it look otherwise there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..frame import Frame
from ..kernels import sights as kernel
from ..kernels.se3 import inverse

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]
Image = NDArray[Any]

STRIDE = 2  # frames between two that are kept
KEPT = 5  # of them
STEP = 4  # px between the pixels that are kept
FEWEST_KNOWN = 16  # points by which two images can be compared,
MOST_KNOWN = 256  # and more are not needed for that
NO_IMAGE = np.zeros((0, 0), np.float32)
OTHER_GRAY = 12.0  # gray levels on level 1, by which a point looks otherwise


class Sight(NamedTuple):
    """A depth image from elsewhere."""

    T_sight_frame: Array  # (4, 4) from the frame that is looked at
    depth: Image  # (h, w) m; 0 unknown, negative where what is so far is not of the world
    intrinsics: Array  # (4,) fx fy cx cy of it
    reach: int  # px there, over which neighbours must say the same
    gray: Image | None = None  # (h, w) gray levels of level 1, where brightness can be compared too,
    gray_intrinsics: Array | None = None  # (4,) and that level's


def sight(frame: Frame, T_sight_frame: Array) -> Sight:
    """All that a frame sees."""
    return Sight(T_sight_frame, frame.depth, frame.intrinsics[0], STEP)


def cast(
    uv: Array, inv_depth: Array, intrinsics: Array, T_other_frame: Array, intrinsics_other: Array
) -> tuple[Mask, Array, Array, Array]:
    """Of points of a frame, (N, 2) px and (N,) 1/m, (N,) each: whether ahead in another, column, row, depth."""
    fx, fy, cx, cy = intrinsics
    z = 1.0 / np.maximum(inv_depth, 1e-9)
    P = np.column_stack([(uv[:, 0] - cx) / fx * z, (uv[:, 1] - cy) / fy * z, z])
    P = P @ T_other_frame[:3, :3].T + T_other_frame[:3, 3]
    ahead = (inv_depth > 0.0) & (P[:, 2] > 1e-3)
    z = np.where(ahead, P[:, 2], 1.0)
    fx, fy, cx, cy = intrinsics_other
    return ahead, fx * P[:, 0] / z + cx, fy * P[:, 1] / z + cy, z


def fallen(uv: Array, inv_depth: Array, intrinsics: Array, other: Sight) -> tuple[Mask, Index, Index, Array]:
    """Where points of a frame, as cast() has them, fall in a sight: whether inside, column, row (px), depth (m)."""
    ahead, u, v, z = cast(uv, inv_depth, intrinsics, other.T_sight_frame, other.intrinsics)
    u, v = np.rint(u), np.rint(v)
    height, width = other.depth.shape
    ahead &= (u >= 0) & (v >= 0) & (u < width) & (v < height)
    return ahead, np.where(ahead, u, 0).astype(np.int64), np.where(ahead, v, 0).astype(np.int64), z


class Looked(NamedTuple):
    """What a sight says of points of a frame, (N,) each."""

    foreign: Mask  # it saw through, or met what is not of the world, all around
    same: Mask  # it saw that depth
    value: Image | None = None  # gray level there, None where brightness cannot be compared


def look(uv: Array, inv_depth: Array, intrinsics: Array, other: Sight) -> Looked:
    """Points of a frame, (N, 2) px and (N,) 1/m, in a sight. intrinsics: (4,) of the frame."""
    gray, intrinsics_gray = other.gray, other.gray_intrinsics
    if gray is None or intrinsics_gray is None:
        gray, intrinsics_gray = NO_IMAGE, intrinsics
    found = kernel.look(
        uv, inv_depth, intrinsics, other.T_sight_frame, other.depth, other.intrinsics, other.reach, gray,
        intrinsics_gray,
    )  # fmt: skip
    return Looked(found[0], found[1], None if other.gray is None else found[2])


def moved(uv: Array, frame: Frame, looked: Sequence[Looked], known: Mask) -> tuple[Mask, Mask]:
    """Of points of a frame, (N,) each: those of another brightness where others saw that depth, and all for which that
    can be said, by the first that did. known: (N,), those that surely are of the world, which tell the exposure.
    """
    here = kernel.sampled(frame.images[1], uv, 0.5, -0.25)  # the middle of a pixel of level 1 is amid four
    unlike, judged = np.zeros(len(uv), np.bool_), np.zeros(len(uv), np.bool_)
    for _, same, value in looked:
        if value is not None:
            kernel.mark_unlike(here, value, same, known, judged, unlike, (FEWEST_KNOWN, MOST_KNOWN, OTHER_GRAY))
    return unlike, judged


@dataclass(frozen=True)
class Glance:
    """One frame's depth, in steps of some pixels, and its brightness on level 1."""

    T_cam_world: Array  # (4, 4)
    depth: Image  # (h, w) m, as a Sight has it
    gray: Image  # (h, w)
    intrinsics: Array  # (2, 4) of depth and gray

    @staticmethod
    def of(frame: Frame, T_cam_world: Array, foreign: Image | None = None) -> Glance:
        """What a frame at a pose sees; foreign: (H, W), not 0 where that is not of the world, None where all may be."""
        depth = frame.depth[::STEP, ::STEP]
        depth = depth.copy() if foreign is None else np.where(foreign[::STEP, ::STEP] > 0, -np.abs(depth), depth)
        intrinsics = np.array([frame.intrinsics[0] / STEP, frame.intrinsics[1]])
        return Glance(T_cam_world, depth, frame.images[1], intrinsics)


@dataclass
class Glances:
    """Of the last frames that were measured."""

    count: int = 0  # frames since the last one that was kept
    kept: list[Glance] = field(default_factory=list)

    def sights(self, T_frame_world: Array) -> list[Sight]:
        """What they saw, from a frame at this pose (4, 4)."""
        T_world_frame = inverse(T_frame_world)
        return [
            Sight(seen.T_cam_world @ T_world_frame, seen.depth, seen.intrinsics[0], 1, seen.gray, seen.intrinsics[1])
            for seen in self.kept
        ]

    def is_due(self) -> bool:
        """Whether the next frame is one to be kept."""
        self.count += 1
        return self.count >= STRIDE

    def add(self, glance: Glance) -> None:
        """Keep one, and forget the oldest."""
        self.count = 0
        self.kept = [*self.kept[1 - KEPT :], glance]

    def move_world(self, T_old_new: Array) -> None:
        """See them from another world, which lies at this pose (4, 4) in the old one."""
        self.kept = [replace(glance, T_cam_world=glance.T_cam_world @ T_old_new) for glance in self.kept]

    def forget(self) -> None:
        """What was seen says nothing about what comes."""
        self.kept = []
