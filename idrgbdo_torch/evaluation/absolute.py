"""ATE, the absolute trajectory error, as the TUM tools define it."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from ..errors import IdRgbdoError
from ..trajectory import Trajectory, align, associate, nearest

ASSOCIATION_LIMIT_S = 0.02
FEWEST = 3  # points that fix a rigid motion


@dataclass(frozen=True)
class AbsoluteError:
    """Absolute trajectory error: position differences after one rigid alignment without scale."""

    timestamps: Tensor  # (N,) float64 s, of the estimate
    errors_m: Tensor  # (N,) float64
    T_reference_estimate: Tensor  # (4, 4) float64, the alignment: estimate's world to the reference's world

    @property
    def rmse_m(self) -> float:
        """Root mean square over all matched poses, m."""
        return float(self.errors_m.square().mean().sqrt())


def absolute_error(
    estimate: Trajectory, reference: Trajectory, max_difference_s: float = ASSOCIATION_LIMIT_S
) -> AbsoluteError:
    """ATE: positions are matched by time one to one, aligned by a rigid motion, and compared.

    Raises IdRgbdoError when fewer than three poses match (three points fix a rigid motion).
    """
    of_estimate, of_reference = associate(estimate.timestamps, reference.timestamps, max_difference_s)
    if len(of_estimate) < FEWEST:
        raise IdRgbdoError(_too_few(len(of_estimate), estimate, reference, max_difference_s))
    source, target = estimate.positions[of_estimate], reference.positions[of_reference]  # (N, 3)
    T_reference_estimate = align(source, target)
    return AbsoluteError(
        estimate.timestamps[of_estimate], distances(source, target, T_reference_estimate), T_reference_estimate
    )


def distances(source: Tensor, target: Tensor, T_target_source: Tensor) -> Tensor:
    """(N,) m between (N, 3) points, the source moved by (4, 4) T_target_source."""
    moved = source @ T_target_source[:3, :3].T + T_target_source[:3, 3]
    apart: Tensor = (moved - target).norm(dim=1)
    return apart


def _too_few(matched: int, estimate: Trajectory, reference: Trajectory, limit_s: float) -> str:
    """Why so few poses match, and what to do."""
    wanted = f"evaluation: expected at least {FEWEST} poses within {limit_s:g} s of a reference pose, got {matched}"
    for name, trajectory in (("estimate", estimate), ("reference", reference)):
        if len(trajectory) < FEWEST:
            return f"{wanted}: the {name} has only {len(trajectory)}; pass one with more poses"
    (a, b), (c, d) = (tuple(t.timestamps[[0, -1]].tolist()) for t in (estimate, reference))
    if a > d or c > b:
        return (
            f"{wanted}: the estimate runs from {a:.3f} to {b:.3f} s, the reference from {c:.3f} to {d:.3f} s, so they "
            "do not overlap; check that both files are of one recording, and give them one clock"
        )
    index = nearest(estimate.timestamps, reference.timestamps)
    gap = float((estimate.timestamps[index] - reference.timestamps).abs().min())
    return f"{wanted} (the closest two are {gap:.3f} s apart); check that both are of one clock, or raise the limit"
