"""What to do when a frame is lost: find it in what is still known, in the order of cost, verified as every pose is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..frame import Keyframe
from ..measurement import LEVELS, State, Subset
from .alignment import FREE, NEAR_LEVELS
from .features import HALF, features, pose_from_features
from .places import Place, nearest_first
from .tracking import Pair, Tracked, track_frame
from .verification import LIMITS, Verdict, verify

Array = NDArray[np.float64]

NEIGHBOURS = 3  # keyframes of the window that are tried directly
IN_VIEW = 0.25  # share of a place's points that must be in view: it may be seen from elsewhere, but not by a corner


@dataclass(frozen=True)
class Found:
    """A lost frame's pose against a keyframe that is not the newest."""

    number: int  # of that keyframe
    tracked: Tracked
    verdict: Verdict

    @property
    def T_frame_kf(self) -> Array:
        """(4, 4)."""
        return self.tracked.T_frame_kf


def aligned(pair: Pair, T_frame_kf: Array, levels: int) -> tuple[Tracked, Verdict]:
    """Align a frame to a keyframe's spread-out points on so many levels, with nothing held."""
    points, coarse = pair.keyframe.points, pair.keyframe.coarse
    subset = Subset(coarse, points.patch.shape[2])
    tracked = track_frame(pair, State(T_frame_kf, np.zeros(2)), coarse, subset, FREE, levels)
    return tracked, verify(pair, tracked)


def find_in_window(pair: Pair, T_cam_world: Array, window: dict[int, tuple[Keyframe, Array]]) -> Found | None:
    """The frame against the other keyframes of the window, from where it was expected, the nearest views first."""
    numbers = list(window)
    for k in nearest_first(T_cam_world, [window[number][1] for number in numbers])[:NEIGHBOURS]:
        keyframe, T_kf_world = window[numbers[k]]
        guess = T_cam_world @ np.linalg.inv(T_kf_world)
        tracked, verdict = aligned(replace(pair, keyframe=keyframe), guess, LEVELS)
        if believed(verdict):
            return Found(numbers[k], tracked, verdict)
    return None


def find_in_places(pair: Pair, places: Sequence[Place]) -> Found | None:
    """The frame in places that were seen before."""
    if not places:
        return None
    seen = features(pair.frame, HALF)
    for place in places:
        guess = pose_from_features(place.features, seen, pair.frame.intrinsics[HALF])
        if guess is None:
            continue
        tracked, verdict = aligned(replace(pair, keyframe=place.keyframe), guess, NEAR_LEVELS)
        if believed(verdict):
            return Found(place.number, tracked, verdict)
    return None


def believed(verdict: Verdict) -> bool:
    """Whether a pose found elsewhere is taken: a wrong one is worse than none, so it must be sure."""
    return verdict.visible > IN_VIEW and not verdict.doubt(LIMITS.sure)
