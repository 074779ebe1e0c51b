"""What track() says of a frame."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from ..kernels.information import freedom_entropies
from ..kernels.se3 import inverse
from ..odometry import Status, TrackResult
from .shared_errors import believed
from .tracking import Tracked

Array = NDArray[np.float64]

UNKNOWN = np.zeros(6)  # velocity


def held(T_cam_world: Array, status: Status, reason: str, segment: int) -> TrackResult:
    """Of a frame at a pose (4, 4) that nothing was measured for."""
    pose = torch.from_numpy(inverse(T_cam_world))
    return TrackResult(T_world_cam=pose, status=status, reason=reason, segment=segment)


def measured(
    T_cam_world: Array, tracked: Tracked, reference_time: float, reason: str, segment: int, velocity: Array = UNKNOWN
) -> TrackResult:
    """Of a frame that was aligned to the keyframe of reference_time (s): weak with a reason, ok without.

    velocity: (6,) [v, w] of a left increment of T_cam_world, m/s and rad/s, zeros where it is unknown.
    """
    information = believed(tracked.information, tracked.points, velocity, tracked.wide)
    return TrackResult(
        T_world_cam=torch.from_numpy(inverse(T_cam_world)),
        status=Status.WEAK if reason else Status.OK,
        reason=reason,
        reference_time=reference_time,
        T_ref_cam=torch.from_numpy(inverse(tracked.T_frame_kf)),
        information=torch.from_numpy(information),
        points=tracked.points,
        iterations=tracked.iterations,
        entropy_bits=tuple(freedom_entropies(information).tolist()),
        segment=segment,
    )


def found_in(T_cam_world: Array, tracked: Tracked, time: float, segment: int) -> TrackResult:
    """Of a lost frame that was found again in the keyframe of that time (s), and has become one itself."""
    return replace(
        measured(T_cam_world, tracked, time, f"found again in the keyframe of {time:.3f} s", segment), keyframe=True
    )


def after(lost: int) -> str:
    """Why a pose after so many lost frames is doubtful; empty after none."""
    return "the frame before was lost" if lost else ""


def joins(segment: int, earlier: int, seen_s: float) -> str:
    """The reason of the frame with which a segment became part of an earlier one, seen in its keyframe of that time."""
    return f"segment {segment} joins {earlier}, found in the keyframe of {seen_s:.3f} s"


def joined(reason: str) -> tuple[int, int] | None:
    """The two segments of such a reason; None for any other."""
    found = re.match(r"segment (\d+) joins (\d+),", reason)
    return None if found is None else (int(found[1]), int(found[2]))
