"""ID-RGBDO: the system, in the paper's order."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..config import Config, checked
from ..definitions.given import rigid
from ..frame import Frame, Keyframe, RgbdFrame, check_next
from ..kernels.se3 import inverse
from ..measurement import Noise, State, tracked_noise, with_blur
from ..odometry import TrackResult
from .alignment import align, displacement, is_far
from .backends import backend_named
from .between import LATE_COLOR, track_between
from .doubt import BLURRED, KEPT_IN_VIEW, sharpness_since
from .elders import held_against
from .features import strangers
from .history import History
from .instant import steady, takes_time
from .intruder import without_intruder
from .keyframe import FEWEST_CANDIDATES, make_keyframe, wants_keyframe
from .loss import Losing
from .mapping import NOTHING, keyframe_cloud
from .motion import Motion, turn_rate
from .reference import Reference
from .results import measured
from .selection import select_points, view_margin
from .tracking import KEYFRAME_GAP, Pair, Tracked, motion_information
from .verification import LIMITS, Verdict, unusable
from .warmup import warm_up
from .window import Window

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class Placed(NamedTuple):
    """A frame, its pose against the newest keyframe, and how far that is to be believed."""

    frame: Frame  # with the depth that it was placed by
    tracked: Tracked
    verdict: Verdict


class IdRgbdo(Losing):
    """Information-driven direct RGB-D odometry (an Odometry)."""

    name = "id-rgbdo"

    def __init__(self, config: Config | None = None, *, compile_ahead: bool = True) -> None:
        """compile_ahead: compile the kernels now if they are not in the cache (seconds, with a notice; see warmup)."""
        self.config = checked(config)
        self.noise = tracked_noise(self.config)
        self.backend = backend_named(self.config.backend)
        self.reset()
        if compile_ahead and self.config.backend == "fused":
            warm_up(lambda config: IdRgbdo(config, compile_ahead=False))

    def reset(self, T_world_cam: Tensor | None = None) -> None:
        """Forget everything; the next frame gets the pose T_world_cam (identity by default)."""
        start = rigid("T_world_cam", T_world_cam).numpy()
        self.motion = Motion.at(start if T_world_cam is None else inverse(start))
        self.rng = np.random.default_rng(self.config.seed)
        self.reference: Reference | None = None
        self.window, self.history = Window(self.config, self.noise, self.backend), History()
        self.lost_in_a_row = 0
        self.last: tuple[Keyframe, Tracked] | None = None  # what the last frame was tracked against

    def track(self, rgbd: RgbdFrame) -> TrackResult:
        """The pose of the next frame (sections 4 and 5). Raises IdRgbdoError for what check_next refuses."""
        check_next(rgbd, self.reference.keyframe.frame.camera if self.reference else None)
        rgbd = self.motion.look(rgbd)
        frame = steady(rgbd, self.motion.velocity(), self.config.tracking.blur)
        if self.reference is not None and self.motion.sees_late:
            return self._between(frame, self.reference)
        if self.reference is None:
            self.motion.first = rgbd.copied() if takes_time(rgbd.camera) else None
            return self._start_segment(frame, "too few points with depth and texture to start from")
        placed = self._placed(rgbd, frame)
        if (elsewhere := self._elsewhere(placed)) is not None:
            return elsewhere
        frame, reference, motion = placed.frame, self._newest, self.motion
        tracked, verdict, reached = self._reached(self._pair(frame, reference), placed.tracked, placed.verdict)
        motion.astray |= not reached
        entropies = self.backend.freedom_entropies(tracked.information)
        reason = self._doubts(frame, tracked, verdict, entropies)
        reference.entropies.append(entropies)
        reference.affine = tracked.affine
        dt = 0.0 if self.lost_in_a_row else motion.gap(frame.timestamp)
        motion.move(tracked.T_frame_kf @ reference.T_kf_world, frame, dt)
        self.lost_in_a_row, self.last = 0, (reference.keyframe, tracked)
        motion.judge(verdict, reference.keyframe.intruded)
        self.history.add_frame(frame.timestamp, tracked.T_frame_kf, tracked.information)
        time, segment = self.history.keyframe_times[-1], self.history.segment
        result = measured(motion.T_cam_world, tracked, time, reason, segment, motion.velocity())
        known = self._new_keyframe(frame, tracked, verdict, reference)
        self._glance(frame)
        if known:
            result = replace(result, keyframe=True, T_world_cam=torch.from_numpy(inverse(motion.T_cam_world)))
            return self._joined(frame, result) if self.history.segment > 0 else result
        return result

    def _placed(self, rgbd: RgbdFrame, frame: Frame) -> Placed:
        """A frame's pose against the newest keyframe, which may change on the way to one that explains it better."""
        tracked, verdict = self._align(frame, self._newest)
        if (earlier := self.motion.with_earlier_depth(frame)) is not None:
            again, second = self._align(earlier, self._newest)
            if self.motion.prefers_earlier(second.score - verdict.score):
                frame, tracked, verdict = earlier, again, second
        if takes_time(rgbd.camera) and not verdict.doubt(LIMITS.lost):
            frame, tracked, verdict = self._steadied(rgbd, tracked, self._newest)
        tracked, verdict = self._beside(frame, tracked, verdict, self._newest)
        verdict = self._verdict(frame, tracked, verdict, self._newest)
        if unusable(verdict, self._newest.keyframe.intruded, LIMITS.weak) and self._late_keyframe(frame, verdict):
            tracked, verdict = self._align(frame, self._newest)
            verdict = self._verdict(frame, tracked, verdict, self._newest)
        return Placed(frame, tracked, verdict)

    def _elsewhere(self, placed: Placed) -> TrackResult | None:
        """A frame whose pose is not used: found in another keyframe, or lost; None where it is used."""
        strict = LIMITS.sure if self.lost_in_a_row else LIMITS.lost
        reason = unusable(placed.verdict, self._newest.keyframe.intruded, strict)
        if not reason:
            return self._settled(placed.frame, placed.tracked, self._newest)
        if (found := self._found_again(placed.frame)) is not None:
            return found
        if (keyframe := self._keyframe_of_last()) is not None:
            self._adopt_last(keyframe)
        return self._lost(placed.frame, reason)

    def _steadied(self, rgbd: RgbdFrame, tracked: Tracked, reference: Reference) -> tuple[Frame, Tracked, Verdict]:
        """A frame once more, now that its velocity is known; with the second one, the first keyframe too."""
        velocity = self.motion.velocity_at(tracked.T_frame_kf @ reference.T_kf_world, rgbd.timestamp)
        still = [steady(image, velocity, self.config.tracking.blur) for image in (self.motion.first, rgbd) if image]
        if len(self.history.times) == 1 and self.motion.first and self._keyframe(still[0]):
            self.reset(torch.from_numpy(inverse(self.motion.T_cam_world)))
            self._start_segment(still[0], "")
        self.motion.first = None
        return still[-1], *self._align(still[-1], self.reference or reference)

    def _beside(
        self, frame: Frame, tracked: Tracked, verdict: Verdict, reference: Reference
    ) -> tuple[Tracked, Verdict]:
        """The same; or anew, against the segment's first keyframe without a thing that turns out to move with us."""
        carried, T_frame_world = self.motion.carried, tracked.T_frame_kf @ reference.T_kf_world
        pair = Pair(frame, reference.keyframe, self.noise, self.backend)
        if carried is None or (keyframe := carried.seen_in(pair, T_frame_world, verdict)) is None:
            if self.history.doubted is not None:
                return tracked, verdict
            smooth, members = self.motion.at_video_rate, self.window.members
            found, said = held_against(frame, members, self.noise, self.backend, tracked, verdict, smooth)
            if found is tracked:
                return tracked, said
            guess = self.motion.predicted(self.motion.gap(frame.timestamp)) @ inverse(reference.T_kf_world)
            return found, replace(said, far=is_far(pair, guess, found, said))
        self._leave_window()
        self.history.forget(carried.number)
        self.motion.begin(carried.T_kf_world)
        reference = self._adopt(keyframe)
        self.motion.begin(carried.T_frame_kf @ carried.T_kf_world)
        return self._align(frame, reference)

    def _align(self, frame: Frame, reference: Reference) -> tuple[Tracked, Verdict]:
        """A frame against the newest keyframe, from where it is expected."""
        motion, dt = self.motion, self.motion.gap(frame.timestamp)
        guess = motion.predicted(dt) @ inverse(reference.T_kf_world)
        resting = motion.T_cam_world @ inverse(reference.T_kf_world)
        prior = motion_information(self.config, dt)
        motion.turn = turn_rate(guess, resting, dt)
        pair = self._pair(frame, reference)
        self._choose(reference, pair, guess, prior)
        start, levels = State(guess, reference.affine), self.config.tracking.levels
        tracked, verdict, motion.surprise_px = align(
            pair, start, resting, reference.index, prior, levels, motion.surprise_px, motion.at_video_rate
        )
        return tracked, verdict

    def _between(self, frame: Frame, reference: Reference) -> TrackResult:
        """A frame with the colour image of the one before: it is weak, and the next one goes on from that one."""
        tracked = track_between(self._pair(frame, reference), self.motion, reference, self.config)
        self.history.add_frame(frame.timestamp, tracked.T_frame_kf, tracked.information)
        T, time, self.last = tracked.T_frame_kf @ reference.T_kf_world, self.history.keyframe_times[-1], None
        return measured(T, tracked, time, LATE_COLOR, self.history.segment)

    def _pair(self, frame: Frame, reference: Reference) -> Pair:
        noise = with_blur(self.noise, self.config.noise, frame.camera.fx, self.motion.turn, reference.turn)
        if self.motion.sees_other_things:  # by the many coarse points, which were not chosen
            noise = noise._replace(coarse=0.0)
        return Pair(frame, reference.keyframe, noise, self.backend)

    def _late_keyframe(self, frame: Frame, verdict: Verdict) -> bool:
        """Make a keyframe of the frame before, which shares most with this one, if that explains this one better."""
        last, turn = self.motion.frame, self.motion.turn
        jumps = last is not None and self.motion.at_video_rate and strangers(frame, last)
        if jumps or (keyframe := self._keyframe_of_last()) is None:
            return False
        prior = motion_information(self.config, KEYFRAME_GAP)
        index = self._select(keyframe, np.eye(4), self.config.selection.points, prior, self.noise)
        self.motion.turn = self.motion.frame_turn
        reference = Reference(keyframe, self.motion.T_cam_world, self.motion.turn, index)
        other = self._verdict(frame, *self._align(frame, reference), reference)
        helps = other.score > verdict.score and not other.doubt(LIMITS.weak)
        self.motion.turn = self.motion.frame_turn if helps else turn
        if helps or verdict.doubt(LIMITS.lost):
            self._adopt_last(keyframe)
        return helps

    def _choose(self, reference: Reference, pair: Pair, T_frame_kf: Array, prior: Array) -> None:
        """The points to track: chosen anew when the view has moved by the margin that kept them inside the image."""
        margin = view_margin(self.config.selection.margin, reference.keyframe.frame.camera)
        if not self.config.selection.per_frame or displacement(pair, reference.T_chosen, T_frame_kf) < margin:
            return
        reference.T_chosen = T_frame_kf
        reference.index = self._select(reference.keyframe, T_frame_kf, self.config.selection.points, prior, pair.noise)

    def _select(self, keyframe: Keyframe, T_frame_kf: Array, m: int, prior: Array, noise: Noise) -> Index:
        return select_points(keyframe, T_frame_kf, m, prior, self.config.selection, noise, self.rng, self.backend)

    def _new_keyframe(self, frame: Frame, tracked: Tracked, verdict: Verdict, reference: Reference) -> bool:
        """Make a keyframe of the frame just tracked, if it is time, and refine the window; False where it is not, or
        it has too few candidates.
        """
        blurred = reference.keyframe.sharp < BLURRED
        wanted = wants_keyframe(reference.entropies, self.config.keyframe) or self.history.settles
        if self.motion.astray or not (blurred or wanted):
            return False
        before = self.window.members.keyframes[-1].frame if self.window.members else frame
        pair = self._pair(frame, reference)
        sharp = sharpness_since(pair, tracked.T_frame_kf, before)
        if sharp < BLURRED and self._only_looks_blurred(pair, tracked.T_frame_kf):
            sharp = 1.0
        in_view = verdict.visible > KEPT_IN_VIEW and not self.history.settles
        if sharp < BLURRED and (in_view or not wanted):
            return False
        if (keyframe := self._keyframe(frame, self.motion.T_cam_world, tracked)) is None:
            return False
        if self.history.settles:
            self._leave_window()
        elif sharp < BLURRED and self.config.window.enabled:
            keyframe = replace(keyframe, sharp=sharp)
            if self.history.doubted is None:
                self.history.doubt(self.window.members.keyframes[-1])
        self._adopt(keyframe, self.history.T_cam_kf[-1])
        return True

    def _keyframe(
        self, frame: Frame, T_frame_world: Array | None = None, tracked: Tracked | None = None
    ) -> Keyframe | None:
        """A keyframe of a frame at a pose, None where it has too few candidates; tracked: against the newest one."""
        keyframe: Keyframe | None = self.motion.cleared(make_keyframe(frame, self.config, self.rng, self.backend))
        if keyframe and T_frame_world is not None and self._knows_what_intrudes(frame, tracked):
            keyframe = without_intruder(keyframe, self._sights(T_frame_world))
        return keyframe if keyframe and len(keyframe.points.uv) >= FEWEST_CANDIDATES else None

    def _adopt(self, keyframe: Keyframe, T_kf_previous: Array | None = None) -> Reference:
        """Choose a keyframe's points, add it to the window and to history, and track against it from now on.

        T_kf_previous: its pose as tracked against the keyframe before, None where it was not.
        """
        windowed = self.config.window.enabled and self.history.doubted is None
        cloud = NOTHING if windowed else keyframe_cloud(keyframe)
        self.history.add_keyframe(keyframe.frame.timestamp, self.motion.T_cam_world, T_kf_previous, cloud)
        prior = motion_information(self.config, KEYFRAME_GAP)
        few, many = self.config.selection.points, self.config.window_points
        index = self._select(keyframe, np.eye(4), few, prior, self.noise)
        if windowed:
            chosen = index if many == few else self._select(keyframe, np.eye(4), many, prior, self.noise)
            keyframe = self._refine(keyframe, chosen[:many])  # an uncertain pose has more points, the window has not
        self.history.condense()
        self.reference = Reference(keyframe, self.motion.T_cam_world, self.motion.turn, index)
        if keyframe.sharp >= BLURRED:
            self.history.remember(keyframe, self.backend)
        return self.reference

    def _refine(self, keyframe: Keyframe, index: Index) -> Keyframe:
        """Add a keyframe to the window, optimise, shrink; the present pose and its velocity follow."""
        affine = np.zeros(2) if self.reference is None else self.reference.affine
        self.window.add(keyframe, self.motion.T_cam_world, affine, index)
        self.history.in_window.append(len(self.history.keyframe_poses) - 1)
        self.window.optimise()
        self.history.refine(self.window.members.T)
        for place, old, departure in self.window.shrink():
            self.history.leave(place, old, departure)
        self.motion.correct(self.window.members.T[-1])
        return self.window.members.keyframes[-1]
