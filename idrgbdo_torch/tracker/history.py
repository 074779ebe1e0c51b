"""All frames and keyframes so far: poses hung on keyframes, and the map that these left behind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray

from ..frame import Keyframe
from ..kernels.se3 import inverse
from ..trajectory import Trajectory
from .mapping import NOTHING, Cloud, condense, keyframe_cloud, world_cloud

Array = NDArray[np.float64]


@dataclass
class History:
    """What was tracked. Frames keep their pose against a keyframe; keyframes move while the window refines them."""

    times: list[float] = field(default_factory=list)  # s, of every frame
    references: list[int] = field(default_factory=list)  # number of the keyframe of every frame, -1 before the first
    T_cam_kf: list[Array] = field(default_factory=list)  # (4, 4) of every frame against it
    keyframe_times: list[float] = field(default_factory=list)
    keyframe_poses: list[Array] = field(default_factory=list)  # (4, 4) T_kf_world
    in_window: list[int] = field(default_factory=list)  # numbers of the keyframes that still move, oldest first
    clouds: list[Cloud] = field(default_factory=list)  # map points of every keyframe that has left the window
    segment: int = 0  # grows by one when a lost track starts anew

    def add_frame(self, timestamp: float, T_cam_kf: Array) -> None:
        """A frame at a pose against the newest keyframe."""
        self.times.append(timestamp)
        self.references.append(len(self.keyframe_poses) - 1)
        self.T_cam_kf.append(T_cam_kf)

    def add_keyframe(self, timestamp: float, T_kf_world: Array, cloud: Cloud = NOTHING) -> None:
        """A keyframe; its cloud where no window will refine it."""
        self.keyframe_times.append(timestamp)
        self.keyframe_poses.append(T_kf_world)
        self.clouds.append(cloud)

    def refine(self, poses: Array) -> None:
        """The window's keyframes have new poses (K, 4, 4)."""
        for number, pose in zip(self.in_window, poses, strict=True):
            self.keyframe_poses[number] = pose

    def leave(self, place: int, keyframe: Keyframe) -> None:
        """The keyframe at this place of the window is refined no more."""
        self.clouds[self.in_window.pop(place)] = keyframe_cloud(keyframe)

    def condense(self) -> None:
        """Keep the map within its bounds."""
        self.clouds = condense(self.clouds, self.keyframe_poses, self.in_window)

    def trajectory(self) -> Trajectory:
        """Every frame's pose, hung on its keyframe as it stands now."""
        start = np.eye(4) if not self.keyframe_poses else self.keyframe_poses[0]
        poses = [
            inverse(T @ (self.keyframe_poses[r] if r >= 0 else start))
            for T, r in zip(self.T_cam_kf, self.references, strict=True)
        ]
        stacked = np.array(poses).reshape(-1, 4, 4)
        return Trajectory(torch.tensor(self.times, dtype=torch.float64), torch.from_numpy(stacked))

    def map(self, window: Sequence[Keyframe]) -> Cloud:
        """The candidate points of all keyframes in the world, given those that are still in the window."""
        clouds = list(self.clouds)
        for number, keyframe in zip(self.in_window, window, strict=True):
            clouds[number] = keyframe_cloud(keyframe)
        return world_cloud(clouds, self.keyframe_poses)
