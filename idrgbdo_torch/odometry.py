"""The common interface of every odometry here, ours and the baselines (design of the comparison)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from torch import Tensor

from .frame import RgbdFrame
from .trajectory import Trajectory


class Status(Enum):
    """How far a pose can be trusted: OK; WEAK, given but doubtful; LOST, only a prediction."""

    OK = "ok"
    WEAK = "weak"
    LOST = "lost"


@dataclass(frozen=True)
class TrackResult:
    """The pose of one frame and how certain it is."""

    T_world_cam: Tensor  # (4, 4) float64
    status: Status
    reason: str = ""  # one sentence; empty when OK
    reference_time: float | None = None  # s, the keyframe (or previous frame) that the pose was measured against
    T_ref_cam: Tensor | None = None  # (4, 4) float64, the measurement itself
    information: Tensor | None = None  # (6, 6) float64 of a left increment [v, w] of T_cam_ref: 1/m^2, 1/rad^2
    keyframe: bool = False  # this frame became a keyframe
    points: int = 0  # points used on the finest level
    iterations: int = 0
    entropy_bits: tuple[float, ...] = ()  # per degree of freedom [v, w], bits
    segment: int = 0  # grows by one when a lost track starts anew


class Odometry(Protocol):
    """Anything that turns frames into poses."""

    name: str

    def reset(self, T_world_cam: Tensor | None = None) -> None:
        """Forget everything; the next frame gets the pose T_world_cam (identity by default)."""

    def track(self, frame: RgbdFrame) -> TrackResult:
        """The pose of the next frame. Never raises on a bad image: failure is a status with a reason."""

    def trajectory(self) -> Trajectory:
        """All poses so far, with whatever later refinement the method offers."""


@dataclass(frozen=True)
class Alignment:
    """The result of aligning one pair of frames."""

    T_target_source: Tensor  # (4, 4) float64
    status: Status
    reason: str = ""
    information: Tensor | None = None


Align = Callable[[RgbdFrame, RgbdFrame, Tensor], Alignment]  # source, target, guess of T_target_source
