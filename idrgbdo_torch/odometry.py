"""The common interface of every odometry here, ours and the baselines, and run(): the one clock."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from time import perf_counter_ns
from typing import Protocol

import torch
from torch import Tensor

from .definitions.given import rigid
from .definitions.records import Records
from .definitions.results import Record as Record
from .definitions.results import Status as Status
from .definitions.results import TrackResult as TrackResult
from .definitions.se3 import exp, inverse
from .errors import IdRgbdoError
from .frame import BrokenFrame, RgbdFrame, check_next
from .trajectory import Trajectory, timed

PARTICULARS = re.compile(r"'[^']*'|\d+(?:\.\d+)?")  # names between quotes, and numbers


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
    """N times (s) and N (4, 4) poses as one Trajectory, by time; of frames with the same time the last."""
    stacked = torch.stack(list(poses)) if poses else torch.empty(0, 4, 4, dtype=torch.float64)
    return timed(torch.tensor(timestamps, dtype=torch.float64), stacked)


class ConstantVelocity:
    """The null baseline: never looks at an image, moves on at one velocity (by default none, so it stays)."""

    name = "constant velocity"

    def __init__(self, velocity: Tensor | None = None) -> None:
        """velocity: (6,) float64 [v, w] of the camera in its own axes, m/s and rad/s."""
        self._velocity = torch.zeros(6, dtype=torch.float64) if velocity is None else velocity
        self.reset()

    def reset(self, T_world_cam: Tensor | None = None) -> None:
        """Forget everything; the next frame gets the pose T_world_cam (identity by default)."""
        self._start = rigid("T_world_cam", T_world_cam)
        self._times: list[float] = []
        self._poses: list[Tensor] = []

    def track(self, frame: RgbdFrame) -> TrackResult:
        """The pose that the velocity predicts; WEAK, since nothing was measured."""
        check_next(frame, None)
        pose = self._start
        if self._times:
            pose = self._poses[-1] @ exp(self._velocity * (frame.timestamp - self._times[-1]))
        self._times.append(frame.timestamp)
        self._poses.append(pose.clone())
        return TrackResult(pose.clone(), Status.WEAK, "predicted without looking at the images")

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
        self._pose = rigid("T_world_cam", T_world_cam)  # the last
        self._motion = torch.eye(4, dtype=torch.float64)  # T_frame_previous, the last that was measured
        self._good: RgbdFrame | None = None
        self._lost: RgbdFrame | None = None  # the frame before, where it was lost
        self._segment = 0
        self._times: list[float] = []
        self._poses: list[Tensor] = []

    def track(self, frame: RgbdFrame) -> TrackResult:
        """Align the frame to the one before. LOST with the method's reason, at the pose before, where that fails."""
        check_next(frame, self._good.camera if self._good else None)
        kept = frame.copied()
        if self._good is None:
            result = TrackResult(self._pose, Status.OK, segment=self._segment)
            self._good = kept
        else:
            result = self._step(kept, self._good)
        self._pose = result.T_world_cam.clone()  # the result is the caller's to change
        self._times.append(frame.timestamp)
        self._poses.append(self._pose)
        return result

    def trajectory(self) -> Trajectory:
        """All poses so far."""
        return poses_to_trajectory(self._times, self._poses)

    def _measured(self, reference: RgbdFrame, frame: RgbdFrame, guess: Tensor) -> Alignment:
        """What the method says; LOST where that is no pose, which would spoil all that follow."""
        alignment = self._align(reference, frame, guess.clone())
        if alignment.status is not Status.LOST:
            try:
                alignment = replace(alignment, T_target_source=rigid("T_target_source", alignment.T_target_source))
            except IdRgbdoError as error:
                return Alignment(guess, Status.LOST, str(error))
        return alignment

    def _step(self, frame: RgbdFrame, good: RgbdFrame) -> TrackResult:
        identity = torch.eye(4, dtype=torch.float64)
        reference = good
        alignment = self._measured(reference, frame, self._motion if self._predict else identity)
        if alignment.status is Status.LOST and self._lost is not None:
            reference = self._lost
            alignment = self._measured(reference, frame, identity)
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
class Run:
    """What an odometry made of a sequence."""

    name: str
    records: Sequence[Record]

    @property
    def statuses(self) -> tuple[Status, ...]:
        """One status a frame."""
        return Records.of(self.records).statuses()

    @property
    def timestamps(self) -> Tensor:
        """(N,) float64 seconds, one a frame, as they came."""
        return Records.of(self.records).timestamps()

    def trajectory(self) -> Trajectory:
        """The causal poses by time: each as it was known when its frame came."""
        records = Records.of(self.records)
        return timed(records.timestamps(), records.poses())


def run(
    odometry: Odometry,
    frames: Iterable[RgbdFrame | BrokenFrame],
    on_record: Callable[[Record], None] | None = None,
    earlier: Sequence[Record] = (),
) -> Run:
    """Track all frames, from wherever the odometry stands: the only place that takes time.

    The clock runs around track() alone; fetching a frame is timed apart. A BrokenFrame is LOST with its reason, at the
    last pose; before the first frame of a run, at the identity. on_record sees every record as soon as it is there, so
    that an interrupted run leaves what was done. earlier: the records of a run that is continued; they come first in
    the result, which goes on in them where they are Records already.
    """
    if not callable(getattr(odometry, "track", None)):
        raise IdRgbdoError(f"odometry: expected an Odometry, got {type(odometry).__name__}; pass IdRgbdo()")
    if not isinstance(frames, Iterable):
        raise IdRgbdoError(f"frames: expected RgbdFrames to iterate over, got {type(frames).__name__}; pass a list")
    records = Records.of(earlier)
    segment, pose = 0, torch.eye(4, dtype=torch.float64)
    if records:
        segment, pose = records[-1].result.segment, records[-1].result.T_world_cam
    source = iter(frames)
    while True:
        begin = perf_counter_ns()
        frame = next(source, None)
        fetched = perf_counter_ns()
        if frame is None:
            return Run(odometry.name, records)
        track_ms: float | None = None
        if isinstance(frame, BrokenFrame):
            result = TrackResult(pose, Status.LOST, frame.reason, segment=segment)
        else:
            result = odometry.track(frame)
            track_ms = (perf_counter_ns() - fetched) / 1e6
        pose, segment = result.T_world_cam, result.segment
        record = Record(frame.timestamp, result, (fetched - begin) / 1e6, track_ms)
        records.append(record)
        if on_record is not None:
            on_record(record)
