"""What an odometry asks where something may stand in front of the view: keyframes of the window and the last frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..frame import Frame
from .elders import explained
from .glances import Glance, Sight
from .inspection import Shown
from .intruder import agreement, outlined, some_views
from .motion import Motion
from .reference import Reference
from .tracking import Tracked
from .verification import LIMITS, Verdict

Array = NDArray[np.float64]


class Facing(Shown):
    """An odometry's questions about what is in front of it."""

    motion: Motion

    def _sights(self, T_frame_world: Array) -> list[Sight]:
        """What keyframes of the window and the last frames saw, from a frame at this pose (4, 4)."""
        return some_views(self.window_keyframes(), T_frame_world) + self.motion.glances.sights(T_frame_world)

    def _confronted(self, frame: Frame, tracked: Tracked, verdict: Verdict, reference: Reference) -> Verdict:
        """The verdict, and what the last frames say to the pose where something is in front: it leaves few points."""
        in_front = self.motion.contested or reference.keyframe.intruded or verdict.hidden > LIMITS.in_front
        if not in_front or verdict.doubt(LIMITS.lost):
            return verdict
        seen = self.motion.carried.beside(frame) if self.motion.carried else frame
        lately = agreement(seen, self._sights(tracked.T_frame_kf @ reference.T_kf_world))
        return replace(verdict, lately=lately)

    def _knows_what_intrudes(self, frame: Frame, tracked: Tracked | None) -> bool:
        """Whether a frame's pose can tell; the newest keyframe may show what intrudes, so older ones are asked too."""
        if self.motion.knows_what_intrudes or tracked is None or self.history.doubted is not None:
            return self.motion.knows_what_intrudes
        return self.motion.at_video_rate and explained(frame, self.window.members, self.noise, self.backend, tracked)

    def _glance(self, frame: Frame) -> None:
        """Keep what the frame just tracked sees, now and then; without what has come in, where it can tell."""
        motion = self.motion
        if motion.glances.is_due():
            frame = motion.carried.beside(frame) if motion.carried else frame
            foreign = outlined(frame, self._sights(motion.T_cam_world)) if motion.contested else None
            motion.glances.add(Glance.of(frame, motion.T_cam_world, foreign))
