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
from ..measurement import RATE, Noise, kernel_noise, with_blur
from ..odometry import Status, TrackResult
from ..trajectory import Trajectory
from .alignment import align, displacement
from .backends import backend_named
from .keyframe import freedom_entropies, make_keyframe, wants_keyframe
from .mapping import NOTHING, Cloud, condense, keyframe_cloud, world_cloud
from .selection import point_bits, select_points
from .tracking import Tracked, motion_information, predict, turn_rate
from .verification import LOST_BELOW, WEAK_BELOW, unsure
from .warmup import warm_up
from .window import Window

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FEWEST_CANDIDATES = 16  # that make a keyframe
PATIENCE = 3  # lost frames in a row before a new segment starts


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
        self.keyframe: Keyframe | None = None
        self.window = Window(self.config, self.noise)
        self.T_cam_world = np.eye(4) if T_world_cam is None else inverse(T_world_cam.double().numpy())
        self.T_kf_world = self.T_cam_world
        self.T_previous = self.T_cam_world  # of the frame before the last, for the constant velocity
        self.dt_previous = 0.0  # s, between those two; 0 where there is no velocity
        self.pose_time = 0.0  # s, of the last pose that was measured: lost frames since then do not count
        self.surprise_px = np.inf  # px in the image between the last frame's guess and pose
        self.turn = np.zeros(3)  # rad/s, of the last frame
        self.keyframe_turn = np.zeros(3)  # and of the keyframe
        self.affine = np.zeros(2)
        self.index = np.zeros(0, dtype=np.int64)  # the points being tracked, among the keyframe's candidates
        self.T_chosen = np.eye(4)  # the guess of T_frame_kf that they were chosen for
        self.entropies: list[Array] = []  # per degree of freedom, of the frames tracked since the keyframe
        self.lost_in_a_row = 0
        self.segment = 0
        self.times: list[float] = []
        self.references: list[int] = []  # number of the keyframe of every frame
        self.T_cam_kf: list[Array] = []
        self.keyframe_poses: list[Array] = []  # T_kf_world of every keyframe, refined as long as it is in the window
        self.keyframe_times: list[float] = []
        self.in_window: list[int] = []  # which of them that are
        self.clouds: list[Cloud] = []  # map points of every keyframe that has left the window
        self.last: tuple[Keyframe, Tracked] | None = None  # what the last frame was tracked against

    def track(self, rgbd: RgbdFrame) -> TrackResult:
        """The pose of the next frame (sections 4 and 5)."""
        frame = prepare(rgbd)
        if self.keyframe is None:
            return self._start_segment(frame, "too few points with depth and texture to start from")
        dt = frame.timestamp - self.pose_time
        dt = dt if dt > 0.0 else 1.0 / RATE  # out of order, the time says nothing
        ratio = min(dt / self.dt_previous, 3.0) if self.dt_previous > 0.0 else 0.0
        guess = predict(self.T_cam_world, self.T_previous, ratio) @ inverse(self.T_kf_world)
        prior = motion_information(self.config, dt)
        resting = self.T_cam_world @ inverse(self.T_kf_world)
        self.turn = turn_rate(guess, resting, dt)
        noise = with_blur(self.noise, self.config.noise, frame.camera.fx, self.turn, self.keyframe_turn)
        index = self._choose(self.keyframe, guess, prior, noise)
        tracked, verdict, self.surprise_px = align(
            frame, self.keyframe, guess, resting, self.affine, index, prior, noise, self.config.tracking.levels,
            self.surprise_px, self.backend,
        )  # fmt: skip
        if reason := verdict.doubt(LOST_BELOW):
            return self._lost(frame, reason)
        entropies = freedom_entropies(tracked.information)
        after_loss = "the frame before was lost" if self.lost_in_a_row else ""
        reason = verdict.doubt(WEAK_BELOW) or unsure(entropies) or after_loss
        self.entropies.append(entropies)
        self._move(tracked.T_frame_kf @ self.T_kf_world, 0.0 if self.lost_in_a_row else dt)
        self.affine, self.lost_in_a_row = tracked.affine, 0
        result = self._result(frame, tracked, Status.WEAK if reason else Status.OK, reason, entropies)
        if wants_keyframe(self.entropies, self.config.keyframe) and self._new_keyframe(frame):
            result = replace(result, keyframe=True, T_world_cam=torch.from_numpy(inverse(self.T_cam_world)))
        return result

    def _choose(self, keyframe: Keyframe, T_frame_kf: Array, prior: Array, noise: Noise) -> Index:
        """The points to track: chosen anew when the view has moved by the margin that kept them inside the image."""
        if not self.config.selection.per_frame:
            return self.index
        if displacement(keyframe, self.T_chosen, T_frame_kf, self.backend) < self.config.selection.margin:
            return self.index
        self.T_chosen = T_frame_kf
        self.index = self._select(keyframe, T_frame_kf, self.config.selection.points, prior, noise)
        return self.index

    def _select(self, keyframe: Keyframe, T_frame_kf: Array, m: int, prior: Array, noise: Noise) -> Index:
        return select_points(keyframe, T_frame_kf, m, prior, self.config.selection, noise, self.rng, self.backend)

    def _move(self, T_cam_world: Array, dt: float) -> None:
        self.T_previous, self.T_cam_world, self.dt_previous = self.T_cam_world, T_cam_world, dt

    def _new_keyframe(self, frame: Frame) -> bool:
        """Make a keyframe of the frame just tracked and refine the window; False where it has too few candidates."""
        keyframe = make_keyframe(frame, self.config, self.rng)
        if len(keyframe.points.uv) < FEWEST_CANDIDATES:
            return False
        self._adopt(keyframe)
        return True

    def _adopt(self, keyframe: Keyframe) -> None:
        self.keyframe_poses.append(self.T_cam_world)
        self.keyframe_times.append(keyframe.frame.timestamp)
        self.clouds.append(NOTHING if self.config.window.enabled else keyframe_cloud(keyframe))
        prior = motion_information(self.config, 1.0 / 30.0)
        few, many = self.config.selection.points, self.config.window_points
        self.T_chosen = np.eye(4)
        self.index = self._select(keyframe, self.T_chosen, few, prior, self.noise)
        if self.config.window.enabled:
            index = self.index if many == few else self._select(keyframe, self.T_chosen, many, prior, self.noise)
            keyframe = self._refine(keyframe, index)
        self.clouds = condense(self.clouds, self.keyframe_poses, self.in_window)
        self.keyframe, self.T_kf_world, self.keyframe_turn = keyframe, self.T_cam_world, self.turn
        self.affine = np.zeros(2)
        self.entropies = []

    def _refine(self, keyframe: Keyframe, index: Index) -> Keyframe:
        """Add a keyframe to the window, optimise, shrink; the present pose and its velocity follow."""
        before = self.T_cam_world
        self.window.add(keyframe, before, self.affine, index)
        self.in_window.append(len(self.keyframe_poses) - 1)
        self.window.optimise()
        for number, pose in zip(self.in_window, self.window.T_kf_world, strict=True):
            self.keyframe_poses[number] = pose
        for k, keyframe in self.window.shrink():
            self.clouds[self.in_window.pop(k)] = keyframe_cloud(keyframe)
        self.T_cam_world = self.window.T_kf_world[-1]
        self.T_previous = self.T_previous @ inverse(before) @ self.T_cam_world
        return self.window.keyframes[-1]

    def _start_segment(self, frame: Frame, reason: str) -> TrackResult:
        """Begin at the last pose: the first frame, or one after too many lost ones; lost where it lacks points."""
        keyframe = make_keyframe(frame, self.config, self.rng)
        if len(keyframe.points.uv) < FEWEST_CANDIDATES:
            return self._hold(frame, reason)
        first = self.keyframe is None
        for number, old in zip(self.in_window, self.window.keyframes, strict=True):
            self.clouds[number] = keyframe_cloud(old)
        self.window = Window(self.config, self.noise)
        self.in_window = []
        self.affine = np.zeros(2)
        self.dt_previous = 0.0
        self.surprise_px = np.inf
        self._adopt(keyframe)
        self.segment += 0 if first else 1
        self.lost_in_a_row = 0
        self.pose_time = frame.timestamp
        reason = "" if first else "a new segment starts here, at the last known pose"
        return replace(self._result(frame, None, Status.OK if first else Status.LOST, reason), keyframe=True)

    def _lost(self, frame: Frame, reason: str) -> TrackResult:
        """Stay where we were and say so; after too many such frames begin anew, with this one."""
        if self.lost_in_a_row >= PATIENCE:
            return self._start_segment(frame, reason)
        return self._hold(frame, reason)

    def _hold(self, frame: Frame, reason: str) -> TrackResult:
        self.lost_in_a_row += 1
        self.dt_previous = 0.0
        self.surprise_px = np.inf
        return self._result(frame, None, Status.LOST, reason)

    def _result(
        self, frame: Frame, tracked: Tracked | None, status: Status, reason: str, entropies: Array | None = None
    ) -> TrackResult:
        T_world_cam = inverse(self.T_cam_world)
        T_cam_kf = self.T_cam_world @ inverse(self.T_kf_world) if tracked is None else tracked.T_frame_kf
        self.times.append(frame.timestamp)
        self.references.append(len(self.keyframe_poses) - 1)
        self.T_cam_kf.append(T_cam_kf)
        if tracked is not None:
            self.pose_time = frame.timestamp
        self.last = (self.keyframe, tracked) if tracked and self.keyframe else None
        return TrackResult(
            T_world_cam=torch.from_numpy(T_world_cam),
            status=status,
            reason=reason,
            reference_time=None if tracked is None else self.keyframe_times[-1],
            T_ref_cam=None if tracked is None else torch.from_numpy(inverse(T_cam_kf)),
            information=None if tracked is None else torch.from_numpy(tracked.information),
            points=0 if tracked is None else tracked.points,
            iterations=0 if tracked is None else tracked.iterations,
            entropy_bits=() if entropies is None else tuple(entropies.tolist()),
            segment=self.segment,
        )

    def trajectory(self) -> Trajectory:
        """Every frame's pose, hung on its keyframe as the window has refined it."""
        start = np.eye(4) if not self.keyframe_poses else self.keyframe_poses[0]
        poses = [
            inverse(T @ (self.keyframe_poses[r] if r >= 0 else start))
            for T, r in zip(self.T_cam_kf, self.references, strict=True)
        ]
        stacked = np.array(poses).reshape(-1, 4, 4)
        return Trajectory(torch.tensor(self.times, dtype=torch.float64), torch.from_numpy(stacked))

    def map_points(self) -> tuple[Tensor, Tensor]:
        """(N, 3) float32 candidate points of all keyframes in the world, m, and their (N, 3) uint8 RGB colours."""
        clouds = list(self.clouds)
        for number, keyframe in zip(self.in_window, self.window.keyframes, strict=True):
            clouds[number] = keyframe_cloud(keyframe)
        cloud = world_cloud(clouds, self.keyframe_poses)
        return torch.from_numpy(cloud.xyz), torch.from_numpy(cloud.rgb)

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
        if self.keyframe is not None and self.keyframe.frame.timestamp == self.times[-1]:
            return torch.from_numpy(self.keyframe.points.uv)
        return torch.zeros(0, 2, dtype=torch.float64)
