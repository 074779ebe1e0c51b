"""Fig. 1: trajectories and maps with 24 and with 500 points, and what was tracked on two frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..datasets import open_sequence
from ..definitions.se3 import transform
from ..evaluation import Evaluation, evaluate
from ..frame import RgbdFrame
from ..odometry import Record
from ..odometry import run as track_all
from ..runs.folder import measurements
from ..tracker.id_rgbdo import IdRgbdo
from .drawing import BLUE, MAGENTA, new_figure
from .fig3 import configured
from .lab import Lab, Report, Table
from .task import Clip

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MANY, FEW = 500, 24
PREFERRED = "fr3_long_office_household"
SHOWN_POINTS = 60_000  # of the map
Array = NDArray[Any]


@dataclass(frozen=True)
class Outcome:
    """One run, aligned to the reference where there is one."""

    points: int
    evaluation: Evaluation | None
    positions: Array  # (N, 3) m
    cloud: Array  # (M, 3) m
    colors: Array  # (M, 3) 0..1
    tracked: dict[int, Array]  # (P, 2) px, by the number of the frame
    ms_median: float
    lost: int


def run(lab: Lab) -> Report:
    """Track one clip twice."""
    clip = next((clip for clip in lab.clips if clip.name == PREFERRED), lab.clips[0])
    sequence = open_sequence(clip.folder, start=clip.start, max_frames=clip.frames)
    picks = [len(sequence) // 3, (2 * len(sequence)) // 3]
    outcomes = [_track(clip, points, picks) for points in (MANY, FEW)]
    images = [frame.gray.numpy() for k in picks if isinstance(frame := sequence.read(k), RgbdFrame)]
    rows = tuple(_row(outcome) for outcome in outcomes)
    many, few = outcomes
    return Report(
        f"Fig. 1: {MANY} and {FEW} points on {clip.name}, {lab.source}",
        {"fig1": Table(("points", "ATE mm", "RPE mm/s", "K2FE mm", "lost", "median ms a frame"), rows)},
        (f"median time a frame: {few.ms_median:.1f} ms with {FEW} points, {many.ms_median:.1f} ms with {MANY}",),
        lambda: draw(outcomes, images, picks),
    )


def _track(clip: Clip, points: int, picks: Sequence[int]) -> Outcome:
    sequence = open_sequence(clip.folder, start=clip.start, max_frames=clip.frames)
    odometry = IdRgbdo(configured("inf+grid", points))
    tracked: dict[int, Array] = {}
    records: list[Record] = []

    def on_record(record: Record) -> None:
        if len(records) in picks:
            tracked[len(records)] = odometry.last_points()[0].numpy()
        records.append(record)

    done = track_all(odometry, sequence, on_record)
    xyz, rgb = odometry.map_points()
    thin = slice(None, None, max(1, len(xyz) // SHOWN_POINTS))
    evaluation, positions, cloud = None, odometry.trajectory().positions, xyz[thin].double()
    if sequence.groundtruth is not None:
        evaluation = evaluate(done.trajectory(), sequence.groundtruth, measurements(done))
        T = evaluation.ate.T_reference_estimate
        positions, cloud = transform(T, positions), transform(T, cloud)
    ms = float(np.median([record.track_ms for record in records if record.track_ms is not None]))
    lost = sum(record.result.status.value == "lost" for record in records)
    return Outcome(points, evaluation, positions.numpy(), cloud.numpy(), rgb[thin].numpy() / 255.0, tracked, ms, lost)


def _row(outcome: Outcome) -> tuple[float | int | None, ...]:
    errors = outcome.evaluation
    rpe = 1000 * errors.rpe.rmse_m_per_s if errors and errors.rpe else None
    k2fe = 1000 * errors.k2fe.mean_m if errors and errors.k2fe else None
    ate = 1000 * errors.ate.rmse_m if errors else None
    return (outcome.points, ate, rpe, k2fe, outcome.lost, outcome.ms_median)


def draw(outcomes: Sequence[Outcome], images: Sequence[Array], picks: Sequence[int]) -> Figure:
    """Above the two maps with their trajectories, below two frames with the points of both."""
    figure = new_figure(columns=2, rows=2, height=4.0)
    positions = np.concatenate([outcome.positions for outcome in outcomes])
    across, along = _plane(positions)
    onto = np.stack([across, along], 1)  # (3, 2)
    cloud, path = np.concatenate([outcome.cloud for outcome in outcomes]) @ onto, positions @ onto
    low = np.minimum(np.percentile(cloud, 1, axis=0), path.min(axis=0) - 0.1)
    high = np.maximum(np.percentile(cloud, 99, axis=0), path.max(axis=0) + 0.1)
    for axes, outcome in zip(figure.axes[:2], outcomes, strict=True):
        axes.scatter(outcome.cloud @ across, outcome.cloud @ along, s=0.6, c=outcome.colors, linewidths=0)
        for other, shade in zip(outcomes, (BLUE, MAGENTA), strict=True):
            own = other is outcome
            width, order = (2.0, 4) if own else (1.0, 3)
            axes.plot(other.positions @ across, other.positions @ along, color=shade, linewidth=width, zorder=order)
            if own:
                axes.set_title(f"{other.points} points", color=shade, fontsize=11)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="m", ylabel="m", aspect="equal")
    for axes, image, number in zip(figure.axes[2:], images, picks, strict=True):
        axes.imshow(image, cmap="gray", vmin=0, vmax=255)
        many, few = (outcome.tracked.get(number, np.zeros((0, 2))) for outcome in outcomes)
        axes.plot(*many.T, ".", color=BLUE, markersize=3)
        axes.plot(*few.T, "s", color=MAGENTA, markersize=6, fillstyle="none")
        axes.set_axis_off()
        axes.set_title(f"frame {number}", fontsize=9)
    return figure


def _plane(positions: Array) -> tuple[Array, Array]:
    """The two directions in which the path is widest, (3,) each."""
    _, _, axes = np.linalg.svd(positions - positions.mean(axis=0), full_matrices=False)
    return axes[0], axes[1]
