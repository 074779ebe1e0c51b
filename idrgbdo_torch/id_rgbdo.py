"""ID-RGBDO: the system, in the paper's order."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .config import Config
from .frame import Frame, Keyframe, RgbdFrame, prepare
from .kernels.lie import inverse
from .odometry import Status, TrackResult
from .selection import make_keyframe, select_points
from .tracking import Tracked, kernel_noise, predict, track_frame
from .trajectory import Trajectory

Array = NDArray[np.float64]


class IdRgbdo:
    """Information-driven direct RGB-D odometry (an Odometry)."""

    name = "id-rgbdo"

    def __init__(self, config: Config | None = None) -> None:
        self.config = config or Config()
        self.noise = kernel_noise(self.config.noise)
        self.reset()

    def reset(self, T_world_cam: Tensor | None = None) -> None:
        """Forget everything; the next frame gets the pose T_world_cam (identity by default)."""
        self.rng = np.random.default_rng(self.config.seed)
        self.keyframe: Keyframe | None = None
        self.T_cam_world = np.eye(4) if T_world_cam is None else inverse(T_world_cam.double().numpy())
        self.T_previous = self.T_cam_world
        self.affine = np.zeros(2)
        self.times: list[float] = []
        self.poses: list[Array] = []
        self.reference_bits: list[Array] = []

    def track(self, rgbd: RgbdFrame) -> TrackResult:
        frame = prepare(rgbd, self.config.tracking.levels)
        if self.keyframe is None:
            self._new_keyframe(frame, self.T_cam_world)
            return self._result(frame, None, True)
        T_kf_world = self.T_kf_world
        guess = predict(self.T_cam_world, self.T_previous, 1.0) @ inverse(T_kf_world)
        prior = np.diag([1 / 0.02**2] * 3 + [1 / 0.03**2] * 3)
        index = select_points(
            self.keyframe, guess, self.config, self.noise, prior, self.rng, self.config.selection.points
        )
        tracked = track_frame(
            frame, self.keyframe, guess, self.affine, index, self.keyframe.coarse, prior, self.config, self.noise
        )
        self.last_index=index
        self.T_previous = self.T_cam_world
        self.T_cam_world = tracked.T_frame_kf @ T_kf_world
        self.affine = tracked.affine
        bits = 0.5 * np.log2(2 * np.pi * np.e / np.maximum(np.diag(tracked.information), 1e-9))
        self.reference_bits.append(bits)
        result = self._result(frame, tracked, False)
        reference = np.median(np.array(self.reference_bits[:3]), axis=0)
        if len(self.reference_bits) > 3 and (bits - reference).max() > self.config.keyframe.threshold:
            self._new_keyframe(frame, self.T_cam_world)
        return result

    def _new_keyframe(self, frame: Frame, T_kf_world: Array) -> None:
        self.keyframe = make_keyframe(frame, self.config, self.rng)
        self.T_kf_world = T_kf_world
        self.affine = np.zeros(2)
        self.reference_bits = []

    def _result(self, frame: Frame, tracked: Tracked | None, is_keyframe: bool) -> TrackResult:
        assert self.keyframe is not None
        T_world_cam = inverse(self.T_cam_world)
        self.times.append(frame.timestamp)
        self.poses.append(T_world_cam)
        return TrackResult(
            torch.from_numpy(T_world_cam), Status.OK, "", self.keyframe.frame.timestamp,
            torch.from_numpy(self.T_kf_world @ T_world_cam),
            None if tracked is None else torch.from_numpy(tracked.information), is_keyframe,
            0 if tracked is None else tracked.points, 0 if tracked is None else tracked.iterations,
        )  # fmt: skip

    def trajectory(self) -> Trajectory:
        """Every frame's pose."""
        return Trajectory(torch.tensor(self.times, dtype=torch.float64), torch.from_numpy(np.array(self.poses)))
