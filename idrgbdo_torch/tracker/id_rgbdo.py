"""ID-RGBDO: the system, in the paper's order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .. import configfile
from ..config import Config
from ..frame import Frame, Keyframe, RgbdFrame, prepare
from ..kernels.se3 import inverse
from ..measurement import Noise, State, kernel_noise, with_blur
from ..odometry import Status, TrackResult
from ..trajectory import Trajectory
from .alignment import align, displacement
from .backends import backend_named
from .history import History
from .keyframe import make_keyframe, wants_keyframe
from .mapping import NOTHING, Cloud, keyframe_cloud
from .motion import Motion, turn_rate
from .reference import Reference
from .selection import point_bits, select_points
from .tracking import Pair, Tracked, motion_information
from .verification import LIMITS, unsure
from .warmup import warm_up
from .window import Window

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FEWEST_CANDIDATES = 16  # that make a keyframe
PATIENCE = 3  # lost frames in a row before a new segment starts
KEYFRAME_GAP = 1.0 / 30.0  # s, gap of the motion prior that a new keyframe's points are chosen with


class IdRgbdo:
    """Information-driven direct RGB-D odometry (an Odometry)."""

    name = "id-rgbdo"

    def __init__(self, config: Config | None = None, *, compile_ahead: bool = True) -> None:
        """compile_ahead: compile the kernels now if they are not in the cache (seconds, with a notice; see warmup)."""
        self.config = config or Config()
        configfile.check(self.config)
        self.noise = kernel_noise(self.config.noise, self.config.tracking.patch)
        self.backend = backend_named(self.config.backend)
        self.reset()
        if compile_ahead and self.config.backend == "fused":
            warm_up(lambda: IdRgbdo(compile_ahead=False))

    def reset(self, T_world_cam: Tensor | None = None) -> None:
        """Forget everything; the next frame gets the pose T_world_cam (identity by default)."""
        self.rng = np.random.default_rng(self.config.seed)
        self.motion = Motion.at(np.eye(4) if T_world_cam is None else inverse(T_world_cam.double().numpy()))
        self.reference: Reference | None = None
        self.window = Window(self.config, self.noise, self.backend)
        self.history = History()
        self.lost_in_a_row = 0
        self.last: tuple[Keyframe, Tracked] | None = None  # what the last frame was tracked against

    def track(self, rgbd: RgbdFrame) -> TrackResult:
        """The pose of the next frame (sections 4 and 5)."""
        frame, motion, reference = prepare(rgbd, self.config.tracking.blur), self.motion, self.reference
        if reference is None:
            return self._start_segment(frame, "too few points with depth and texture to start from")
        dt = motion.gap(frame.timestamp)
        guess = motion.predicted(dt) @ inverse(reference.T_kf_world)
        resting = motion.T_cam_world @ inverse(reference.T_kf_world)
        prior = motion_information(self.config, dt)
        motion.turn = turn_rate(guess, resting, dt)
        noise = with_blur(self.noise, self.config.noise, frame.camera.fx, motion.turn, reference.turn)
        pair = Pair(frame, reference.keyframe, noise, self.backend)
        self._choose(reference, pair, guess, prior)
        tracked, verdict, motion.surprise_px = align(
            pair, State(guess, reference.affine), resting, reference.index, prior, self.config.tracking.levels,
            motion.surprise_px,
        )  # fmt: skip
        if reason := verdict.doubt(LIMITS.lost):
            return self._lost(frame, reason)
        entropies = self.backend.freedom_entropies(tracked.information)
        after_loss = "the frame before was lost" if self.lost_in_a_row else ""
        reason = verdict.doubt(LIMITS.weak) or unsure(entropies) or after_loss
        reference.entropies.append(entropies)
        reference.affine = tracked.affine
        motion.move(tracked.T_frame_kf @ reference.T_kf_world, frame.timestamp, 0.0 if self.lost_in_a_row else dt)
        self.lost_in_a_row = 0
        result = self._measured(frame, reference, tracked, Status.WEAK if reason else Status.OK, reason)
        if wants_keyframe(reference.entropies, self.config.keyframe) and self._new_keyframe(frame):
            result = replace(result, keyframe=True, T_world_cam=torch.from_numpy(inverse(self.motion.T_cam_world)))
        return result

    def _choose(self, reference: Reference, pair: Pair, T_frame_kf: Array, prior: Array) -> None:
        """The points to track: chosen anew when the view has moved by the margin that kept them inside the image."""
        if not self.config.selection.per_frame:
            return
        if displacement(pair, reference.T_chosen, T_frame_kf) < self.config.selection.margin:
            return
        reference.T_chosen = T_frame_kf
        reference.index = self._select(reference.keyframe, T_frame_kf, self.config.selection.points, prior, pair.noise)

    def _select(self, keyframe: Keyframe, T_frame_kf: Array, m: int, prior: Array, noise: Noise) -> Index:
        return select_points(keyframe, T_frame_kf, m, prior, self.config.selection, noise, self.rng, self.backend)

    def _new_keyframe(self, frame: Frame) -> bool:
        """Make a keyframe of the frame just tracked and refine the window; False where it has too few candidates."""
        keyframe = make_keyframe(frame, self.config, self.rng, self.backend)
        if len(keyframe.points.uv) < FEWEST_CANDIDATES:
            return False
        self._adopt(keyframe, self.history.T_cam_kf[-1])
        return True

    def _adopt(self, keyframe: Keyframe, T_kf_previous: Array | None = None) -> None:
        """Choose a keyframe's points, add it to the window and to history, and track against it from now on.

        T_kf_previous: its pose as tracked against the keyframe before, None where it was not.
        """
        windowed = self.config.window.enabled
        cloud = NOTHING if windowed else keyframe_cloud(keyframe)
        self.history.add_keyframe(keyframe.frame.timestamp, self.motion.T_cam_world, T_kf_previous, cloud)
        prior = motion_information(self.config, KEYFRAME_GAP)
        few, many = self.config.selection.points, self.config.window_points
        index = self._select(keyframe, np.eye(4), few, prior, self.noise)
        if windowed:
            chosen = index if many == few else self._select(keyframe, np.eye(4), many, prior, self.noise)
            keyframe = self._refine(keyframe, chosen)
        self.history.condense()
        self.reference = Reference(keyframe, self.motion.T_cam_world, self.motion.turn, index)

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

    def _start_segment(self, frame: Frame, reason: str) -> TrackResult:
        """Begin at the last pose: the first frame, or one after too many lost ones; lost where it lacks points."""
        keyframe = make_keyframe(frame, self.config, self.rng, self.backend)
        if len(keyframe.points.uv) < FEWEST_CANDIDATES:
            return self._hold(frame, reason)
        first = self.reference is None
        for old in self.window.members.keyframes:
            self.history.leave(0, old)
        self.window = Window(self.config, self.noise, self.backend)
        self.reference = None
        self.motion.lose()
        self._adopt(keyframe)
        self.motion.time = frame.timestamp
        self.history.segment += 0 if first else 1
        self.lost_in_a_row = 0
        reason = "" if first else "a new segment starts here, at the last known pose"
        return replace(self._held(frame, Status.OK if first else Status.LOST, reason), keyframe=True)

    def _lost(self, frame: Frame, reason: str) -> TrackResult:
        """Stay where we were and say so; after too many such frames begin anew, with this one."""
        if self.lost_in_a_row >= PATIENCE:
            return self._start_segment(frame, reason)
        return self._hold(frame, reason)

    def _hold(self, frame: Frame, reason: str) -> TrackResult:
        self.lost_in_a_row += 1
        self.motion.lose()
        return self._held(frame, Status.LOST, reason)

    def _measured(
        self, frame: Frame, reference: Reference, tracked: Tracked, status: Status, reason: str
    ) -> TrackResult:
        """The result of a frame that was tracked; it joins the history."""
        self.history.add_frame(frame.timestamp, tracked.T_frame_kf)
        self.last = (reference.keyframe, tracked)
        return TrackResult(
            T_world_cam=torch.from_numpy(inverse(self.motion.T_cam_world)),
            status=status,
            reason=reason,
            reference_time=self.history.keyframe_times[-1],
            T_ref_cam=torch.from_numpy(inverse(tracked.T_frame_kf)),
            information=torch.from_numpy(tracked.information),
            points=tracked.points,
            iterations=tracked.iterations,
            entropy_bits=tuple(reference.entropies[-1].tolist()),
            segment=self.history.segment,
        )

    def _held(self, frame: Frame, status: Status, reason: str) -> TrackResult:
        """The result of a frame that stays at the last pose; it joins the history."""
        T_kf_world = self.motion.T_cam_world if self.reference is None else self.reference.T_kf_world
        self.history.add_frame(frame.timestamp, self.motion.T_cam_world @ inverse(T_kf_world))
        self.last = None
        pose = torch.from_numpy(inverse(self.motion.T_cam_world))
        return TrackResult(T_world_cam=pose, status=status, reason=reason, segment=self.history.segment)

    def trajectory(self) -> Trajectory:
        """Every frame's pose by all that is known now, the frames after it included."""
        return self.history.trajectory()

    def map(self) -> Cloud:
        """The candidate points of all keyframes in the world, with colours and normals."""
        return self.history.map(self.window.members.keyframes)

    def map_points(self) -> tuple[Tensor, Tensor]:
        """(N, 3) float32 candidate points of all keyframes in the world, m, and their (N, 3) uint8 RGB colours."""
        cloud = self.map()
        return torch.from_numpy(cloud.xyz), torch.from_numpy(cloud.rgb)

    def window_keyframes(self) -> dict[int, tuple[Keyframe, Array]]:
        """By number, the keyframes that are still refined and their T_kf_world (4, 4); the newest is the last."""
        members, newest = self.window.members, len(self.history.keyframe_poses) - 1
        held = dict(zip(self.history.in_window, zip(members.keyframes, members.T, strict=True), strict=True))
        if self.reference is not None and newest not in held:  # without a window
            held[newest] = (self.reference.keyframe, self.reference.T_kf_world)
        return held

    def last_alignment(self) -> tuple[Keyframe, Tracked] | None:
        """The keyframe that the last frame was tracked against, and how; None where it was not tracked."""
        return self.last

    def last_points(self) -> tuple[Tensor, Tensor]:
        """The points last tracked: (N, 2) px in that frame, and (N,) bits that each adds to what the others know."""
        if self.last is None:
            return torch.zeros(0, 2, dtype=torch.float64), torch.zeros(0, dtype=torch.float64)
        keyframe, tracked = self.last
        return point_bits(keyframe, tracked.T_frame_kf, tracked.index, self.noise, self.backend)

    def last_candidates(self) -> Tensor:
        """(M, 2) px of the candidates that the last frame sees: those it could have been tracked with, else its own."""
        if self.last is not None:
            keyframe, tracked = self.last
            everyone = np.arange(len(keyframe.points.uv))
            return point_bits(keyframe, tracked.T_frame_kf, everyone, self.noise, self.backend)[0]
        if self.reference is not None and self.reference.keyframe.frame.timestamp == self.history.times[-1]:
            return torch.from_numpy(self.reference.keyframe.points.uv)
        return torch.zeros(0, 2, dtype=torch.float64)
