"""The common interface of every odometry here, ours and the baselines, and run(): the one clock."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise
from time import perf_counter_ns
from typing import Protocol

import torch
from torch import Tensor

from .definitions.se3 import exp, inverse
from .frame import BrokenFrame, RgbdFrame
from .trajectory import Trajectory

PARTICULARS = re.compile(r"'[^']*'|\d+(?:\.\d+)?")  # names between quotes, and numbers


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


def lost_because(records: Iterable[Record]) -> dict[str, int]:
    """Why frames were lost and how many, the commonest first.

    Reasons that differ only in numbers and in names between quotes are one kind; what differs becomes "...".
    """
    kinds: dict[str, Counter[str]] = {}
    for record in records:
        if record.result.status is Status.LOST:
            kind = PARTICULARS.sub(lambda found: "'...'" if found[0][0] == "'" else "...", record.result.reason)
            kinds.setdefault(kind, Counter())[record.result.reason] += 1
    counts = {(next(iter(each)) if len(each) == 1 else kind): each.total() for kind, each in kinds.items()}
    return dict(sorted(counts.items(), key=lambda item: -item[1]))


def found_again(records: Sequence[Record]) -> tuple[int, int]:
    """How many times a track was lost and went on later, and after how many of them where it had been: in the same
    segment, so that all of it is one map.
    """
    tracked = [k for k, record in enumerate(records) if record.result.status is not Status.LOST]
    gaps = [(a, b) for a, b in pairwise(tracked) if b > a + 1]
    found = sum(records[a].result.segment == records[b].result.segment for a, b in gaps)
    return found, len(gaps)


def poses_to_trajectory(timestamps: Sequence[float], poses: Sequence[Tensor]) -> Trajectory:
    """N times (s) and N (4, 4) poses as one Trajectory."""
    stacked = torch.stack(list(poses)) if poses else torch.empty(0, 4, 4, dtype=torch.float64)
    return Trajectory(torch.tensor(timestamps, dtype=torch.float64), stacked)


class ConstantVelocity:
    """The null baseline: never looks at an image, moves on at one velocity (by default none, so it stays)."""

    name = "constant velocity"

    def __init__(self, velocity: Tensor | None = None) -> None:
        """velocity: (6,) float64 [v, w] of the camera in its own axes, m/s and rad/s."""
        self._velocity = torch.zeros(6, dtype=torch.float64) if velocity is None else velocity
        self.reset()

    def reset(self, T_world_cam: Tensor | None = None) -> None:
        """Forget everything; the next frame gets the pose T_world_cam (identity by default)."""
        self._start = torch.eye(4, dtype=torch.float64) if T_world_cam is None else T_world_cam
        self._times: list[float] = []
        self._poses: list[Tensor] = []

    def track(self, frame: RgbdFrame) -> TrackResult:
        """The pose that the velocity predicts; WEAK, since nothing was measured."""
        pose = self._start
        if self._times:
            pose = self._poses[-1] @ exp(self._velocity * (frame.timestamp - self._times[-1]))
        self._times.append(frame.timestamp)
        self._poses.append(pose)
        return TrackResult(pose, Status.WEAK, "predicted without looking at the images")

    def trajectory(self) -> Trajectory:
        """All poses so far."""
        return poses_to_trajectory(self._times, self._poses)


class FrameToFrame:
    """Any pairwise method as an Odometry: each frame is aligned to the one before, and the motions are chained.

    After a lost frame the next is first aligned to the last good one; where that fails too, to the lost one, and a new
    segment starts there at the pose that was held.
    """

    def __init__(self, align: Align, name: str = "frame to frame", predict: bool = True) -> None:
        """align: the pairwise method. predict: its guess is the previous motion, else the identity."""
        self.name = name
        self._align = align
        self._predict = predict
        self.reset()

    def reset(self, T_world_cam: Tensor | None = None) -> None:
        """Forget everything; the next frame gets the pose T_world_cam (identity by default)."""
        self._pose = torch.eye(4, dtype=torch.float64) if T_world_cam is None else T_world_cam  # T_world_cam, the last
        self._motion = torch.eye(4, dtype=torch.float64)  # T_frame_previous, the last that was measured
        self._good: RgbdFrame | None = None
        self._lost: RgbdFrame | None = None  # the frame before, where it was lost
        self._segment = 0
        self._times: list[float] = []
        self._poses: list[Tensor] = []

    def track(self, frame: RgbdFrame) -> TrackResult:
        """Align the frame to the one before. LOST with the method's reason, at the pose before, where that fails."""
        if self._good is None:
            result = TrackResult(self._pose, Status.OK, segment=self._segment)
            self._good = frame
        else:
            result = self._step(frame, self._good)
        self._pose = result.T_world_cam
        self._times.append(frame.timestamp)
        self._poses.append(self._pose)
        return result

    def trajectory(self) -> Trajectory:
        """All poses so far."""
        return poses_to_trajectory(self._times, self._poses)

    def _step(self, frame: RgbdFrame, good: RgbdFrame) -> TrackResult:
        identity = torch.eye(4, dtype=torch.float64)
        reference = good
        alignment = self._align(reference, frame, self._motion if self._predict else identity)
        if alignment.status is Status.LOST and self._lost is not None:
            reference = self._lost
            alignment = self._align(reference, frame, identity)
            self._segment += alignment.status is not Status.LOST
        if alignment.status is Status.LOST:
            self._lost, self._motion = frame, identity
            return TrackResult(self._pose, Status.LOST, alignment.reason, segment=self._segment)
        T_ref_cam = inverse(alignment.T_target_source)
        self._good, self._lost, self._motion = frame, None, alignment.T_target_source
        return TrackResult(
            self._pose @ T_ref_cam,  # the pose held since the reference frame
            alignment.status,
            alignment.reason,
            reference_time=reference.timestamp,
            T_ref_cam=T_ref_cam,
            information=alignment.information,
            segment=self._segment,
        )


