"""What a robot's software expects of a pose: axes, the order of a covariance, and a velocity in the body's own axes.

ROS (REP 103) lets a camera's optical frame look along +z with y down, as everything here does; a body looks along +x
with y to the left and z up.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray

from ..definitions.se3 import adjoint, inverse, log
from ..runs.certainty import POSE, TWIST, UPPER, inverted
from .tracked import SAME_TIME_S, TrackedRun

Array = NDArray[np.float64]
Axes = Literal["optical", "body"]

R_BODY_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # x is z, y is -x, z is -y
UNKNOWN = 1e6  # m^2, rad^2, or those over s^2: on the diagonal where nothing is known


@dataclass(frozen=True)
class Motion:
    """A frame as nav_msgs/Odometry has it."""

    T_world_child: Array  # (4, 4)
    pose_covariance: Array  # (6, 6) of x, y, z, and of rotation about the fixed axes X, Y, Z of the world
    twist: Array  # (6,) linear and angular velocity of the child in its own axes, m/s and rad/s
    twist_covariance: Array  # (6, 6) in the same order


Known = tuple[float, Mapping[str, str], Array]  # a frame's time (s), its row of frames.csv, its T_world_cam


def motion_of(run: TrackedRun, number: int, believed: Collection[int]) -> Motion:
    """A frame of a run in optical axes. The velocity is that since the frame before, where that is believed too."""
    before = (
        (run.times[number - 1], run.rows[number - 1], run.T_world_cam[number - 1]) if number - 1 in believed else None
    )
    return motion_between(before, (run.times[number], run.rows[number], run.T_world_cam[number]))


def motion_between(before: Known | None, now: Known) -> Motion:
    """A frame in optical axes, with the velocity since another; unknown where that is None."""
    time, row, T = now
    pose_covariance = _symmetric(row, "covariance", POSE)
    twist, covariance = np.zeros(6), _unknown()
    if before is not None and (dt := time - before[0]) > 0:
        T_cam_before = inverse(torch.from_numpy(T)) @ torch.from_numpy(before[2])
        twist = log(inverse(T_cam_before)).numpy() / dt
        between = _between(row, before[1], adjoint(T_cam_before).numpy())
        covariance = covariance if between is None else between / dt**2
    return Motion(T, _unknown() if pose_covariance is None else pose_covariance, twist, covariance)


def in_axes(motion: Motion, axes: Axes) -> Motion:
    """The same with the axes of world and child turned: both stay where they are."""
    if axes == "optical":
        return motion
    C, J = np.eye(4), np.kron(np.eye(2), R_BODY_OPTICAL)
    C[:3, :3] = R_BODY_OPTICAL
    return Motion(
        C @ motion.T_world_child @ C.T,
        J @ motion.pose_covariance @ J.T,
        J @ motion.twist,
        J @ motion.twist_covariance @ J.T,
    )


def _between(row: Mapping[str, str], before: Mapping[str, str], Ad: Array) -> Array | None:
    """(6, 6) covariance of a frame's pose against the frame before; None where it is unknown.

    Both were measured against the same keyframe, or the frame before is it. Their errors are taken for independent.
    """
    information = _symmetric(row, "information", TWIST)
    own = None if information is None else inverted(information)
    if own is None or _is_at(row["reference_time"], before["timestamp"]):
        return own
    if not _is_at(row["reference_time"], before["reference_time"]):
        return None
    information = _symmetric(before, "information", TWIST)
    other = None if information is None else inverted(information)
    return None if other is None else np.asarray(own + Ad @ other @ Ad.T)


def _is_at(a: str, b: str) -> bool:
    return bool(a) and bool(b) and abs(float(a) - float(b)) < SAME_TIME_S


def _symmetric(row: Mapping[str, str], what: str, names: tuple[str, ...]) -> Array | None:
    """The (6, 6) matrix whose upper half is in a row of frames.csv; None where the cells are empty or not there."""
    cells = [row.get(f"{what}_{names[i]}_{names[j]}") for i, j in UPPER]
    if not all(cells):
        return None
    out = np.zeros((6, 6))
    for (i, j), cell in zip(UPPER, cells, strict=True):
        out[i, j] = out[j, i] = float(cell or 0)
    return out


def _unknown() -> Array:
    return UNKNOWN * np.eye(6)
