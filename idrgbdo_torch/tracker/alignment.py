"""The pose of a frame with as little work as it takes: quickly, thoroughly, or from scratch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..frame import Frame
from ..measurement import LEVELS, State, Subset
from .doubt import align_blurred, is_blurred
from .features import HALF, start_from_features, strangers
from .intruder import hidden
from .keyframe import all_patches
from .surface import lay, lies_on_surface
from .tracking import FREE, Pair, Tracked, track_closely, track_frame
from .verification import LIMITS, Verdict, verify

Array = NDArray[np.float64]
Index = NDArray[np.int64]

QUICK_LEVELS = 3  # of the pyramid, for a frame that is where it was expected
QUICK_POINTS = 128  # coarse points that it takes; with fewer the whole patches cost little
QUICK_STRIDE = 2  # of the coarse points, every second one
QUICK_PIXELS = 1  # of a coarse point's patch, likewise
NEAR_LEVELS = 3  # for a start within some pixels: views far apart are alike in detail, but not in the large
EXPECTED_PX = 2.0  # mean distance in the image between the predicted and the measured pose of such a frame
WIDE_PX = 12.0  # the same, from which on each chosen point errs by more: all spread-out ones say where the frame is
FAR_NEAR = 0.86  # share of points that agree in depth under which a pose so far off is searched for again; of 100 such
# steps of real recordings that were right two had less, of eight of rendered ones that were wrong five
WIDE_IN_VIEW = 0.6  # share of them that must be in view; fewer stand on one side
OTHER_PX = 10.0  # between two starts of a search, under which they end alike: no second one nearer than 49 px helped
FEWEST_BESIDE = 24  # points beside something in front that are worth a try
NOTHING = (
    Tracked(np.eye(4), np.zeros(2), np.zeros((6, 6)), 0, 0, np.zeros(0, np.int64), np.zeros(0)),
    Verdict(0.0, 0.0, 0.0),
)


def align(
    pair: Pair, start: State, resting: Array, index: Index, information: Array, levels: int, surprise_px: float,
    smooth: bool = False,
) -> tuple[Tracked, Verdict, float]:  # fmt: skip
    """A frame's pose, how far to believe it, and how far in px it is from the guess.

    start: by constant velocity, resting: T_frame_kf of a camera that stopped; information: the motion prior's, (6, 6).
    surprise_px: how far the frame before was from its guess. Cameras move smoothly, so a frame after an expected one
    starts within reach of few coarse pixels; what comes out of it must fit, and be where expected.
    smooth: images follow each other so closely that one which shares nothing with the keyframe shows another place.
    """
    coarse, pixels = pair.keyframe.coarse, pair.keyframe.points.patch.shape[2]
    if surprise_px < EXPECTED_PX and len(coarse) >= QUICK_POINTS:
        few = Subset(np.ascontiguousarray(coarse[::QUICK_STRIDE]), QUICK_PIXELS)
        tracked = track_frame(pair, start, index, few, information, min(levels, QUICK_LEVELS))
        verdict = verify(pair, tracked)
        surprise_px = displacement(pair, start.T, tracked.T_frame_kf)
        if surprise_px < EXPECTED_PX and not verdict.doubt(LIMITS.sure):
            if is_blurred(pair, tracked.T_frame_kf, verdict):
                tracked, verdict = align_blurred(pair, tracked, information)
            return tracked, verdict, surprise_px
    tracked = track_frame(pair, start, index, Subset(coarse, pixels), information, levels)
    verdict = verify(pair, tracked)
    if blind(pair.frame):
        return tracked, verdict, displacement(pair, start.T, tracked.T_frame_kf)
    if verdict.hidden > LIMITS.in_front:
        again, second = align_beside(pair, start, index, information, levels)
        if second.score > verdict.score:
            tracked, verdict = again, second
    if is_blurred(pair, tracked.T_frame_kf, verdict):
        tracked, verdict = align_blurred(pair, tracked, information)
        if not (verdict.doubt(LIMITS.lost) or is_suspect(pair, start, tracked, verdict)):
            return tracked, verdict, displacement(pair, start.T, tracked.T_frame_kf)
    if is_suspect(pair, start, tracked, verdict):
        verdict = with_surface(pair, tracked, verdict)
        again, second = recover_by_depth(pair, [start.T, resting], start.affine, index)
        if is_better(pair, start, (again, second), (tracked, verdict)):
            tracked, verdict = again, second
    if is_suspect(pair, start, tracked, verdict):
        again, second = recover_by_features(pair, start.affine, index)
        agrees = second.supported and not second.doubt(LIMITS.lost)
        if agrees or is_better(pair, start, (again, second), (tracked, verdict)):
            tracked, verdict = again, second
    if is_suspect(pair, start, tracked, verdict) and not (smooth and strangers(pair.frame, pair.keyframe.frame)):
        far = displacement(pair, start.T, resting) > OTHER_PX
        again, second = recover(pair, [start.T, resting] if far else [start.T], start.affine, index)
        if is_better(pair, start, (again, second), (tracked, verdict)):
            tracked, verdict = again, second
    surprise_px = displacement(pair, start.T, tracked.T_frame_kf)
    if surprise_px > WIDE_PX and not verdict.doubt(LIMITS.weak):
        tracked, verdict = align_wide(pair, tracked, verdict)
    return tracked, replace(verdict, far=is_suspect(pair, start, tracked, verdict)), surprise_px


def is_suspect(pair: Pair, start: State, tracked: Tracked, verdict: Verdict) -> bool:
    """Whether a pose may be another minimum than the true one: doubtful, or far from where the frame was expected while
    depth speaks against it. What lies nearer than a wrong pose expects looks as if it stood in front.
    """
    return bool(verdict.doubt(LIMITS.weak)) or is_far(pair, start.T, tracked, verdict)


def is_far(pair: Pair, guess: Array, tracked: Tracked, verdict: Verdict) -> bool:
    """Whether depth speaks against a pose that is far from the guess of T_frame_kf."""
    differs = verdict.near < FAR_NEAR or verdict.hidden > LIMITS.in_front
    return differs and displacement(pair, guess, tracked.T_frame_kf) > WIDE_PX


def is_better(pair: Pair, start: State, one: tuple[Tracked, Verdict], other: tuple[Tracked, Verdict]) -> bool:
    """Whether one of two poses is to be taken: one not suspect, or that depth alone is sure of; then by score."""

    def rank(found: tuple[Tracked, Verdict]) -> tuple[bool, float]:
        return found[1].on_surface or not is_suspect(pair, start, *found), found[1].score

    return rank(one) > rank(other)


def align_wide(pair: Pair, tracked: Tracked, verdict: Verdict) -> tuple[Tracked, Verdict]:
    """A pose once more, with all spread-out points, where these are many and seen from all sides."""
    few = len(pair.keyframe.coarse) < QUICK_POINTS
    if few or verdict.visible < WIDE_IN_VIEW or verdict.hidden > LIMITS.in_front:
        return tracked, verdict
    again = track_closely(pair, tracked, FREE)
    second = verify(pair, again)
    return (tracked, verdict) if second.doubt(LIMITS.weak) else (again, second)


def align_beside(pair: Pair, start: State, index: Index, information: Array, levels: int) -> tuple[Tracked, Verdict]:
    """Align a frame with the points alone that nothing hides at the start, as many of them as there are."""
    behind = hidden(pair.keyframe.points, start.T, pair.frame)
    coarse = pair.keyframe.coarse[~behind[pair.keyframe.coarse]]
    fine = np.union1d(index[~behind[index]], coarse)
    if len(coarse) < FEWEST_BESIDE:
        return NOTHING
    tracked = track_frame(pair, start, fine, Subset(coarse, pair.keyframe.points.patch.shape[2]), information, levels)
    return tracked, verify(pair, tracked)


def displacement(pair: Pair, T_a: Array, T_b: Array) -> float:
    """Mean distance in px between where two poses T_frame_kf put the spread-out points; inf if none is in front."""
    keyframe = pair.keyframe
    return pair.backend.displacement(keyframe.frame.intrinsics[0], keyframe.points, keyframe.coarse, T_a, T_b)


def blind(frame: Frame) -> bool:
    """Whether a frame has no depth at all, as behind a covered lens: none of its poses can be verified."""
    return not bool((frame.depth > 0.0).any())


def recover_by_depth(pair: Pair, guesses: Sequence[Array], affine: Array, index: Index) -> tuple[Tracked, Verdict]:
    """recover() from where depth alone puts the frame, which holds it there as far as it is known."""
    laid = lay(pair, guesses)
    if laid is None:
        return NOTHING
    pair, everyone = with_everyone(pair)
    tracked = track_frame(pair, State(laid.T_frame_kf, affine), index, everyone, laid.information, NEAR_LEVELS)
    tracked = replace(tracked, information=tracked.information + laid.information)  # which is no prior's
    return tracked, with_surface(pair, tracked, verify(pair, tracked))


def with_everyone(pair: Pair) -> tuple[Pair, Subset]:
    """The pair with the patches of all candidates on all levels, and all of them."""
    keyframe = all_patches(pair.keyframe, pair.backend)
    return replace(pair, keyframe=keyframe), Subset(np.arange(len(keyframe.points.uv)), keyframe.points.patch.shape[2])


def with_surface(pair: Pair, tracked: Tracked, verdict: Verdict) -> Verdict:
    """The verdict, and whether depth alone is sure of the pose, where brightness may not be."""
    sure = verdict.bright > LIMITS.alike and lies_on_surface(pair, tracked.T_frame_kf)
    return replace(verdict, on_surface=sure)


def recover_by_features(pair: Pair, affine: Array, index: Index) -> tuple[Tracked, Verdict]:
    """recover() from where the features of frame and keyframe say: for views far apart, where no prediction holds."""
    start = start_from_features(pair.frame, pair.keyframe.frame, HALF)
    if start is None:
        return NOTHING
    tracked, verdict = recover(pair, [start.T_target_host] * 2, affine, index, (NEAR_LEVELS, LEVELS))
    return tracked, replace(verdict, supported=start.supports(tracked.T_frame_kf))


def recover(
    pair: Pair, guesses: Sequence[Array], affine: Array, index: Index, levels: Sequence[int] = (LEVELS, LEVELS)
) -> tuple[Tracked, Verdict]:
    """Try again from each guess of T_frame_kf with all candidates on so many levels, no prior; the best one.

    The finest level keeps the chosen points `index`. There is at least one guess.
    """
    pair, everyone = with_everyone(pair)
    tried = []
    for guess, count in zip(guesses, levels, strict=False):
        tracked = track_frame(pair, State(guess, affine), index, everyone, FREE, count)
        tried.append((tracked, verify(pair, tracked)))
        if not tried[-1][1].doubt(LIMITS.weak):
            break
    tracked, verdict = max(tried, key=lambda found: found[1].score)
    return tracked, with_surface(pair, tracked, verdict)
