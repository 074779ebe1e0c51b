"""Is a pose to be believed? Held against points that had no part in finding it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..measurement import Agreement, State
from .tracking import Pair, Tracked

Array = NDArray[np.float64]

FREEDOMS = ("x", "y", "z", "rotation about x", "rotation about y", "rotation about z")


@dataclass(frozen=True)
class Limits:
    """Where a pose stops being believed.

    The shares were set so that of steps off by more than 5 cm or 3 degrees nearly all are weak or lost, and of those
    off by less than 1 cm nearly none: rendered desks taken every 4th and 8th frame, and fr3 cabinet's wide baselines.
    """

    level: int = 1  # of the pyramid that brightness is compared on: half the size forgives half a pixel
    gray: float = 12.0  # gray levels, largest residual of a point that agrees: three of the sensor's sigmas of 4
    in_view: float = 0.15  # share of the points that the frame must see
    sure: float = 0.7  # share of agreeing points under which a quick alignment is not taken for granted,
    weak: float = 0.61  # a pose is doubtful,
    lost: float = 0.54  # and is not used
    alike: float = 0.4  # under which a pose is not used even if depth alone is sure of it,
    depth_above: float = 0.12  # how much larger the share must be in depth, which knows no shadows and highlights
    lately_above: float = 0.09  # likewise among what the last frames saw, which are nearer than the keyframe
    few_depths: int = 12  # fewer measured depths than this are too few to judge by
    in_front: float = 0.15  # share of hidden points under which nothing stands in front: borders and parallax
    left: int = 32  # points that are seen beside something in front, under which they are too few to be sure
    left_again: int = 64  # of them, from which on they are enough again
    beside: int = 24  # points beside something in front that a pose can be judged by at all
    explained: float = 0.95  # share of the points with depth that agree or are hidden, where a pose is beyond doubt
    everything: float = 0.9  # share of agreeing points that no thing in front can be without what is around it
    points: int = 6  # a pose has six degrees of freedom
    gain: float = 1.0  # of the logarithm: with no contrast left, a black or white image would explain everything
    unsure_bits: float = -7.0  # entropy of the least certain degree of freedom: 2 mm or 2 mrad given the others


LIMITS = Limits()


@dataclass(frozen=True)
class Verdict:
    """How well a pose explains a few hundred points that did not choose it."""

    visible: float  # share of the points that the frame sees
    bright: float  # share of those with agreeing brightness
    near: float  # share of those with depth that agree in depth
    hidden: float = 0.0  # share of the seen ones with depth that something nearer hides
    points: int = 0  # so many are seen that nothing hides
    depths: int = 0  # so many were compared in depth
    supported: bool = False  # features that had no part in the alignment agree with it
    on_surface: bool = False  # depth alone is sure of it, as both views show one surface: brightness may change
    lately: float = 1.0  # share of the frame's texture that looks as in the last frames, where that is asked
    far: bool = False  # from where the frame was expected, and depth speaks against it

    @property
    def score(self) -> float:
        """For the choice between two poses."""
        return self.visible * self.bright * self.near * self.lately

    @property
    def explains(self) -> bool:
        """Whether nothing disagrees in depth but what something hides: then the pose can tell what that is."""
        return self.near + self.hidden > LIMITS.explained

    @property
    def is_all(self) -> bool:
        """Whether nearly everything agrees, in brightness and depth: then it is the same view, whatever is in front."""
        return min(self.bright, self.near) > LIMITS.everything

    def doubt(self, strict: float) -> str:
        """Why the pose is not to be believed, empty when it is; strict grows the limits towards 1."""
        if self.visible == 0.0 < self.points:  # nothing was asked
            return f"only {self.points} points could be used"
        if self.visible < LIMITS.in_view:
            return f"only {self.visible:.0%} of the keyframe is in view"
        supported = self.on_surface or (self.supported and strict <= LIMITS.lost)
        if self.bright < strict and not (supported and strict != LIMITS.weak):  # then it is doubtful, but not lost
            return f"only {self.bright:.0%} of the points agree in brightness"
        if self.near < strict + LIMITS.depth_above:
            return f"only {self.near:.0%} of the points agree in depth"
        if self.lately < strict + LIMITS.lately_above:
            return f"only {self.lately:.0%} of what is known looks as in the last frames"
        return ""


def obstructed(verdict: Verdict, intruded: bool, least: int = LIMITS.left) -> str:
    """Why a pose is doubtful that few points speak for, since something hides the others; empty when it does not.

    intruded: something did in the keyframe already. least: points that are enough.
    """
    few = verdict.points < least and (intruded or verdict.hidden > LIMITS.in_front)
    return f"something hides all but {verdict.points} of the points" if few else ""


def unsure(entropies: Array) -> str:
    """Why a pose with these entropies (6,) in bits is doubtful however well it fits, empty when it is not."""
    bits, freedom = max(zip(entropies.tolist(), FREEDOMS, strict=True))
    return f"{freedom} is uncertain: {bits:.1f} bits" if bits > LIMITS.unsure_bits else ""


def doubtful(verdict: Verdict, intruded: bool, before: bool, entropies: Array) -> str:
    """Why a pose is doubtful that is used, empty when it is not.

    intruded: as in obstructed(). before: the last pose was obstructed: one that follows from it is not sure because
    some more points come to agree with it.
    """
    least = LIMITS.left_again if before else LIMITS.left
    far = "far from where the frame was expected, and depth differs" if verdict.far else ""
    return verdict.doubt(LIMITS.weak) or obstructed(verdict, intruded, least) or unsure(entropies) or far


def unusable(verdict: Verdict, intruded: bool, strict: float) -> str:
    """Why a pose is not used, empty when it is."""
    return verdict.doubt(strict) or obstructed(verdict, intruded, LIMITS.beside)


def verify(pair: Pair, tracked: Tracked, level: int = LIMITS.level) -> Verdict:
    """Hold a pose against all the spread-out points of the keyframe, their brightness on a level of the pyramid."""
    if tracked.points < LIMITS.points:
        return Verdict(0.0, 0.0, 0.0, points=tracked.points)
    if not np.isfinite(tracked.T_frame_kf).all():
        return Verdict(0.0, 0.0, 0.0)
    witnesses, state = pair.keyframe.witnesses, State(tracked.T_frame_kf, tracked.affine)
    found = pair.backend.verify(pair.frame.view, level, pair.keyframe.points, witnesses, state, pair.noise, LIMITS.gray)
    if abs(tracked.affine[0]) > LIMITS.gain:
        found = found._replace(bright=0, hidden_bright=0)
    verdict = judged(found, len(witnesses))
    if verdict.hidden < LIMITS.in_front or not verdict.doubt(LIMITS.weak):
        return verdict
    rest = unhidden(found)
    beside = judged(rest, len(witnesses))  # what can be seen at all, if that is enough, and sure of the pose
    if rest.with_depth < LIMITS.beside or beside.doubt(LIMITS.sure):
        return verdict
    return replace(beside, hidden=verdict.hidden)


def judged(found: Agreement, witnesses: int) -> Verdict:
    """Counts as shares of so many witnesses."""
    few = 0 < found.with_depth < LIMITS.few_depths  # judged by brightness alone; one without any depth is broken
    near = 1.0 if few else found.near / max(found.with_depth, 1)
    hidden = found.hidden / max(found.with_depth, 1)
    seen = found.seen - found.hidden
    bright = found.bright / max(found.seen, 1)
    return Verdict(found.seen / max(witnesses, 1), bright, near, hidden, seen, found.with_depth)


def unhidden(found: Agreement) -> Agreement:
    """The same without the points that something hides."""
    return Agreement(
        found.seen - found.hidden, found.bright - found.hidden_bright, found.with_depth - found.hidden, found.near, 0, 0
    )
