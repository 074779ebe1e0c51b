"""RPE, the relative pose error over a fixed time, as the TUM tool defines it and as evo does."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ..definitions.se3 import inverse
from ..trajectory import Trajectory, nearest
from .absolute import ASSOCIATION_LIMIT_S

DELTA_S = 1.0
TOLERANCE = 0.1  # of delta: a pair of poses further from it is left out
RESTING_DEG = 1.0  # less than this is no rotation


@dataclass(frozen=True)
class RelativeError:
    """Relative pose error over a fixed time: the drift of every pair of poses about delta_s apart.

    errors_m is the TUM tool's: the motion from the pair's end to its begin is compared, so that an error of rotation
    counts with the way travelled. evo compares the motion from begin to end: errors_evo_m. The angle is the same.
    """

    timestamps: Tensor  # (N,) float64 s, of each pair's first pose
    errors_m: Tensor  # (N,) float64, drift over delta_s
    errors_evo_m: Tensor  # (N,) float64, the same as evo has it
    errors_rad: Tensor  # (N,) float64
    delta_s: float

    @property
    def rmse_m_per_s(self) -> float:
        """Root mean square drift per second, m/s."""
        return _rmse(self.errors_m) / self.delta_s

    @property
    def rmse_evo_m_per_s(self) -> float:
        """The same as evo has it, m/s."""
        return _rmse(self.errors_evo_m) / self.delta_s

    @property
    def rmse_deg_per_s(self) -> float:
        """Root mean square drift of the rotation per second, degrees/s."""
        return math.degrees(_rmse(self.errors_rad)) / self.delta_s


def relative_error(
    estimate: Trajectory,
    reference: Trajectory,
    delta_s: float = DELTA_S,
    max_difference_s: float = ASSOCIATION_LIMIT_S,
) -> RelativeError | None:
    """RPE as the TUM tool's evaluate_rpe.py gives it with fixed_delta: every estimated pose is paired with the one
    nearest to delta_s later, and each pair's motion compared with that of the reference poses nearest in time.

    As there, pairs that end at the last pose are left out. Unlike there, so are pairs that are not about delta_s apart
    (a tenth more or less), and those without reference poses within max_difference_s; within two median intervals of
    the reference they must be there, too. None where nothing is left, or where one of the two has positions only:
    `why_none` says which.
    """
    compared = _pairs(estimate, reference, delta_s, max_difference_s)
    if isinstance(compared, str):
        return None
    begin, end, reference_begin, reference_end = compared
    T_begin, T_end = estimate.T_world_cam[begin], estimate.T_world_cam[end]
    T_begin_true, T_end_true = reference.T_world_cam[reference_begin], reference.T_world_cam[reference_end]
    T_error = inverse(inverse(T_end) @ T_begin) @ (inverse(T_end_true) @ T_begin_true)  # (N, 4, 4)
    T_error_evo = inverse(inverse(T_begin_true) @ T_end_true) @ (inverse(T_begin) @ T_end)
    return RelativeError(
        estimate.timestamps[begin],
        T_error[:, :3, 3].norm(dim=1),
        T_error_evo[:, :3, 3].norm(dim=1),
        angle(T_error[:, :3, :3]),
        delta_s,
    )


def why_none(
    estimate: Trajectory,
    reference: Trajectory,
    delta_s: float = DELTA_S,
    max_difference_s: float = ASSOCIATION_LIMIT_S,
) -> str:
    """Why there is no RPE; empty where there is one."""
    compared = _pairs(estimate, reference, delta_s, max_difference_s)
    return compared if isinstance(compared, str) else ""


def without_orientation(estimate: Trajectory, reference: Trajectory) -> str:
    """Which of the two has positions only, as a laser tracker gives them: "estimate" or "reference"; empty for none.

    Its rotations are all the same, while the other one turns.
    """
    turns = {"estimate": _turn_deg(estimate), "reference": _turn_deg(reference)}
    for name, other in (("reference", "estimate"), ("estimate", "reference")):
        if turns[name] < 1e-4 and turns[other] > RESTING_DEG:
            return name
    return ""


def angle(R: Tensor) -> Tensor:
    """(N,) rad by which (N, 3, 3) rotations turn, accurate near 0 and near pi."""
    skew = torch.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], dim=1)  # 2 sin
    return torch.atan2(skew.norm(dim=1), R.diagonal(dim1=1, dim2=2).sum(dim=1) - 1)  # 2 cos


def _pairs(
    estimate: Trajectory, reference: Trajectory, delta_s: float, max_difference_s: float
) -> tuple[Tensor, Tensor, Tensor, Tensor] | str:
    """Begin and end of each pair in the estimate and in the reference; or why there is none."""
    if name := without_orientation(estimate, reference):
        return f"the {name} has positions only (all its rotations are the same, while the other turns)"
    times, reference_times = estimate.timestamps, reference.timestamps
    if len(times) < 2 or len(reference_times) < 2:
        return "a trajectory of fewer than two poses"
    begin = torch.arange(len(times))
    end = nearest(times, times + delta_s)
    # half a microsecond more, since files give times to that
    apart = ((times[end] - times - delta_s).abs() <= TOLERANCE * delta_s + 5e-7) & (end != len(times) - 1)
    if not bool(apart.any()):
        step = float(times.diff().quantile(0.5))
        milli = "; are these milliseconds?" if step > 10 else ""
        return (
            f"no two poses about {delta_s:g} s apart (the estimate has {len(times)} in "
            f"{float(times[-1] - times[0]):.3g} s, {step:.3g} s from one to the next{milli})"
        )
    begin, end = begin[apart], end[apart]
    limit_s = min(max_difference_s, 2 * float(reference_times.diff().quantile(0.5)))
    reference_begin, reference_end = nearest(reference_times, times[begin]), nearest(reference_times, times[end])
    close = ((reference_times[reference_begin] - times[begin]).abs() <= limit_s) & (
        (reference_times[reference_end] - times[end]).abs() <= limit_s
    )
    if not bool(close.any()):
        return (
            f"no two poses about {delta_s:g} s apart have each a reference pose within {limit_s:.3g} s "
            f"(the reference has one every {float(reference_times.diff().quantile(0.5)):.3g} s)"
        )
    return begin[close], end[close], reference_begin[close], reference_end[close]


def _turn_deg(trajectory: Trajectory) -> float:
    """The largest angle between the first rotation and any other, degrees."""
    R = trajectory.T_world_cam[:, :3, :3]
    return math.degrees(float(angle(R[0].T @ R).max())) if len(R) else 0.0


def _rmse(errors: Tensor) -> float:
    return float(errors.square().mean().sqrt())
