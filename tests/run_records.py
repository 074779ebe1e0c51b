"""Frames of a run as it records them, made up."""

from __future__ import annotations

import torch

from idrgbdo_torch.definitions.se3 import exp
from idrgbdo_torch.odometry import Record, Run, Status, TrackResult

INFORMATION = torch.arange(36, dtype=torch.float64).reshape(6, 6)


def pose(x: float) -> torch.Tensor:
    return exp(torch.tensor([x, 0, 0, 0, 0.1 * x, 0], dtype=torch.float64))


def record(index: int, status: Status = Status.OK, track_ms: float | None = 5.0) -> Record:
    keyframe = index % 3 == 0
    result = TrackResult(
        pose(0.1 * index),
        status,
        "too few points" if status is Status.LOST else "",
        reference_time=float(index - index % 3) if index else None,
        T_ref_cam=pose(0.1 * (index % 3)) if index else None,
        information=INFORMATION + INFORMATION.T,
        keyframe=keyframe,
        points=24,
        iterations=7,
        entropy_bits=(1.0, 2.0, 3.0, 4.0, 5.0, 6.5),
    )
    return Record(float(index), result, 2.0, track_ms)


RUN = Run(
    "some", (record(0), record(1), record(2, Status.WEAK, 7.0), record(3, track_ms=20.0), record(4, Status.LOST, None))
)