@dataclass(frozen=True)
class Record:
    """One frame of a run."""

    timestamp: float  # s
    result: TrackResult
    decode_ms: float  # until the frame was there: what was not yet read, decoded and undistorted ahead
    track_ms: float | None  # in track() alone; None for a frame that could not be read


@dataclass(frozen=True)
class Run:
    """What an odometry made of a sequence."""

    name: str
    records: tuple[Record, ...]

    @property
    def statuses(self) -> tuple[Status, ...]:
        """One status a frame."""
        return tuple(record.result.status for record in self.records)

    def trajectory(self) -> Trajectory:
        """The causal poses: each as it was known when its frame came."""
        return poses_to_trajectory([r.timestamp for r in self.records], [r.result.T_world_cam for r in self.records])


def run(
    odometry: Odometry,
    frames: Iterable[RgbdFrame | BrokenFrame],
    on_record: Callable[[Record], None] | None = None,
    earlier: Sequence[Record] = (),
) -> Run:
    """Track all frames, from wherever the odometry stands: the only place that takes time.

    The clock runs around track() alone; fetching a frame is timed apart. A BrokenFrame is LOST with its reason, at the
    last pose. on_record sees every record as soon as it is there, so that an interrupted run leaves what was done.
    earlier: the records of a run that is continued; they come first in the result.
    """
    records = list(earlier)
    segment, pose = 0, torch.eye(4, dtype=torch.float64)
    if records:
        segment, pose = records[-1].result.segment, records[-1].result.T_world_cam
    source = iter(frames)
    while True:
        begin = perf_counter_ns()
        frame = next(source, None)
        fetched = perf_counter_ns()
        if frame is None:
            return Run(odometry.name, tuple(records))
        track_ms: float | None = None
        if isinstance(frame, BrokenFrame):
            result = TrackResult(pose, Status.LOST, frame.reason, segment=segment)
        else:
            result = odometry.track(frame)
            track_ms = (perf_counter_ns() - fetched) / 1e6
        pose, segment = result.T_world_cam, result.segment
        records.append(Record(frame.timestamp, result, (fetched - begin) / 1e6, track_ms))
        if on_record is not None:
            on_record(records[-1])
