"""Where the camera has been: keyframes thinned to what it takes to recognise a view and to align a frame to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ..frame import Frame, Keyframe
from .features import HALF, Features, features
from .keyframe import only

Array = NDArray[np.float64]

MOST = 100  # places kept; 0.25 MB each at most
APART = 0.2  # of the image's width: how far the view moves from one place to the next
RANKED = 5  # places tried because they look like the frame,
RECENT = 2  # because the camera was there last,
OTHERS = 3  # and because it is their turn, for each frame that is looked for


@dataclass(frozen=True)
class Place:
    """A keyframe without its images."""

    number: int  # of the keyframe
    keyframe: Keyframe  # only the spread-out points, on every level
    features: Features
    thumbnail: Array  # (T,) the coarsest level, of zero mean and unit length


@dataclass
class Places:
    """The places of a run, oldest first."""

    kept: list[Place] = field(default_factory=list)

    def add(self, number: int, keyframe: Keyframe) -> None:
        """One more; where there are too many, every second one of the older half goes."""
        self.kept.append(
            Place(number, without_images(keyframe), features(keyframe.frame, HALF), thumbnail(keyframe.frame))
        )
        if len(self.kept) > MOST:
            half = len(self.kept) // 2
            self.kept = self.kept[:half:2] + self.kept[half:]

    def likely(self, frame: Frame, attempt: int) -> list[Place]:
        """The places to try for a frame, the likeliest first; attempt counts the frames sought in vain before it."""
        if not self.kept:
            return []
        alike = np.array([place.thumbnail @ thumbnail(frame) for place in self.kept])
        newest = len(self.kept) - 1
        turn = [(attempt * OTHERS + k) % len(self.kept) for k in range(OTHERS)]
        order = [*np.argsort(-alike, kind="stable")[:RANKED].tolist(), *range(newest, newest - RECENT, -1), *turn]
        return [self.kept[k] for k in dict.fromkeys(k for k in order if k >= 0)]


def without_images(keyframe: Keyframe) -> Keyframe:
    """A keyframe reduced to its spread-out points, which have patches on all levels; its own images are let go."""
    spread_out = np.zeros(len(keyframe.points.uv), np.bool_)
    spread_out[keyframe.coarse] = spread_out[keyframe.witnesses] = True
    frame, empty = keyframe.frame, np.zeros((1, 1), np.float32)
    frame = Frame(frame.timestamp, frame.camera, (empty,) * len(frame.images), empty)
    everyone = np.arange(np.count_nonzero(spread_out))
    return replace(only(keyframe, spread_out), frame=frame, coarse=everyone, witnesses=everyone)


def thumbnail(frame: Frame) -> Array:
    """The coarsest level as a unit vector, so that the product of two is their correlation."""
    small = frame.images[-1].astype(np.float64).ravel()
    small = small - small.mean()
    out: Array = small / max(float(np.linalg.norm(small)), 1e-9)
    return out


def nearest_first(T_cam_world: Array, poses: Sequence[Array]) -> list[int]:
    """Numbers of poses T_kf_world, the nearest in view first: metres and radians count alike."""
    away = []
    for T in poses:
        R = T_cam_world[:3, :3] @ T[:3, :3].T
        angle = np.arccos(np.clip((np.trace(R) - 1) / 2, -1.0, 1.0))
        away.append(float(np.linalg.norm(T_cam_world[:3, 3] - R @ T[:3, 3]) + angle))
    return [int(k) for k in np.argsort(away, kind="stable")]
