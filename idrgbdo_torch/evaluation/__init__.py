"""How far an estimate is from a reference: ATE, RPE over one second, K2FE; and what looks wrong with the two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..errors import door
from ..trajectory import Trajectory
from .absolute import ASSOCIATION_LIMIT_S, AbsoluteError, absolute_error
from .hints import hints
from .keyframe import KeyframeError, Measurement, keyframe_error
from .relative import DELTA_S, RelativeError, relative_error, why_none, without_orientation

__all__ = [
    "ASSOCIATION_LIMIT_S",
    "AbsoluteError",
    "Evaluation",
    "KeyframeError",
    "Measurement",
    "RelativeError",
    "absolute_error",
    "evaluate",
    "hints",
    "keyframe_error",
    "relative_error",
    "why_none",
]


@dataclass(frozen=True)
class Evaluation:
    """All three errors of one estimate; None where the data has no pair to measure it on."""

    matched_poses: int  # poses of the estimate with a reference pose within the association limit
    ate: AbsoluteError
    rpe: RelativeError | None
    k2fe: KeyframeError | None = None
    poses: int = 0  # of the estimate
    no_rpe: str = ""  # why there is none


@door
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
    rpe = relative_error(estimate, reference, DELTA_S, max_difference_s)
    k2fe = None
    if not without_orientation(estimate, reference):
        k2fe = keyframe_error(measurements, reference, max_difference_s)
    reason = "" if rpe else why_none(estimate, reference, DELTA_S, max_difference_s)
    return Evaluation(len(ate.timestamps), ate, rpe, k2fe, len(estimate), reason)
