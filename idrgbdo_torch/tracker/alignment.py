"""The pose of a frame with as little work as it takes: quickly, thoroughly, or from scratch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..frame import Frame, Keyframe
from ..measurement import LEVELS, Noise
from .backends import FUSED, Backend
from .keyframe import all_patches
from .tracking import Tracked, track_frame
from .verification import WEAK_BELOW, Verdict, verify

Array = NDArray[np.float64]
Index = NDArray[np.int64]

QUICK_LEVELS = 3  # of the pyramid, for a frame that is where it was expected
QUICK_POINTS = 128  # coarse points that it takes; with fewer the whole patches cost little
QUICK_STRIDE = 2  # of the coarse points, every second one
QUICK_PIXELS = 1  # of a coarse point's patch, likewise
EXPECTED_PX = 2.0  # mean distance in the image between the predicted and the measured pose of such a frame
SURE_BELOW = 0.7  # share of agreeing points under which a quick alignment is not taken for granted


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
