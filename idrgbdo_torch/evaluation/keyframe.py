"""K2FE, the keyframe-to-frame error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ..definitions.se3 import inverse
from ..trajectory import Trajectory, nearest
from .absolute import ASSOCIATION_LIMIT_S


@dataclass(frozen=True)
class Measurement:
    """The pose of one frame as it was measured against its keyframe."""

    timestamp: float  # s, the frame
    reference_time: float  # s, the keyframe
    T_ref_cam: Tensor  # (4, 4) float64


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
    T_error = inverse(T_kf_f_estimated) @ T_kf_f_true
    return KeyframeError(times[close], T_error[:, :3, 3].norm(dim=1))
