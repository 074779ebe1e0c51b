"""Is a pose to be believed? Verification against points that did not choose it, and what to try when it is not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .backends import FUSED, Backend
from .candidates import all_patches
from .frame import LEVELS, Frame, Keyframe
from .kernels.model import Noise
from .tracking import Tracked, track_frame

Array = NDArray[np.float64]
Index = NDArray[np.int64]

VERIFIED_LEVEL = 1
VERIFIED_GRAY = 12.0  # gray levels, largest residual of a point that agrees
GAIN_LIMIT = 1.0  # of the logarithm: with no contrast left, a black or a white image would explain everything
QUICK_LEVELS = 3  # of the pyramid, for a frame that is where it was expected
QUICK_POINTS = 128  # coarse points that it takes; with fewer the whole patches cost little
QUICK_STRIDE = 2  # of the coarse points, every second one
QUICK_PIXELS = 1  # of a coarse point's patch, likewise
EXPECTED_PX = 2.0  # mean distance in the image between the predicted and the measured pose of such a frame


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


SURE_BELOW = 0.7  # share of agreeing points under which a quick alignment is not taken for granted
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


def align(
    frame: Frame, keyframe: Keyframe, guess: Array, resting: Array, affine: Array, index: Index, prior: Array,
    noise: Noise, levels: int, surprise_px: float, backend: Backend = FUSED,
) -> tuple[Tracked, Verdict, float]:  # fmt: skip
    """The pose of a frame with as little work as it takes: quickly, thoroughly, or from scratch.

    guess: T_frame_kf by constant velocity, resting: that of a camera that stopped. surprise_px: how far the frame
    before was from its guess; the last value is how far this one is. Cameras move smoothly, so a frame after an
    expected one starts within reach of few coarse pixels; what comes out of it must fit, and be where expected.
    """
    if surprise_px < EXPECTED_PX and len(keyframe.coarse) >= QUICK_POINTS:
        few = np.ascontiguousarray(keyframe.coarse[::QUICK_STRIDE])
        tracked = track_frame(
            frame, keyframe, guess, affine, index, few, prior, noise, min(levels, QUICK_LEVELS), QUICK_PIXELS, backend
        )
        verdict = verify(frame, keyframe, tracked, noise, backend)
        surprise_px = displacement(keyframe, guess, tracked.T_frame_kf, backend)
        if surprise_px < EXPECTED_PX and not verdict.doubt(SURE_BELOW):
            return tracked, verdict, surprise_px
    tracked = track_frame(frame, keyframe, guess, affine, index, keyframe.coarse, prior, noise, levels, None, backend)
    verdict = verify(frame, keyframe, tracked, noise, backend)
    if verdict.doubt(WEAK_BELOW):
        again, second = recover(frame, keyframe, [guess, resting], affine, index, noise, backend)
        if second.score > verdict.score:
            tracked, verdict = again, second
    return tracked, verdict, displacement(keyframe, guess, tracked.T_frame_kf, backend)


def displacement(keyframe: Keyframe, T_a: Array, T_b: Array, backend: Backend = FUSED) -> float:
    """Mean distance in px between where two poses T_frame_kf put the spread-out points; inf if none is in front."""
    cam = keyframe.frame.intrinsics[0]
    return float(backend.agreement.displacement(cam, keyframe.points, keyframe.coarse, T_a, T_b))


def recover(
    frame: Frame, keyframe: Keyframe, guesses: list[Array], affine: Array, index: Index, noise: Noise,
    backend: Backend = FUSED,
) -> tuple[Tracked, Verdict]:  # fmt: skip
    """Try again from each guess of T_frame_kf with all candidates and the widest pyramid, no prior; the best one.

    The finest level keeps the chosen points `index`.
    """
    free = np.diag([1e-2] * 6)
    everyone = np.arange(len(keyframe.points.uv))
    keyframe = all_patches(keyframe, backend)
    best: tuple[Tracked, Verdict] | None = None
    for guess in guesses:
        tracked = track_frame(frame, keyframe, guess, affine, index, everyone, free, noise, LEVELS, None, backend)
        verdict = verify(frame, keyframe, tracked, noise, backend)
        if best is None or verdict.score > best[1].score:
            best = (tracked, verdict)
        if not best[1].doubt(WEAK_BELOW):
            break
    assert best is not None  # guesses is never empty
    return best
