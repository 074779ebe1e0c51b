"""Blur hides where the camera is: what is measured against a blurred keyframe fits wherever it lies.

A frame much less sharp than its keyframe makes no keyframe while that is in view. Where it must, that keyframe is
doubted, and so is each that is made after it, until a frame is found in one from before.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..frame import Frame
from ..kernels.sights import median_slopes
from .tracking import Pair, Tracked, track_closely
from .verification import LIMITS, Verdict, verify

Array = NDArray[Any]

BLURRED = 0.57  # sharpness over that of the last view that was not, under which a view is
LEVEL = 1  # of the pyramid that sharpness is measured on: noise is no sharpness
SHARP_AGAIN = 0.75  # mean slope of an image over that of one before the blur, from which on it is sharp again
AS_STEEP = 0.9  # of one over that of its keyframe, from which on no blur is what makes them differ
ALIKE = 0.95  # share of the points that agree in brightness; fewer are looked into
ALIKE_LEVEL = 3  # on which a blurred view looks like a sharp one
EVERY = 3  # sharp frames in doubt, of which one is looked for by its features
SETTLED = 15  # sharp frames in doubt after which what they see is taken as it is,
LONGEST = 60  # and frames at all
STRIDE = 2  # of the points that it is measured at
KEPT_IN_VIEW = 0.5  # share of a keyframe's points in view under which a blurred frame makes a keyframe after all


def sharpness(pair: Pair, T_frame_kf: Array) -> float:
    """How steep the frame is where it sees the keyframe's points, over how steep the keyframe is there: medians.

    At a wrong pose other places are seen, so an image that is as steep as the keyframe's on the whole is as sharp.
    """
    points, frame, keyframe = pair.keyframe.points, pair.frame, pair.keyframe.frame
    inside, there, here = median_slopes(
        points.uv, points.inv_depth, pair.keyframe.witnesses[::STRIDE], T_frame_kf, frame.intrinsics[0],
        frame.depth.shape, frame.images[LEVEL], keyframe.images[LEVEL],
    )  # fmt: skip
    if not inside:
        return 1.0
    sharp = float(there) / max(float(here), 1e-3)
    return sharp if sharp >= BLURRED else max(sharp, BLURRED / AS_STEEP * steepness(pair.frame, pair.keyframe.frame))


def steepness(frame: Frame, before: Frame) -> float:
    """The mean slope of an image over that of another."""
    whole, then = (float(np.abs(np.diff(image.images[LEVEL][::STRIDE])).mean()) for image in (frame, before))
    return whole / max(then, 1e-3)


def sharpness_since(pair: Pair, T_frame_kf: Array, before: Frame) -> float:
    """That of a frame over the last keyframe's that was not blurred; before: any frame from then.

    Points that were chosen in a blurred keyframe are not where a sharp frame is steep, so the images are asked too.
    """
    sharp = pair.keyframe.sharp * sharpness(pair, T_frame_kf)
    if pair.keyframe.sharp >= BLURRED:
        return sharp
    return max(sharp, BLURRED / SHARP_AGAIN * steepness(pair.frame, before))


def is_blurred(pair: Pair, T_frame_kf: Array, verdict: Verdict) -> bool:
    """Whether the frame or the keyframe is; those that look alike are not looked into."""
    return (
        verdict.bright < ALIKE and min(pair.keyframe.sharp, pair.keyframe.sharp * sharpness(pair, T_frame_kf)) < BLURRED
    )


def align_blurred(pair: Pair, tracked: Tracked, information: Array) -> tuple[Tracked, Verdict]:
    """Align a frame once more from where it was found, with all spread-out points: each says little in a blurred view.

    A pose that is doubtful is supported where both views look alike when seen from afar, and agree in depth.
    information: (6, 6) by which that pose holds, the motion prior's.
    """
    tracked = track_closely(pair, tracked, information)
    verdict = verify(pair, tracked)
    if not verdict.doubt(LIMITS.weak) or verdict.near < LIMITS.sure + LIMITS.depth_above:
        return tracked, verdict
    alike = verify(pair, tracked, ALIKE_LEVEL).bright >= LIMITS.weak
    return tracked, replace(verdict, supported=alike)
