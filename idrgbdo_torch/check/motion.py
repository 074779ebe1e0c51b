"""What the reference poses say: how fast the camera moved, and how long a metre of the depth is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from ..trajectory import Trajectory, nearest

Array = NDArray[np.float64]

LIMIT_S = 0.05  # between a frame and its reference pose
LEAST_M = 0.02  # way between two frames that tells a scale


@dataclass(frozen=True)
class ReferenceMotion:
    """Of the frames that have a reference pose."""

    covered: float  # share of the frames
    step_m: Array  # (M,) between neighbouring frames
    step_deg: Array
    scale: float | None  # way measured with the depth over way of the reference, None where it cannot be told
    scale_pairs: int
    scale_way_m: float  # of the reference, over all pairs


def reference_motion(
    groundtruth: Trajectory, timestamps: Array, motions: list[tuple[float, float, float]]
) -> ReferenceMotion:
    """motions: times of two frames (s) and how far apart images and depth put them (m)."""
    index, near = _at(groundtruth, timestamps)
    poses = groundtruth.T_world_cam[index[near]].numpy()
    relative = np.linalg.inv(poses[:-1]) @ poses[1:]
    cosine = (np.trace(relative[:, :3, :3], axis1=1, axis2=2) - 1.0) / 2.0
    measured, way = _ways(groundtruth, motions)
    return ReferenceMotion(
        covered=float(near.double().mean()),
        step_m=np.linalg.norm(relative[:, :3, 3], axis=1),
        step_deg=np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))),
        scale=float(np.median(measured / way)) if len(way) else None,
        scale_pairs=len(way),
        scale_way_m=float(way.sum()),
    )


def _ways(groundtruth: Trajectory, motions: list[tuple[float, float, float]]) -> tuple[Array, Array]:
    """(K,) metres by the depth and by the reference, of the pairs that moved."""
    rows = np.array(motions, dtype=np.float64).reshape(-1, 3)
    (first, near_first), (second, near_second) = (_at(groundtruth, rows[:, column]) for column in (0, 1))
    way = (groundtruth.positions[second] - groundtruth.positions[first]).norm(dim=1).numpy()
    told = (near_first & near_second).numpy() & (way >= LEAST_M)
    return rows[told, 2], way[told]


def _at(groundtruth: Trajectory, times: Array) -> tuple[torch.Tensor, torch.Tensor]:
    """The nearest reference pose of every time, and whether it is near enough."""
    wanted = torch.from_numpy(np.ascontiguousarray(times))
    index = nearest(groundtruth.timestamps, wanted)
    return index, (groundtruth.timestamps[index] - wanted).abs() <= LIMIT_S
