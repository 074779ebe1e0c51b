"""What to do when a frame is lost: find it in what is still known, in the order of cost, verified as every pose is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..frame import Keyframe
from ..kernels.se3 import inverse
from ..measurement import LEVELS, State, Subset
from .alignment import NEAR_LEVELS, recover
from .features import (
    FULL,
    HALF,
    Perspective,
    features,
    match,
    pose_from_matches,
    start_from_features,
    strangers,
)  # fmt: skip
from .places import Place, nearest_first
from .tracking import FREE, Pair, Tracked, track_frame
from .verification import LIMITS, Verdict, obstructed, verify

Array = NDArray[np.float64]

NEIGHBOURS = 3  # keyframes of the window that are tried directly
TRIED = 4  # places that a frame is aligned to
IN_VIEW = 0.25  # share of a place's points that must be in view: it may be seen from elsewhere, but not by a corner


@dataclass(frozen=True)
class Found:
    """A lost frame's pose against a keyframe."""

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
    """The frame against the other keyframes of the window, the nearest views first, from where the features say."""
    for number in neighbours(T_cam_world, window):
        keyframe, _ = window[number]
        start = start_from_features(pair.frame, keyframe.frame, HALF)
        if start and (found := from_perspective(number, replace(pair, keyframe=keyframe), start)):
            return found
    return None


def neighbours(T_cam_world: Array, window: dict[int, tuple[Keyframe, Array]]) -> list[int]:
    """Numbers of the keyframes of a window that are tried for a frame, the nearest views first."""
    numbers = list(window)
    return [numbers[k] for k in nearest_first(T_cam_world, [window[n][1] for n in numbers])[:NEIGHBOURS]]


def find_near(pair: Pair, T_cam_world: Array, window: dict[int, tuple[Keyframe, Array]]) -> Found | None:
    """The frame against keyframes of a window from where it was expected."""
    for number in neighbours(T_cam_world, window):
        keyframe, T_kf_world = window[number]
        other = replace(pair, keyframe=keyframe)
        if found := sure(number, other, *aligned(other, T_cam_world @ inverse(T_kf_world), LEVELS)):
            return found
    return None


def find_in_places(pair: Pair, places: Sequence[Place]) -> Found | None:
    """The frame in places that were seen before, those first that share most features with it."""
    if not places:
        return None
    seen = features(pair.frame, HALF)
    pairs = [match(place.features, seen) for place in places]
    for k in sorted(range(len(places)), key=lambda k: -len(pairs[k]))[:TRIED]:
        place = places[k]
        start = pose_from_matches(place.features, seen, pairs[k], pair.frame.intrinsics[HALF])
        if start and (found := from_perspective(place.number, replace(pair, keyframe=place.keyframe), start)):
            return found
    return None


def find_in_newest(pair: Pair, number: int, T_frame_kf: Array) -> Found | None:
    """The frame against the newest keyframe, whose number this is, by what align() leaves out, as it is dear.

    Features of the whole images; and of strangers, the direct search from where the frame was expected.
    """
    start = start_from_features(pair.frame, pair.keyframe.frame, FULL)
    if start and (found := from_perspective(number, pair, start)):
        return found
    if not strangers(pair.frame, pair.keyframe.frame):
        return None
    return sure(number, pair, *recover(pair, [T_frame_kf], np.zeros(2), pair.keyframe.coarse))


def from_perspective(number: int, pair: Pair, start: Perspective) -> Found | None:
    """The frame against a keyframe from where features put it, if its brightness and depth are sure of it."""
    return sure(number, pair, *aligned(pair, start.T_target_host, NEAR_LEVELS))


def sure(number: int, pair: Pair, tracked: Tracked, verdict: Verdict) -> Found | None:
    """A pose of a lost frame, if it is to be taken: a wrong one is worse than none."""
    if verdict.visible < IN_VIEW or verdict.doubt(LIMITS.sure) or verdict.hidden > LIMITS.in_front:
        return None  # what hides much of the place would become part of the keyframe that is made here
    if obstructed(verdict, pair.keyframe.intruded) or verdict.depths < LIMITS.beside:
        return None  # by brightness alone views of different places agree
    return Found(number, tracked, verdict)
