"""A frame whose colour image is that of the one before: where the motion and its depth alone put it."""

from __future__ import annotations

from dataclasses import replace

from ..config import Config
from ..kernels.se3 import inverse
from ..measurement import State, Subset
from .motion import Motion
from .reference import Reference
from .tracking import Pair, Tracked, motion_information, track_frame

BLIND = 1e12  # gray levels^2, of an image that is not to be believed
LATE_COLOR = "the colour image is that of the frame before"


def track_between(pair: Pair, motion: Motion, reference: Reference, config: Config) -> Tracked:
    """Align depth alone, held by the motion prior. The information contains the prior: nothing else is known of what
    depth leaves open.
    """
    frame = pair.frame
    frame = (motion.prefers_earlier(0.0) and motion.with_earlier_depth(frame)) or frame
    dt, coarse = motion.gap(frame.timestamp), reference.keyframe.coarse
    start = State(motion.predicted(dt) @ inverse(reference.T_kf_world), reference.affine)
    information = motion_information(config, dt)
    blind = replace(pair, frame=frame, noise=pair.noise._replace(var_intensity=BLIND))
    tracked = track_frame(blind, start, coarse, Subset(coarse, 1), information, 1)
    return replace(tracked, information=tracked.information + information)
