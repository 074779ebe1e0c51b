"""Is a pose to be believed? Verification against points that did not choose it, and what to try when it is not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..frame import Frame, Keyframe
from ..measurement import Noise
from .backends import FUSED, Backend
from .tracking import Tracked

Array = NDArray[np.float64]
Index = NDArray[np.int64]

VERIFIED_LEVEL = 1
VERIFIED_GRAY = 12.0  # gray levels, largest residual of a point that agrees
GAIN_LIMIT = 1.0  # of the logarithm: with no contrast left, a black or a white image would explain everything


@dataclass(frozen=True)
class Verdict:
    """How well a pose explains a few hundred points that did not choose it."""

    visible: float  # share of the points that the frame sees
    bright: float  # share of those with agreeing brightness
    near: float  # share of those with depth that agree in depth

    @property
    def score(self) -> float:
        """For the choice between two poses."""
        return self.visible * self.bright * self.near

    def doubt(self, strict: float) -> str:
        """Why the pose is not to be believed, empty when it is; strict grows the limits towards 1."""
        if self.visible < 0.15:
            return f"only {self.visible:.0%} of the keyframe is in view"
        if self.bright < strict:
            return f"only {self.bright:.0%} of the points agree in brightness"
        if self.near < strict + 0.12:
            return f"only {self.near:.0%} of the points agree in depth"
        return ""


WEAK_BELOW = 0.61  # share of agreeing points under which a pose is doubtful
LOST_BELOW = 0.54  # and under which it is not used
UNSURE_BITS = -7.0  # entropy of the least certain degree of freedom, about 2 mm or 2 mrad given the others
FREEDOMS = ("x", "y", "z", "rotation about x", "rotation about y", "rotation about z")


def unsure(entropies: Array) -> str:
    """Why a pose with these entropies (6,) in bits is doubtful however well it fits, empty when it is not."""
    bits, freedom = max(zip(entropies.tolist(), FREEDOMS, strict=True))
    return f"{freedom} is uncertain: {bits:.1f} bits" if bits > UNSURE_BITS else ""


def verify(frame: Frame, keyframe: Keyframe, tracked: Tracked, noise: Noise, backend: Backend = FUSED) -> Verdict:
    """Hold a pose against all the spread-out points of the keyframe."""
    witnesses = keyframe.witnesses
    seen, bright, with_depth, near = backend.agreement.verify(
        frame.images[VERIFIED_LEVEL], frame.depth, keyframe.frame.intrinsics[VERIFIED_LEVEL], VERIFIED_LEVEL,
        keyframe.points, keyframe.points.patch[VERIFIED_LEVEL], witnesses, tracked.T_frame_kf, tracked.affine, noise,
        VERIFIED_GRAY,
    )  # fmt: skip
    if not (np.isfinite(tracked.T_frame_kf).all() and tracked.points >= 6):
        return Verdict(0.0, 0.0, 0.0)
    if abs(tracked.affine[0]) > GAIN_LIMIT:
        bright = 0
    few = 0 < with_depth < 12  # a frame with little depth is judged by its brightness alone, one with none is broken
    return Verdict(seen / max(len(witnesses), 1), bright / max(seen, 1), 1.0 if few else near / max(with_depth, 1))
