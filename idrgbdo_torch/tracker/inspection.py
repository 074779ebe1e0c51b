"""What an odometry shows of itself to pictures, maps, reports and viewers: the one door through which they look in."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..frame import Keyframe
from ..measurement import Noise
from ..trajectory import Trajectory
from .backends import Backend
from .history import History
from .mapping import Cloud, together
from .reference import Reference
from .selection import point_bits
from .tracking import Tracked
from .window import Window

Last = tuple[Keyframe, Tracked]  # what a frame was tracked against, and how


@runtime_checkable
class Inspectable(Protocol):
    """An odometry that tracks points of keyframes and says which. Nothing here changes what it does next."""

    def last_points(self) -> tuple[Tensor, Tensor]:
        """The points last tracked: (N, 2) px in that frame, and (N,) bits that each adds to what the others know."""

    def last_candidates(self) -> Tensor:
        """(M, 2) px of all points that could have been chosen there."""

    def last_alignment(self) -> tuple[Keyframe, Tracked] | None:
        """The keyframe that the last frame was tracked against, and how; None where it was not tracked."""

    def window_keyframes(self) -> dict[int, tuple[Keyframe, NDArray[np.float64]]]:
        """By number, the keyframes that are still refined and their T_kf_world (4, 4); the newest is the last."""

    def maps(self) -> dict[int, Cloud]:
        """By segment, the points of its keyframes with colours and normals; segments lie in worlds of their own."""


class Shown:
    """What an odometry says of its frames, from what it keeps of them."""

    last: tuple[Keyframe, Tracked] | None  # what the last frame was tracked against
    reference: Reference | None
    history: History
    window: Window
    noise: Noise
    backend: Backend

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
            (keyframe, tracked), everyone = self.last, np.arange(len(self.last[0].points.uv))
            return point_bits(keyframe, tracked.T_frame_kf, everyone, self.noise, self.backend)[0]
        own = self.reference.keyframe if self.reference else None
        shown = own is not None and own.frame.timestamp == self.history.times[-1]
        return torch.from_numpy(own.points.uv) if own and shown else torch.zeros(0, 2, dtype=torch.float64)

    def trajectory(self) -> Trajectory:
        """Every frame's pose by all that is known now, the frames after it included. Takes some 0.3 ms a frame."""
        return self.history.trajectory()

    def maps(self) -> dict[int, Cloud]:
        """By segment, the candidate points of its keyframes in its world; more than one only where a track broke."""
        return self.history.maps(self.window.members.keyframes)

    def map_points(self) -> tuple[Tensor, Tensor]:
        """(N, 3) float32 candidate points of all keyframes in the world, m, and their (N, 3) uint8 RGB colours."""
        return together(self.maps().values()).tensors()

    def window_keyframes(self) -> dict[int, tuple[Keyframe, NDArray[np.float64]]]:
        """By number, the keyframes that are still refined and their T_kf_world (4, 4); the newest is the last."""
        members, reference = self.window.members, self.reference
        if not members and reference is not None:  # the window is off
            return {len(self.history.keyframe_poses) - 1: (reference.keyframe, reference.T_kf_world)}
        return dict(zip(self.history.in_window, zip(members.keyframes, members.T, strict=True), strict=True))
