"""A segment becomes part of an earlier one, where it was found in one of its keyframes: by one rigid motion."""

from __future__ import annotations

from dataclasses import replace

import torch

from ..kernels.se3 import inverse
from ..odometry import Status, TrackResult
from .history import History
from .motion import Motion
from .recovery import Found
from .reference import Reference
from .results import joins
from .window import Window


def join(
    found: Found, history: History, window: Window, motion: Motion, reference: Reference, result: TrackResult
) -> TrackResult:
    """Move history, window, motion and reference to where the newest keyframe was found; the result of its frame."""
    segment = history.segments[found.number]
    reason = joins(history.segment, segment, history.keyframe_times[found.number])
    T_cam_world = found.T_frame_kf @ history.keyframe_poses[found.number]
    T_segment_world = inverse(motion.T_cam_world) @ T_cam_world
    history.join(segment, T_segment_world)
    window.move_world(T_segment_world)
    motion.move_world(T_segment_world)
    reference.T_kf_world = reference.T_kf_world @ T_segment_world
    T_world_cam = torch.from_numpy(inverse(motion.T_cam_world))
    return replace(result, T_world_cam=T_world_cam, status=Status.WEAK, reason=reason, segment=segment)
