"""How far an estimate is from a reference: ATE, RPE over one second (both as the TUM tools define them), and K2FE."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from .definitions.se3 import inverse
from .errors import IdRgbdoError
from .trajectory import Trajectory, align, associate, nearest

ASSOCIATION_LIMIT_S = 0.02


@dataclass(frozen=True)
class AbsoluteError:
    """Absolute trajectory error: position differences after one rigid alignment without scale."""

    timestamps: Tensor  # (N,) float64 s, of the estimate
    errors_m: Tensor  # (N,) float64
    T_reference_estimate: Tensor  # (4, 4) float64, the alignment: estimate's world to the reference's world

    @property
    def rmse_m(self) -> float:
        """Root mean square over all matched poses, m."""
        return _rmse(self.errors_m)


@dataclass(frozen=True)
class RelativeError:
    """Relative pose error over a fixed time: translational drift of every pair of poses delta_s apart."""

    timestamps: Tensor  # (N,) float64 s, of each pair's first pose
    errors_m: Tensor  # (N,) float64, drift over delta_s
    delta_s: float

    @property
    def rmse_m_per_s(self) -> float:
        """Root mean square drift per second, m/s."""
        return _rmse(self.errors_m) / self.delta_s


@dataclass(frozen=True)
class KeyframeError:
    """Keyframe-to-frame error (K2FE): translational error of each frame against the keyframe it was measured from."""

    timestamps: Tensor  # (N,) float64 s, of the frames
    errors_m: Tensor  # (N,) float64

    @property
    def mean_m(self) -> float:
        """Mean over the frames, m."""
        return float(self.errors_m.mean())

    @property
    def sum_m(self) -> float:
        """Sum over the frames, m: the accumulated error of the paper's Fig. 3."""
        return float(self.errors_m.sum())


@dataclass(frozen=True)
class Evaluation:
    """All three errors of one estimate; None where the data has no pair to measure it on."""

    matched_poses: int  # poses of the estimate with a reference pose within the association limit
    ate: AbsoluteError
    rpe: RelativeError | None
    k2fe: KeyframeError | None = None


@dataclass(frozen=True)
class Measurement:
    """The pose of one frame as it was measured against its keyframe."""

    timestamp: float  # s, the frame
    reference_time: float  # s, the keyframe
    T_ref_cam: Tensor  # (4, 4) float64


def evaluate(
    estimate: Trajectory,
    reference: Trajectory,
    measurements: Sequence[Measurement] = (),
    max_difference_s: float = ASSOCIATION_LIMIT_S,
) -> Evaluation:
    """ATE, RPE over 1 s and, where measurements are given, K2FE of an estimate against a reference.

    Raises IdRgbdoError when fewer than three poses find a reference pose within max_difference_s.
    """
    ate = absolute_error(estimate, reference, max_difference_s)
    rpe = relative_error(estimate, reference)
    return Evaluation(len(ate.timestamps), ate, rpe, keyframe_error(measurements, reference, max_difference_s))


def absolute_error(
    estimate: Trajectory, reference: Trajectory, max_difference_s: float = ASSOCIATION_LIMIT_S
) -> AbsoluteError:
    """ATE: positions are matched by time one to one, aligned by a rigid motion, and compared.

    Raises IdRgbdoError when fewer than three poses match (three points fix a rigid motion).
    """
    of_estimate, of_reference = associate(estimate.timestamps, reference.timestamps, max_difference_s)
    if len(of_estimate) < 3:
        gap = (
            (estimate.timestamps[nearest(estimate.timestamps, reference.timestamps)] - reference.timestamps).abs().min()
        )
        raise IdRgbdoError(
            f"evaluation: expected at least 3 poses within {max_difference_s:g} s of a reference pose, got "
            f"{len(of_estimate)} (the closest two are {float(gap):.3f} s apart); "
            "check that both files are of one recording and one clock"
        )
    source, target = estimate.positions[of_estimate], reference.positions[of_reference]  # (N, 3)
    T_reference_estimate = align(source, target)
    aligned = source @ T_reference_estimate[:3, :3].T + T_reference_estimate[:3, 3]
    errors_m = (aligned - target).norm(dim=1)
    return AbsoluteError(estimate.timestamps[of_estimate], errors_m, T_reference_estimate)


def relative_error(estimate: Trajectory, reference: Trajectory, delta_s: float = 1.0) -> RelativeError | None:
    """RPE as the TUM tool's evaluate_rpe.py gives it with fixed_delta: every estimated pose is paired with the one
    nearest to delta_s later, and each pair's motion compared with that of the reference poses nearest in time.

    As there, pairs that end at the last pose are left out, and so are pairs whose reference poses are further than two
    median intervals away. None where nothing is left (an estimate shorter than delta_s).
    """
    times = estimate.timestamps
    begin = torch.arange(len(times))
    end = nearest(times, times + delta_s)
    inside = end != len(times) - 1
    begin, end = begin[inside], end[inside]
    if len(reference) < 2 or len(begin) == 0:
        return None
    limit = 2 * float(reference.timestamps.diff().quantile(0.5))
    reference_begin, reference_end = (
        nearest(reference.timestamps, times[begin]),
        nearest(reference.timestamps, times[end]),
    )
    close = ((reference.timestamps[reference_begin] - times[begin]).abs() <= limit) & (
        (reference.timestamps[reference_end] - times[end]).abs() <= limit
    )
    if not bool(close.any()):
        return None
    begin, end, reference_begin, reference_end = (i[close] for i in (begin, end, reference_begin, reference_end))
    T_end_begin_estimated = inverse(estimate.T_world_cam[end]) @ estimate.T_world_cam[begin]
    T_end_begin_true = inverse(reference.T_world_cam[reference_end]) @ reference.T_world_cam[reference_begin]
    return RelativeError(times[begin], _translation_error(T_end_begin_estimated, T_end_begin_true), delta_s)


def keyframe_error(
    measurements: Sequence[Measurement], reference: Trajectory, max_difference_s: float = ASSOCIATION_LIMIT_S
) -> KeyframeError | None:
    """K2FE: |translation of (T_kf_f true)^-1 T_kf_f estimated| of every frame f measured against a keyframe kf.

    Frames that are their own keyframe, and frames without a reference pose within max_difference_s for both, are left
    out; None where none is left.
    """
    of_others = [m for m in measurements if m.reference_time != m.timestamp]
    if not of_others:
        return None
    times = torch.tensor([m.timestamp for m in of_others], dtype=torch.float64)
    keyframe_times = torch.tensor([m.reference_time for m in of_others], dtype=torch.float64)
    of_frame, of_keyframe = nearest(reference.timestamps, times), nearest(reference.timestamps, keyframe_times)
    close = ((reference.timestamps[of_frame] - times).abs() <= max_difference_s) & (
        (reference.timestamps[of_keyframe] - keyframe_times).abs() <= max_difference_s
    )
    if not bool(close.any()):
        return None
    T_kf_f_estimated = torch.stack([m.T_ref_cam for m in of_others])[close]
    T_kf_f_true = inverse(reference.T_world_cam[of_keyframe[close]]) @ reference.T_world_cam[of_frame[close]]
    return KeyframeError(times[close], _translation_error(T_kf_f_estimated, T_kf_f_true))


def _translation_error(T_estimated: Tensor, T_true: Tensor) -> Tensor:
    """(N,) m, length of the translation between two (N, 4, 4) motions."""
    T_error = inverse(T_estimated) @ T_true  # (N, 4, 4)
    return T_error[:, :3, 3].square().sum(dim=1).sqrt()


def _rmse(errors: Tensor) -> float:
    return float(errors.square().mean().sqrt())
