"""Verdicts on what is filmed and from where: a depth camera of another view, cuts, a camera at rest, moving things.

Those on the scene are silent where nothing is noticed.
"""

from __future__ import annotations

import math

import numpy as np

from ..definitions.camera import Pinhole
from .findings import Finding, Verdict
from .scene import TwoMotions
from .tracks import Tracks
from .view import ViewFit

CUT_KEPT, AROUND_KEPT = 0.1, 0.6  # share of corners found again across a cut at most, on both sides of it at least
STILL_PX, STILL_SHARE = 0.3, 0.5  # motion in the image, share of the frames
APART_SHARE, APART_PAIRS, FEWEST_PAIRS = 0.25, 0.33, 2  # of the corners; of the pairs of frames; pairs


def another_view(name: str, view: ViewFit, camera: Pinhole) -> Finding:
    """The fault of depth that was taken by a camera of another angle of view, and the block that describes it."""
    fx, fy = camera.fx / view.zoom, camera.fy / view.zoom
    middle = (camera.width - 1) / 2, (camera.height - 1) / 2
    cx = middle[0] + (camera.cx - middle[0] + view.shift[0]) / view.zoom
    cy = middle[1] + (camera.cy - middle[1] + view.shift[1]) / view.zoom
    wide = [2 * math.degrees(math.atan(camera.width / (2 * focal))) for focal in (camera.fx, fx)]
    value = (
        f"depth fits colour's edges only {view.zoom:.2f} times as large: it seems {wide[1]:.0f} degrees wide, "
        f"colour {wide[0]:.0f}"
    )
    advice = (
        "depth is not registered to colour: register it with the camera's software, or describe the depth camera in "
        f"the camera file, for example\n[depth]\nfx = {fx:.0f}\nfy = {fy:.0f}\ncx = {cx:.0f}\ncy = {cy:.0f}\n"
        "T_color_depth = [[1, 0, 0, 0.015], [0, 1, 0, 0], [0, 0, 1, 0]]\n"
        "the first four are estimates from the images, the last is a RealSense D435's: take your camera's own values"
    )
    return Finding(name, Verdict.FAULT, value, advice)


def cut(tracks: Tracks) -> Finding | None:
    """A note on frames that share nothing with the one before, among others that do; None for none."""
    kept = dict(zip(tracks.found_at, tracks.kept, strict=True))
    cuts = [
        at
        for at, share in kept.items()
        if share < CUT_KEPT and min(kept.get(at - 1, 0.0), kept.get(at + 1, 0.0)) > AROUND_KEPT
    ]
    if not cuts:
        return None
    more = f", and {len(cuts) - 1} more" if len(cuts) > 1 else ""
    value = f"frame {cuts[0]} shares {100 * kept[cuts[0]]:.0f} % of its corners with the one before{more}"
    advice = "a cut to another scene, or a jump of the camera: tracking breaks there, run the parts on their own"
    return Finding("cut", Verdict.NOTE, value, advice)


def still(tracks: Tracks) -> Finding | None:
    """A note where the image hardly moves in most of the frames; None else."""
    share = float(np.mean(np.array(tracks.flow) < STILL_PX)) if tracks.flow else 0.0
    if share <= STILL_SHARE:
        return None
    value = f"the image moves less than {STILL_PX} px in {100 * share:.0f} % of the frames"
    return Finding("still camera", Verdict.NOTE, value, "nothing to track there: begin where the camera moves, --start")


def moving(pairs: list[TwoMotions]) -> Finding | None:
    """A note where much of the view moves otherwise than the rest, over and over; None else."""
    apart = [pair.second for pair in pairs if pair.second >= APART_SHARE]
    if len(apart) < max(FEWEST_PAIRS, APART_PAIRS * len(pairs)):
        return None
    value = f"in {len(apart)} of {len(pairs)} stretches {100 * np.median(apart):.0f} % of the corners move on their own"
    advice = "a moving object over much of the view? the larger part of the view is what is tracked: film it without"
    return Finding("moving things", Verdict.NOTE, value, advice)
