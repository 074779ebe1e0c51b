"""Where the camera is and how it moves: what a frame is expected from."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import inf

import numpy as np
from numpy.typing import NDArray

from ..frame import Frame, Keyframe, RgbdFrame
from ..kernels.se3 import inverse, log_se3, retract
from ..measurement import RATE
from .carried import Carried
from .glances import Glances
from .repeated import Seen, with_late_depth
from .verification import LIMITS, Verdict, obstructed

Array = NDArray[np.float64]

GOES_ON = 0.35  # of a change of velocity in the half step to come; half would be exact, were poses without noise
PATIENCE = 3  # lost frames in a row before a new segment starts
BLOCKED_S = 1.0  # s that something in front of the view is waited for
VIDEO_S = 0.2  # s between frames, up to which a pose is that sure
DECIDED = 0.1  # share of the points, summed over frames, that says whether a slow camera's colour images are late
BLOCKED = "what blocked the view may still fill it"
STRONGEST = 15.0  # m/s^2, of hands with a camera: twice that of shakes, a seventh of a pose's that has gone astray
LONGEST = 3.0  # times the last gap that a velocity is followed


@dataclass
class Motion:
    """Pose and velocity of the camera after the last frame. A new one, at some pose, rests."""

    T_cam_world: Array  # (4, 4)
    T_previous: Array  # (4, 4) of the frame before the last, for the constant velocity
    dt: float = 0.0  # s, between those two; 0 where there is no velocity
    time: float = 0.0  # s, of the last pose that was measured: lost frames since then do not count
    velocity_before: Array = field(default_factory=lambda: np.zeros(6))  # m/s and rad/s, at the frame before the last,
    dt_before: float = 0.0  # s, over which that was measured
    surprise_px: float = inf  # px in the image between the last frame's guess and pose
    turn: Array = field(default_factory=lambda: np.zeros(3))  # rad/s, of the last frame
    contested: bool = False  # something was in front of the view of the last measured frame,
    obstructed: bool = False  # and left few points,
    astray: bool = False  # a pose beside it was doubtful, and nothing has confirmed one since
    explained: bool = False  # and nothing but that disagreed in depth, so that the pose can tell what it is
    frame: Frame | None = None  # the last one, where it was measured,
    frame_turn: Array = field(default_factory=lambda: np.zeros(3))  # and its turn

    glances: Glances = field(default_factory=Glances)  # at the depth of the last ones that were measured

    first: RgbdFrame | None = None  # the first one as it came, until the velocity that it needs is known
    carried: Carried | None = None  # what may move with the camera since the segment began, until that is known
    began_blocked: bool = False  # something was in front of the view before the segment, and may be still
    restarted: bool = False  # at another pose, from which the next step is no velocity
    said: Array | None = None  # (4, 4) the last pose that was given, where it was refined since then in a loss

    lateness: float = 0.0  # by how much more of the points agreed with earlier depth, added up
    seen: Seen | None = None  # what the present frame shows, and since when

    def look(self, rgbd: RgbdFrame) -> RgbdFrame:
        """A new frame; depth that is older than its colour image is brought to that time."""
        self.seen = Seen.after(self.seen, rgbd)
        return with_late_depth(rgbd, self.seen.late_depth, self.velocity())

    def with_earlier_depth(self, frame: Frame) -> Frame | None:
        """The present frame with the depth of the one before, where its colour image may be that old; else None."""
        depth = None if self.seen is None or self.lateness <= -DECIDED else self.seen.depth_before
        return None if depth is None else replace(frame, depth=depth)

    def prefers_earlier(self, gain: float) -> bool:
        """Whether the earlier depth belongs to the colour images, now that its pose has a score that much higher.

        That is a matter of the camera, so what was clear once is not asked again: later keyframes take it for granted.
        """
        if abs(self.lateness) < DECIDED:
            self.lateness += gain
        return self.lateness > 0.0

    @property
    def sees_late(self) -> bool:
        """Whether the present frame's colour image is an earlier one, where the camera was measured then."""
        return self.seen is not None and self.seen.late_color and self._measured_since(self.seen.gray_since)

    @property
    def rests(self) -> bool:
        """Whether the present frame is an earlier one, where the camera was measured then."""
        return self.seen is not None and self.seen.late and self._measured_since(self.seen.gray_since)

    def _measured_since(self, timestamp: float) -> bool:
        return self.frame is not None and self.frame.timestamp >= timestamp

    @property
    def shown(self) -> Array:
        """The pose (4, 4) that a lost frame is held at: the last that was given."""
        return self.T_cam_world if self.said is None else self.said

    @property
    def knows_what_intrudes(self) -> bool:
        """Whether the last pose can tell what stands where nothing was: it explains the rest, or something does stand
        there, which is worse to take for the world than the world for it.
        """
        return self.explained or self.contested

    @property
    def sees_other_things(self) -> bool:
        """Whether the last image showed something that is not of the world; wide steps explain less in any case."""
        return not self.explained and self.at_video_rate

    @property
    def at_video_rate(self) -> bool:
        """Whether the last frames were so near in time that a pose is that sure."""
        return self.dt < VIDEO_S

    @property
    def doubt(self) -> str:
        """Why a pose is not to be believed that explains what is in view, empty where it is."""
        if self.carried is None or self.carried.settled:
            return ""
        return self.carried.doubt or (BLOCKED if self.began_blocked else "")

    @staticmethod
    def at(T_cam_world: Array) -> Motion:
        """Of a camera that has not been seen moving."""
        return Motion(T_cam_world, T_cam_world)

    def gap(self, timestamp: float) -> float:
        """Seconds since the last measured pose; out of order, the time says nothing, and a frame's time is taken."""
        dt = timestamp - self.time
        return dt if dt > 0.0 else 1.0 / RATE

    def predicted(self, dt: float) -> Array:
        """T_cam_world (4, 4) after dt seconds of the last velocity; the last pose for the last images."""
        if self.rests:
            return self.T_cam_world
        ratio = min(dt / self.dt, LONGEST) if self.dt > 0.0 else 0.0
        return predict(self.T_cam_world, self.T_previous, ratio)

    def velocity(self) -> Array:
        """(6,) [v, w] of a left increment of T_cam_world, m/s and rad/s, between the last two poses; 0 if unknown."""
        return twist_between(self.T_cam_world, self.T_previous, self.dt)

    def velocity_at(self, T_cam_world: Array, timestamp: float) -> Array:
        """(6,) the same at the next pose: the mean since the last one, and a part of what that changed once more."""
        now, before = twist_between(T_cam_world, self.T_cam_world, self.gap(timestamp)), self.velocity()
        return now + GOES_ON * (now - before) if before.any() else now

    def leaps(self, T_cam_world: Array, timestamp: float) -> bool:
        """Whether the next pose would take an acceleration that no hand gives a camera; False without a velocity.

        Not where it is reached from the pose before the last: then that one was the leap.
        """
        gap = self.gap(timestamp)
        if self.dt <= 0.0 or self.rests or self._reaches(T_cam_world, self.T_cam_world, gap, self.velocity(), self.dt):
            return False
        before, dt = self.velocity_before, self.dt_before
        return dt <= 0.0 or not self._reaches(T_cam_world, self.T_previous, gap + self.dt, before, dt)

    @staticmethod
    def _reaches(T_cam_world: Array, T_before: Array, gap: float, velocity: Array, dt: float) -> bool:
        """Whether a pose is reached from one `gap` s before, where the mean velocity over dt s was known."""
        change = twist_between(T_cam_world, T_before, gap) - velocity
        return float(np.linalg.norm(change[:3])) <= STRONGEST * 0.5 * (gap + dt)

    def move(self, T_cam_world: Array, frame: Frame, dt: float) -> None:
        """To a frame's measured pose; dt 0 where the step from the one before is no velocity. The same images say
        nothing about velocity: it is that of the ones before, and what it is next is over the time since these.
        """
        if self.rests:
            self.T_cam_world, self.frame, self.said = T_cam_world, frame, None
            return
        self.velocity_before, self.dt_before = self.velocity(), self.dt
        self.T_previous, self.T_cam_world, self.dt = self.T_cam_world, T_cam_world, 0.0 if self.restarted else dt
        self.restarted = False
        self.frame, self.frame_turn, self.time, self.said = frame, self.turn, frame.timestamp, None
        if self.carried and self.carried.settled:
            self.forget_place()

    def judge(self, verdict: Verdict, intruded: bool) -> None:
        """What stood in front of the last measured frame, against a keyframe that was intruded upon or not."""
        least = LIMITS.left_again if self.obstructed else LIMITS.left
        self.obstructed = bool(obstructed(verdict, intruded, least))
        self.contested = intruded or verdict.hidden > LIMITS.in_front
        self.astray |= self.contested and bool(verdict.doubt(LIMITS.weak))
        self.explained = verdict.explains and self.at_video_rate

    def waits(self, timestamp: float) -> bool:
        """Whether what stands in front is waited for: it had entered before the loss, and not long ago; what the camera
        carries will not go.
        """
        stays = self.carried is not None and self.carried.thing is not None
        return self.contested and not stays and timestamp - self.time < BLOCKED_S

    def correct(self, T_cam_world: Array) -> None:
        """The present pose was refined: the one before follows, so that the velocity stays."""
        self.T_previous = self.T_previous @ inverse(self.T_cam_world) @ T_cam_world
        self.T_cam_world = T_cam_world

    def move_world(self, T_old_new: Array) -> None:
        """See everything from another world, which lies at this pose (4, 4) in the old one."""
        self.T_cam_world, self.T_previous = self.T_cam_world @ T_old_new, self.T_previous @ T_old_new
        self.glances.move_world(T_old_new)
        if self.carried:
            self.carried.T_kf_world = self.carried.T_kf_world @ T_old_new

    def watch(self, keyframe: Keyframe, number: int) -> None:
        """A segment begins at the present pose, with this keyframe: see what in it moves with the camera."""
        self.carried = Carried.of(keyframe, self.T_cam_world, number, self.carried)
        self.astray = False
        known = self.carried.thing is not None or not self.carried.texture.any()
        self.began_blocked, self.obstructed = self.contested and not known, False

    def forget_place(self) -> None:
        """The segment's first keyframe is not looked at any more; what moves with the camera stays known."""
        self.carried = self.carried and self.carried.kept

    def cleared(self, keyframe: Keyframe) -> Keyframe:
        """A new keyframe without what is known to move with the camera."""
        return self.carried.cleared(keyframe) if self.carried else keyframe

    def begin(self, T_cam_world: Array) -> None:
        """At another pose, with no velocity, and none of the doubts about the one before."""
        self.T_cam_world = self.T_previous = T_cam_world
        self.astray, self.restarted = False, True
        self.lose()

    def lose(self) -> None:
        """No velocity and no expectation any more."""
        self.dt, self.dt_before, self.surprise_px, self.frame = 0.0, 0.0, inf, None


def predict(T_a: Array, T_b: Array, ratio: float) -> Array:
    """Constant velocity: the motion from T_b to T_a (cam_world poses), times ratio, once more from T_a."""
    T: Array = retract(ratio * log_se3(T_a @ inverse(T_b)), T_a)
    return T


def twist_between(T_new: Array, T_old: Array, dt: float) -> Array:
    """(6,) [v, w] m/s and rad/s between two cam_world poses dt seconds apart; 0 where dt is."""
    return np.zeros(6) if dt == 0.0 else np.asarray(log_se3(T_new @ inverse(T_old)) / dt)


def turn_rate(T_new: Array, T_old: Array, dt: float) -> Array:
    """Angular velocity (3,) rad/s between two cam_world poses dt seconds apart."""
    turn: Array = log_se3(T_new @ inverse(T_old))[3:] / dt
    return turn
