"""What an odometry says of a frame, and what is noted of it in a run."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import torch
from torch import Tensor


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

    @property
    def covariance(self) -> Tensor:
        """(6, 6) float64 of a left increment [v, w] of T_cam_ref, the inverse of the information: m^2, rad^2, m rad.

        There is one for every frame. The first frame defines the world: zeros. Of a lost frame nothing is known:
        infinite on the diagonal, as it is where the information has no inverse. A method that does not say how certain
        it is gives NaN.
        """
        nothing = torch.diag(torch.full((6,), torch.inf, dtype=torch.float64))
        if self.status is Status.LOST:
            return nothing
        if self.information is None:
            first = self.status is Status.OK and self.T_ref_cam is None
            return torch.full((6, 6), 0.0 if first else torch.nan, dtype=torch.float64)
        information = self.information.double()
        spread = information.diagonal().clamp(min=1e-300).rsqrt()  # metres and radians made alike, then inverted
        factor, failed = torch.linalg.cholesky_ex(spread[:, None] * information * spread)
        if int(failed) or not bool(factor.isfinite().all()):
            return nothing
        return spread[:, None] * torch.cholesky_inverse(factor) * spread


@dataclass(frozen=True)
class Record:
    """One frame of a run."""

    timestamp: float  # s
    result: TrackResult
    decode_ms: float  # until the frame was there: what was not yet read, decoded and undistorted ahead
    track_ms: float | None  # in track() alone; None for a frame that could not be read
