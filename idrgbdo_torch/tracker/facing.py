"""What an odometry asks where something may stand in front of the view: keyframes of the window and the last frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..frame import Frame
from ..kernels.se3 import inverse
from ..measurement import State
from .alignment import align_beside
from .elders import CLEARLY, confirmed, explained
from .glances import Glance, Sight
from .inspection import Shown
from .intruder import agreement, outlined, some_views
from .motion import Motion
from .reference import Reference
from .results import after
from .surface import lies_on_all
from .tracking import CLOSE, Pair, Tracked
from .verification import LIMITS, Verdict, doubtful

Array = NDArray[np.float64]

ASTRAY = "a pose beside something in front was doubtful, and no older keyframe confirms those since"
HELD = np.diag([1.0 / 0.005**2] * 3 + [1.0 / 0.015**2] * 3)  # information by which a pose stays where it is expected


class Facing(Shown):
    """An odometry's questions about what is in front of it."""

    motion: Motion
    lost_in_a_row: int

    def _sights(self, T_frame_world: Array) -> list[Sight]:
        """What keyframes of the window and the last frames saw, from a frame at this pose (4, 4)."""
        return some_views(self.window_keyframes(), T_frame_world) + self.motion.glances.sights(T_frame_world)

    def _confronted(self, frame: Frame, T_frame_world: Array, verdict: Verdict, intruded: bool) -> Verdict:
        """The verdict, and what the last frames say to a pose (4, 4) beside what is in front: it leaves few points.

        intruded: something was in front of the keyframe. After wide steps they saw little of what the frame sees.
        """
        asked = self._faces(verdict, intruded) and self.motion.at_video_rate and not verdict.on_surface
        if not asked or verdict.doubt(LIMITS.lost):
            return verdict
        seen = self.motion.carried.beside(frame) if self.motion.carried else frame
        return replace(verdict, lately=agreement(seen, self._sights(T_frame_world)))

    def _verdict(self, frame: Frame, tracked: Tracked, verdict: Verdict, reference: Reference) -> Verdict:
        """Likewise, of a pose against the newest keyframe. Where depth shows that nothing is in front of anything that
        the window knows, the last frames, in which something seemed to be, are not asked.
        """
        T_frame_world, intruded = tracked.T_frame_kf @ reference.T_kf_world, reference.keyframe.intruded
        if self._faces(verdict, intruded) and verdict.hidden <= LIMITS.in_front:
            alone = lies_on_all(frame, T_frame_world, self.window.members, self.noise, self.backend)
            verdict = replace(verdict, on_surface=alone and verdict.bright > LIMITS.alike)
        return self._confronted(frame, T_frame_world, verdict, intruded)

    def _faces(self, verdict: Verdict, intruded: bool) -> bool:
        """Whether something is in front of the view, or was just now."""
        return self.motion.contested or self.motion.astray or intruded or verdict.hidden > LIMITS.in_front

    def _reached(self, pair: Pair, tracked: Tracked, verdict: Verdict) -> tuple[Tracked, Verdict, bool]:
        """A frame's pose against the newest keyframe, and whether a hand can have brought the camera there.

        Beside something in front few points are left, which poses far apart explain; of two that explain as much, that
        near the predicted one is taken. Where that leaps too, though it was held, the points are sure of it.
        """
        reference, motion = self.reference, self.motion
        if reference is None or self.lost_in_a_row or not self._faces(verdict, reference.keyframe.intruded):
            return tracked, verdict, True
        timestamp, T_kf_world = pair.frame.timestamp, reference.T_kf_world
        if not motion.leaps(tracked.T_frame_kf @ T_kf_world, timestamp):
            return tracked, verdict, True
        guess = State(motion.predicted(motion.gap(timestamp)) @ inverse(T_kf_world), tracked.affine)
        near, second = align_beside(pair, guess, reference.index, HELD, CLOSE)
        second = self._verdict(pair.frame, near, second, reference)
        if second.doubt(LIMITS.sure) or second.score < verdict.score - CLEARLY:
            return tracked, verdict, False
        return near, second, True

    @property
    def _newest(self) -> Reference:
        """What a frame is tracked against, once there is something."""
        assert self.reference is not None
        return self.reference

    def _doubts(self, frame: Frame, tracked: Tracked, verdict: Verdict, entropies: Array) -> str:
        """Why a pose is doubtful that is used, empty where it is not."""
        motion = self.motion
        asked = (motion.obstructed or motion.astray) and self.history.doubted is None  # else the window ends before it
        if asked and confirmed(frame, self.window.members, self.noise, self.backend, tracked):
            motion.obstructed = motion.astray = False
        reason = doubtful(verdict, self._newest.keyframe.intruded, motion.obstructed, entropies)
        reason = reason or after(self.lost_in_a_row) or motion.doubt
        return reason or (ASTRAY if motion.astray else "") or self.history.doubt_reason

    def _knows_what_intrudes(self, frame: Frame, tracked: Tracked | None) -> bool:
        """Whether a frame's pose can tell; the newest keyframe may show what intrudes, so older ones are asked too."""
        if self.motion.knows_what_intrudes or tracked is None or self.history.doubted is not None:
            return self.motion.knows_what_intrudes
        return self.motion.at_video_rate and explained(frame, self.window.members, self.noise, self.backend, tracked)

    def _glance(self, frame: Frame) -> None:
        """Keep what the frame just tracked sees, now and then; without what has come in, where it can tell."""
        motion = self.motion
        if motion.glances.is_due() and not motion.astray:
            frame = motion.carried.beside(frame) if motion.carried else frame
            foreign = outlined(frame, self._sights(motion.T_cam_world)) if motion.contested else None
            motion.glances.add(Glance.of(frame, motion.T_cam_world, foreign))
