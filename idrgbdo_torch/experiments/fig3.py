"""Fig. 3: accumulated keyframe-to-frame error against the number of points, for each way to select them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from statistics import fmean
from typing import TYPE_CHECKING, get_args

from ..config import Config, Mode
from ..errors import IdRgbdoError
from .drawing import ERROR_BAR, MODE_COLORS, new_figure, ticks_at
from .lab import Lab, Report, Table, interval
from .task import Clip, Measured, Task

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MODES: tuple[Mode, ...] = get_args(Mode)
POINTS = (24, 32, 48, 64, 96, 128, 192, 256)
QUICK_POINTS = (24, 48, 96, 256)
LOW = 96  # points up to which the order of the modes is looked at
TIE = 1.1  # inf+grid may be so much worse than inf


@dataclass(frozen=True)
class Point:
    """One mode with one number of points, over all sequences."""

    mode: Mode
    points: int
    k2fe_m: float  # accumulated over the sequences, mean over the seeds
    half_width_m: float  # of its 95 % confidence interval
    lost_percent: float
    runs: tuple[tuple[Clip, tuple[Measured, ...]], ...]  # of each sequence, over the seeds


def run(lab: Lab) -> Report:
    """Measure, and hold the order of the modes against the paper's."""
    points = survey(lab)
    rows = tuple((p.mode, p.points, p.k2fe_m, p.half_width_m, p.lost_percent, _mean_mm(p)) for p in points)
    columns = ("mode", "points", "accumulated K2FE m", "95 % interval +- m", "lost %", "mean K2FE mm")
    per_sequence = tuple(
        (point.mode, point.points, clip.name, *interval([1000 * _k2fe(run) for run in runs]))
        for point in points
        for clip, runs in point.runs
    )
    return Report(
        f"Fig. 3: selection of points, {lab.source}",
        {
            "fig3": Table(columns, rows),
            "fig3_sequences": Table(("mode", "points", "sequence", "K2FE mm", "95 % interval +- mm"), per_sequence),
        },
        (*_left_out(lab, points), *findings(points)),
        lambda: draw(points),
    )


def _left_out(lab: Lab, points: Sequence[Point]) -> list[str]:
    """Which sequences could not be counted."""
    counted = {clip.name for clip, _ in points[0].runs}
    missing = [clip.name for clip in lab.clips if clip.name not in counted]
    return [f"left out, since some run has no K2FE there: {', '.join(missing)}"] if missing else []


def _mean_mm(point: Point) -> float:
    return 1000 * fmean(_k2fe(run) for _, runs in point.runs for run in runs)


def survey(lab: Lab) -> list[Point]:
    """All modes with all numbers of points. A seed moves the clip on by a frame too, for a spread."""
    plan = {
        (mode, count): {
            clip: [Task(clip.shifted(seed, lab.seeds), config=configured(mode, count), seed=seed)
                   for seed in range(lab.seeds)]
            for clip in lab.clips
        }
        for mode in MODES
        for count in (QUICK_POINTS if lab.quick else POINTS)
    }  # fmt: skip
    tasks = [task for clips in plan.values() for of_clip in clips.values() for task in of_clip]
    results = dict(zip(tasks, lab.measure(tasks), strict=True))
    blind = {task.clip.name for task, run in results.items() if run.k2fe_mean_m is None}
    points = []
    for (mode, count), clips in plan.items():
        runs = {
            clip: tuple(results[task] for task in of_clip) for clip, of_clip in clips.items() if clip.name not in blind
        }
        if not runs:
            raise IdRgbdoError(f"fig3: every sequence has a run without any K2FE ({_why(results.values())})")
        points.append(_point(mode, count, runs))
    return points


def _why(runs: Iterable[Measured]) -> str:
    return next((run.error for run in runs if run.error), "no reference poses, or nothing was tracked")


def configured(mode: Mode, points: int) -> Config:
    """The defaults with another selection, whose points alone count: the coarse levels only say where to start."""
    config = Config()
    selection = replace(config.selection, mode=mode, points=points)
    return replace(config, selection=selection, noise=replace(config.noise, coarse=0.0))


def _point(mode: Mode, points: int, runs: Mapping[Clip, tuple[Measured, ...]]) -> Point:
    seeds = range(len(next(iter(runs.values()))))
    totals = [sum(_k2fe(of_clip[seed]) * of_clip[seed].frames for of_clip in runs.values()) for seed in seeds]
    everything = [run for of_clip in runs.values() for run in of_clip]
    lost = 100 * sum(run.lost for run in everything) / max(sum(run.frames for run in everything), 1)
    return Point(mode, points, *interval(totals), lost, tuple(runs.items()))


def _k2fe(run: Measured) -> float:
    """Mean over the frames that were tracked; lost ones count as the others do."""
    assert run.k2fe_mean_m is not None  # sequences without it are left out
    return run.k2fe_mean_m


def findings(points: Sequence[Point]) -> list[str]:
    """What the paper claims, decided by the numbers."""
    at = {(point.mode, point.points): point for point in points}
    counts = sorted({point.points for point in points})
    low = [count for count in counts if count <= LOW]
    order = [
        count for count in low if at["inf+grid", count].k2fe_m < at["grid", count].k2fe_m < at["rand", count].k2fe_m
    ]
    tie = [count for count in low if at["inf+grid", count].k2fe_m <= TIE * at["inf", count].k2fe_m]
    few = counts[0]
    best, worst = at["inf+grid", few], at["rand", few]
    apart = best.k2fe_m + best.half_width_m < worst.k2fe_m - worst.half_width_m
    reached = _points_to_reach([at["rand", count] for count in counts], best.k2fe_m)
    return [
        f"inf+grid < grid < rand at {_of(order, low)}",
        f"inf+grid <= {TIE:g} x inf at {_of(tie, low)}",
        f"at {few} points the intervals of inf+grid and rand {'do not overlap' if apart else 'OVERLAP'}: "
        f"{best.k2fe_m:.4f} +- {best.half_width_m:.4f} m and {worst.k2fe_m:.4f} +- {worst.half_width_m:.4f} m",
        f"rand reaches the accuracy of inf+grid at {few} points with "
        + (f"about {reached:.0f} points" if reached else f"more than {counts[-1]} points"),
    ]


def _of(found: Sequence[int], all_of: Sequence[int]) -> str:
    return f"{len(found)} of {len(all_of)} numbers of points ({', '.join(map(str, found)) or 'none'})"


def _points_to_reach(curve: Sequence[Point], k2fe_m: float) -> float | None:
    """Where a falling curve comes down to an error, between its points; None where it does not."""
    if curve[0].k2fe_m <= k2fe_m:
        return float(curve[0].points)
    for a, b in pairwise(curve):
        if b.k2fe_m <= k2fe_m:
            share = (a.k2fe_m - k2fe_m) / (a.k2fe_m - b.k2fe_m)
            return a.points + share * (b.points - a.points)
    return None


def draw(points: Sequence[Point]) -> Figure:
    """As the paper draws it."""
    figure = new_figure(width=6.0)
    (axes,) = figure.axes
    for mode in MODES:
        line = [point for point in points if point.mode == mode]
        x, y = [point.points for point in line], [point.k2fe_m for point in line]
        axes.errorbar(
            x, y, [point.half_width_m for point in line], label=mode, color=MODE_COLORS[mode],
            **ERROR_BAR,
        )  # fmt: skip
    axes.set_xscale("log")
    ticks_at(axes.xaxis, sorted({point.points for point in points}))
    axes.set_xlabel("points")
    axes.set_ylabel("accumulated K2FE (m)")
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False)
    return figure
