"""Timed poses."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class Trajectory:
    """Poses T_world_cam over time."""

    timestamps: Tensor  # (N,) float64 seconds, increasing
    T_world_cam: Tensor  # (N, 4, 4) float64
