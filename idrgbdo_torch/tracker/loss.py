"""What becomes of a frame that is lost: found again, held at the last pose, or the begin of a new segment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..config import Config
from ..frame import Frame, Keyframe
from ..kernels.se3 import inverse
from ..odometry import Status, TrackResult
from .alignment import blind
from .doubt import BLURRED, EVERY, sharpness, sharpness_since
from .facing import Facing
from .intruder import blocked
from .joining import join
from .motion import PATIENCE
from .recovery import Found, find_in_newest, find_in_places, find_in_window, find_near
from .reference import Reference
from .results import found_in, held
from .surface import lies_on_surface
from .tracking import Pair, Tracked
from .verification import LIMITS
from .window import Window

Array = NDArray[np.float64]


class Losing(Facing):
    """An odometry's answers to a loss. It makes and adopts keyframes, see IdRgbdo."""

    config: Config

    def _pair(self, frame: Frame, reference: Reference) -> Pair:
        """A frame against the newest keyframe."""
        raise NotImplementedError

    def _keyframe(
        self, frame: Frame, T_frame_world: Array | None = None, tracked: Tracked | None = None
    ) -> Keyframe | None:
        """A keyframe of a frame at a pose, None where it has too few candidates; tracked: against the newest one."""
        raise NotImplementedError

    def _adopt(self, keyframe: Keyframe, T_kf_previous: Array | None = None) -> Reference:
        """Track against a keyframe from now on."""
        raise NotImplementedError

    def _keyframe_of_last(self) -> Keyframe | None:
        """A keyframe of the last frame that was tracked; None where it is one, or cannot be."""
        last = self.motion.frame
        if last is None or last.timestamp == self.history.keyframe_times[-1] or self._blurred(last):
            return None
        if self.history.doubted is not None or self.motion.astray:
            return None
        return self._keyframe(last, self.motion.T_cam_world, self.last[1] if self.last else None)

    def _adopt_last(self, keyframe: Keyframe) -> None:
        """What is seen after a loss is most likely the last that was seen before, so that is a keyframe."""
        self.motion.said = self.motion.T_cam_world  # a lost frame is held there, wherever the window moves it
        self._adopt(keyframe, self.history.T_cam_kf[-1])

    def _blurred(self, last: Frame) -> bool:
        """Whether the last frame was blurred."""
        if self.reference is None:
            return False
        pair, T_last_kf = self._pair(last, self.reference), self.motion.T_cam_world @ inverse(self.reference.T_kf_world)
        return sharpness(pair, T_last_kf) < BLURRED and not self._only_looks_blurred(pair, T_last_kf)

    def _only_looks_blurred(self, pair: Pair, T_frame_kf: Array) -> bool:
        """Whether it does not matter: after a wide step slopes differ anyway, and depth may be sure of the pose."""
        return not self.motion.at_video_rate and lies_on_surface(pair, T_frame_kf)

    def _start_segment(self, frame: Frame, reason: str) -> TrackResult:
        """Begin at the last pose: the first frame, or one after too many lost ones; lost where it lacks points."""
        if (keyframe := self._keyframe(frame)) is None:
            return self._hold(frame, reason)
        first = self.reference is None
        self._leave_window()
        self.motion.lose()
        self.motion.T_cam_world = self.motion.shown
        self.history.segment = 0 if first else self.history.new_segment()
        self._adopt(keyframe)
        self.motion.watch(keyframe, len(self.history.keyframe_poses) - 1)
        self.motion.time, self.lost_in_a_row = frame.timestamp, 0
        reason = "" if first else "a new segment starts here, at the last known pose"
        return replace(self._held(frame, Status.OK if first else Status.LOST, reason), keyframe=True)

    def _leave_window(self) -> None:
        """What comes next is not tied to the keyframes so far."""
        self.history.doubted = None
        self.history.leave_all(self.window.members.keyframes)
        self.window = Window(self.config, self.noise, self.backend)
        self.motion.forget_place()
        self.motion.glances.forget()
        self.reference = None

    def _found_again(self, frame: Frame) -> TrackResult | None:
        """A lost frame in another keyframe than the newest, as a keyframe of its own; None where it is in none.

        By its features first: where they find nothing they cost a fifth of the direct search.
        """
        if blind(frame):
            return None
        window, history = self.window_keyframes(), self.history
        number, (newest, _) = window.popitem()
        pair = Pair(frame, newest, self.noise, self.backend)
        if history.doubted is not None:  # else it has been tried
            window[number] = newest, history.keyframe_poses[number]
        expected = self.motion.predicted(self.motion.gap(frame.timestamp))
        searches: list[Callable[[], Found | None]] = [
            lambda: find_in_window(pair, expected, window),
            lambda: find_in_places(pair, history.places.likely(pair.frame, self.lost_in_a_row)),
            lambda: find_near(pair, expected, window),
        ]
        contested = newest.intruded or self.motion.contested
        if not (self.motion.at_video_rate and contested):  # else it may show the same thing in front
            searches.append(lambda: find_in_newest(pair, number, expected @ inverse(history.keyframe_poses[number])))
        for search in searches:
            if (found := search()) and (confronted := self._found(frame, found)):
                return self._adopt_found(frame, confronted)
        return None

    def _found(self, frame: Frame, found: Found) -> Found | None:
        """Where a frame was found; None where the last frames contradict, as both may show the same thing in front.

        They are not asked where nine tenths of the points agree: what moves with the camera leaves more to the rest.
        """
        if found.verdict.is_all:
            return found
        T_frame_world = found.T_frame_kf @ self.history.keyframe_poses[found.number]
        verdict = self._confronted(frame, T_frame_world, found.verdict, False)
        return None if verdict.doubt(LIMITS.weak) else replace(found, verdict=verdict)

    def _adopt_found(self, frame: Frame, found: Found, T_cam_doubted: Array | None = None) -> TrackResult | None:
        """Go on from where a frame was found, with a keyframe of it; None where it can't be one.

        T_cam_doubted: where it was said to be by keyframes in doubt, which are corrected by what that was off.
        """
        history = self.history
        self.motion.judge(found.verdict, False)
        T_cam_world = found.tracked.T_frame_kf @ history.keyframe_poses[found.number]
        if (keyframe := self._keyframe(frame, T_cam_world)) is None:
            return None
        if history.known(found.number):
            history.settle(frame.timestamp, T_cam_doubted, T_cam_world)
            if found.number not in history.in_window:
                self._leave_window()
        self.motion.move(T_cam_world, frame, 0.0)
        self.motion.lose()
        self.reference, self.lost_in_a_row, self.last = None, 0, None
        history.segment = history.segments[found.number]
        self._adopt(keyframe)
        history.add_frame(frame.timestamp, np.eye(4))
        return found_in(self.motion.T_cam_world, found.tracked, history.keyframe_times[found.number], history.segment)

    def _settled(self, frame: Frame, tracked: Tracked, reference: Reference) -> TrackResult | None:
        """A frame that was measured in doubt, found in a keyframe from before; None where it is in no doubt or unknown.

        One that is blurred itself is not looked for: it would be as doubtful.
        """
        history = self.history
        if history.doubted is None:
            return None
        T_cam_world = tracked.T_frame_kf @ reference.T_kf_world
        pair = Pair(frame, reference.keyframe, self.noise, self.backend)
        history.doubtful_frames += 1
        before = self.window.members.keyframes[-1].frame
        if sharpness_since(pair, tracked.T_frame_kf, before) < BLURRED:
            return None
        attempt, again = divmod(history.sharp_frames, EVERY)
        history.sharp_frames += 1
        found = find_near(pair, T_cam_world, window := self.window_keyframes())
        if found is None and not again and (found := find_in_window(pair, T_cam_world, window)) is None:
            known = [place for place in history.places.likely(frame, attempt) if history.known(place.number)]
            found = find_in_places(pair, known)
        return None if found is None else self._adopt_found(frame, found, T_cam_world)

    def _joined(self, frame: Frame, result: TrackResult) -> TrackResult:
        """Look for a new keyframe in the places of earlier segments; where it is found, the present one joins them."""
        history, reference = self.history, self.reference
        if history.doubted is not None:
            return result
        earlier = [p for p in history.places.likely(frame, 0) if history.segments[p.number] < history.segment]
        if reference is None or (found := find_in_places(self._pair(frame, reference), earlier)) is None:
            return result
        return join(found, history, self.window, self.motion, reference, result)

    def _lost(self, frame: Frame, reason: str) -> TrackResult:
        """Stay where we were and say so; after too many such frames begin anew, with this one."""
        if self.lost_in_a_row < PATIENCE:
            return self._hold(frame, reason)
        if self.motion.waits(frame.timestamp) and blocked(frame, self._sights(self.motion.T_cam_world)):
            return self._hold(frame, "something blocks the view")
        return self._start_segment(frame, reason)

    def _hold(self, frame: Frame, reason: str) -> TrackResult:
        """Stay where we were and say so."""
        self.lost_in_a_row += 1
        self.motion.lose()
        return self._held(frame, Status.LOST, reason)

    def _held(self, frame: Frame, status: Status, reason: str) -> TrackResult:
        """A frame stays at the last pose, and joins the history there."""
        T_kf_world = self.motion.T_cam_world if self.reference is None else self.reference.T_kf_world
        self.history.add_frame(frame.timestamp, self.motion.T_cam_world @ inverse(T_kf_world))
        self.last = None
        return held(self.motion.shown, status, reason, self.history.segment)
