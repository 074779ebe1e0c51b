"""A pose that part of the newest keyframe speaks against is held against older ones.

Something that comes into view becomes part of new keyframes before it can be told from the world; frames may then be
aligned to it. Keyframes from before it came know nothing of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..frame import Frame
from ..kernels.se3 import inverse
from ..measurement import LEVELS, Noise, State, Subset
from .alignment import displacement
from .backends import Backend
from .doubt import BLURRED, sharpness
from .features import strangers
from .members import Members
from .tracking import FREE, Pair, Tracked, track_frame, track_roughly
from .verification import LIMITS, Verdict, verify

Array = NDArray[np.float64]

ALIKE = 0.9  # share of the points that agree or are hidden in brightness and in depth; fewer are looked into
IN_VIEW = 0.4  # share of an older keyframe's points that the frame must see
APART_PX = 3.0  # between two poses that contradict each other
CLEARLY = 0.1  # by which the score of the better one is larger


def unlike(verdict: Verdict) -> bool:
    """Whether so much of the newest keyframe looks otherwise that older ones are asked."""
    return min(verdict.bright, verdict.near) < ALIKE or verdict.hidden > LIMITS.in_front


def held_against(
    frame: Frame, members: Members, noise: Noise, backend: Backend, tracked: Tracked, verdict: Verdict,
    smooth: bool = False,
) -> tuple[Tracked, Verdict]:  # fmt: skip
    """A frame's pose against the newest keyframe; or the one that an older keyframe is sure of and that contradicts it.

    members: the window, whose last keyframe is the newest. smooth: as in align().
    """
    if len(members.keyframes) < 2 or not unlike(verdict):
        return tracked, verdict
    if sharpness(Pair(frame, members.keyframes[-1], noise, backend), tracked.T_frame_kf) < BLURRED:
        return tracked, verdict  # it looks otherwise to any of them
    if verdict.doubt(LIMITS.lost) and smooth and strangers(frame, members.keyframes[-1].frame):
        return tracked, verdict  # it is sought by what it has in common with others
    for pair, state, T_newest_kf in others(frame, members, noise, backend, tracked):
        said = verify(pair, replace(tracked, T_frame_kf=state.T, affine=state.affine))
        if said.visible < IN_VIEW:
            continue
        if not said.doubt(LIMITS.sure):
            return tracked, said if said.score > verdict.score else verdict
        if verify(pair, track_roughly(pair, state)).doubt(LIMITS.weak):
            continue  # most of them: what would end in doubt need not be done with care
        subset = Subset(pair.keyframe.coarse, pair.keyframe.points.patch.shape[2])
        again = track_frame(pair, state, pair.keyframe.coarse, subset, FREE, LEVELS)
        better = verify(pair, again)
        if better.doubt(LIMITS.sure) or better.score < said.score + CLEARLY:
            continue
        if displacement(pair, state.T, again.T_frame_kf) > APART_PX:
            T_frame_newest = again.T_frame_kf @ inverse(T_newest_kf)
            return replace(tracked, T_frame_kf=T_frame_newest, information=again.information), better
    return tracked, verdict


def confirmed(frame: Frame, members: Members, noise: Noise, backend: Backend, tracked: Tracked) -> bool:
    """Whether an older keyframe of the window is sure of a frame's pose, by as many points as it takes."""
    for pair, state, _ in others(frame, members, noise, backend, tracked):
        said = verify(pair, replace(tracked, T_frame_kf=state.T, affine=state.affine))
        if said.visible >= IN_VIEW and said.points >= LIMITS.left and not said.doubt(LIMITS.sure):
            return True
    return False


def explained(frame: Frame, members: Members, noise: Noise, backend: Backend, tracked: Tracked) -> bool:
    """Whether an older keyframe of the window sees nothing in a frame at its pose but what it knows and what hides it.

    The newest one may show what has come in since, and moved, where it disagrees.
    """
    for pair, state, _ in others(frame, members, noise, backend, tracked):
        said = verify(pair, replace(tracked, T_frame_kf=state.T, affine=state.affine))
        if said.visible >= IN_VIEW and said.explains:
            return True
    return False


def others(
    frame: Frame, members: Members, noise: Noise, backend: Backend, tracked: Tracked
) -> Iterator[tuple[Pair, State, Array]]:
    """The frame against each older keyframe, where its pose against the newest one puts it, and T_newest_kf (4, 4)."""
    if len(members.keyframes) < 2:
        return
    (a_newest, b_newest), gain = members.affine[-1], np.exp(tracked.affine[0])
    a, b = tracked.affine[0] + a_newest, gain * b_newest + tracked.affine[1]
    for keyframe, T_kf_world, (a_kf, b_kf) in zip(members.keyframes[:-1], members.T, members.affine, strict=False):
        T_newest_kf = members.T[-1] @ inverse(T_kf_world)
        state = State(tracked.T_frame_kf @ T_newest_kf, np.array([a - a_kf, b - np.exp(a - a_kf) * b_kf]))
        yield Pair(frame, keyframe, noise, backend), state, T_newest_kf
