"""The whole check: read the samples once, measure, judge."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..datasets import RgbdSequence
from ..trajectory import Trajectory
from . import judge
from .calibration import SelfCalibration, self_calibrate
from .camera_seen import CameraSeen
from .edges import STRONG, EdgeSums
from .findings import Finding, Verdict
from .images import ImageStatistics, statistics
from .measured import Measured
from .motion import ReferenceMotion, reference_motion
from .samples import read_runs, spread
from .scene import two_motions
from .timing import lists, timing
from .tracks import Tracks
from .view import Views

EVERY = 4  # sampled frames between two whose images are measured


@dataclass(frozen=True)
class Report:
    """A row per question, and what they were judged from."""

    findings: list[Finding]
    measured: Measured

    @property
    def faults(self) -> list[Finding]:
        """The rows that will spoil the poses."""
        return [finding for finding in self.findings if finding.verdict is Verdict.FAULT]


def check(
    sequence: RgbdSequence, folder: Path | None = None, on_frame: Callable[[str], None] = lambda note: None
) -> Report:
    """Look at frames spread over a recording and say what is wrong with it; seconds, whatever its length.

    folder: where its lists rgb.txt and depth.txt are, to count what was not paired. on_frame is called for every
    frame looked at.
    """
    edges, tracks, images, broken = EdgeSums(), Tracks(), list[ImageStatistics](), list[str]()
    views, camera_seen = Views(), CameraSeen(sequence.camera)
    shown, most, sampled = None, -1.0, 0
    for run in read_runs(sequence, broken):
        pixels = edges.pixels
        edges.add(run)
        tracks.add(run)
        views.add(run)
        camera_seen.add(run)
        images += [statistics(sample) for sample in run[::EVERY]]
        if run and edges.pixels - pixels > most:
            shown, most = run[len(run) // 2], edges.pixels - pixels
        for _ in run:
            on_frame("")
        sampled += len(run)
    calibration = self_calibrate(tracks.pairs, sequence.camera)
    edge_fit = edges.fit()
    measured = Measured(
        camera=sequence.camera,
        frames=len(sequence),
        sampled=sampled + len(broken),
        broken=broken,
        lists=None if folder is None else lists(folder),
        timing=timing(sequence.timestamps),
        images=images,
        edges=edge_fit,
        tracks=tracks,
        calibration=calibration,
        motion=_motion(sequence.groundtruth, sequence.timestamps, calibration),
        shown=shown,
        depth_scale=getattr(sequence, "depth_scale", None),
        camera_seen=camera_seen.fit(),
        view=views.fit() if edge_fit.strength < STRONG else None,
        motions_apart=[m for pair in tracks.pairs if (m := two_motions(pair, sequence.camera)) is not None],
    )
    return Report(judge.findings(measured), measured)


def sampled_frames(sequence: RgbdSequence) -> int:
    """How many frames check() will look at."""
    return sum(map(len, spread(len(sequence))))


def _motion(
    groundtruth: Trajectory | None, timestamps: list[float], calibration: SelfCalibration | None
) -> ReferenceMotion | None:
    if groundtruth is None:
        return None
    return reference_motion(groundtruth, np.array(timestamps), [] if calibration is None else calibration.motions)
