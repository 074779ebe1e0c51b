"""Fig. 6: trajectory errors against the threshold that makes a keyframe."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from statistics import fmean, median
from typing import TYPE_CHECKING, Literal

from ..config import Config
from .drawing import ERROR_BAR, SERIES, new_figure, ticks_at
from .lab import Lab, Report, Table, interval
from .task import Measured, Task

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FACTORS = (0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 6.0, 10.0)  # of the default threshold
QUICK_FACTORS = (0.02, 0.1, 0.3, 0.6, 1.0, 1.7, 3.0, 6.0)
ERRORS = (0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0)  # ticks of the figure
FLAT = 1.03  # so much above the minimum is still "at the minimum"
Criterion = Literal["bits", "ratio"]


@dataclass(frozen=True)
class Level:
    """One threshold, over all sequences: errors relative to each sequence's median over the thresholds."""

    criterion: Criterion
    factor: float  # of the default
    threshold: float
    rpe: float
    rpe_half_width: float
    ate: float
    ate_half_width: float
    keyframes_percent: float
    lost_percent: float


def run(lab: Lab) -> Report:
    """Sweep the threshold of the default criterion, and of the paper's ratio."""
    default = Config().keyframe.criterion
    criteria: tuple[Criterion, ...] = (default,) if lab.quick else ("bits", "ratio")
    levels = [level for criterion in criteria for level in _levels(lab, criterion)]
    columns = (
        *("criterion", "threshold", "factor of the default", "normalised RPE", "+-", "normalised ATE", "+-"),
        *("keyframes %", "lost %"),
    )
    rows = tuple(
        (v.criterion, v.threshold, v.factor, v.rpe, v.rpe_half_width, v.ate, v.ate_half_width, v.keyframes_percent,
         v.lost_percent)
        for v in levels
    )  # fmt: skip
    found = [line for criterion in criteria for line in findings([v for v in levels if v.criterion == criterion])]
    return Report(
        f"Fig. 6: creation of keyframes, {lab.source}",
        {"fig6": Table(columns, rows)},
        tuple(found),
        lambda: draw(levels),
    )


def with_threshold(criterion: Criterion, factor: float) -> tuple[Config, float]:
    """The defaults with a multiple of the criterion's default threshold, and that threshold."""
    config = Config()
    keyframe = replace(config.keyframe, criterion=criterion)
    if criterion == "bits":
        keyframe = replace(keyframe, threshold_bits=factor * config.keyframe.threshold_bits)
        return replace(config, keyframe=keyframe), keyframe.threshold_bits
    keyframe = replace(keyframe, threshold_ratio=factor * config.keyframe.threshold_ratio)
    return replace(config, keyframe=keyframe), keyframe.threshold_ratio


def _levels(lab: Lab, criterion: Criterion) -> list[Level]:
    factors = QUICK_FACTORS if lab.quick else FACTORS
    seeds = range(lab.seeds)
    tasks = [
        Task(clip.shifted(seed, lab.seeds), config=with_threshold(criterion, factor)[0], seed=seed)
        for factor in factors
        for clip in lab.clips
        for seed in seeds
    ]
    results = iter(lab.measure(tasks))
    table = {(factor, clip.name): [next(results) for _ in seeds] for factor in factors for clip in lab.clips}
    names = [clip.name for clip in lab.clips]
    rpe = _normalised({key: [run.rpe_m_per_s for run in runs] for key, runs in table.items()}, factors, names)
    ate = _normalised({key: [run.ate_m for run in runs] for key, runs in table.items()}, factors, names)
    levels = []
    for factor in factors:
        runs: list[Measured] = [run for name in names for run in table[factor, name]]
        frames = max(sum(run.frames for run in runs), 1)
        keyframes, lost = (
            100 * sum(values) / frames for values in zip(*((r.keyframes, r.lost) for r in runs), strict=True)
        )
        threshold = with_threshold(criterion, factor)[1]
        levels.append(
            Level(criterion, factor, threshold, *interval(rpe[factor]), *interval(ate[factor]), keyframes, lost)
        )
    return levels


def _normalised(
    errors: dict[tuple[float, str], list[float | None]], factors: Sequence[float], names: Sequence[str]
) -> dict[float, list[float]]:
    """For each factor, every sequence's mean error over its median over the factors; None (not measured) left out."""
    found: dict[float, list[float]] = {factor: [] for factor in factors}
    for name in names:
        means = {}
        for factor in factors:
            known = [error for error in errors[factor, name] if error is not None]
            if known:
                means[factor] = fmean(known)
        for factor, mean in means.items():
            found[factor].append(mean / median(means.values()))
    return {factor: values or [float("nan")] for factor, values in found.items()}


def findings(levels: Sequence[Level]) -> list[str]:
    """Where the minimum is, and whether the default lies at it."""
    lines = []
    default = next(level for level in levels if level.factor == 1.0)
    for name in ("rpe", "ate"):
        errors = [getattr(level, name) for level in levels]
        best = min(range(len(levels)), key=lambda k: errors[k])
        inside = 0 < best < len(levels) - 1
        at = getattr(default, name) <= FLAT * errors[best]
        apart = getattr(default, name) - errors[best]
        widths = getattr(default, f"{name}_half_width") + getattr(levels[best], f"{name}_half_width")
        lines.append(
            f"{levels[0].criterion}: {name.upper()} is least at {levels[best].threshold:.3g}, "
            f"{'inside' if inside else 'AT THE END OF'} the range; the default {default.threshold:.3g} is "
            f"{'at' if at else 'NOT AT'} it ({getattr(default, name) / errors[best] - 1:+.1%}, "
            f"{'more than' if apart > widths else 'within'} the intervals)"
        )
    return lines


def draw(levels: Sequence[Level]) -> Figure:
    """As the paper draws it, one panel a criterion."""
    groups = [(name, list(group)) for name, group in groupby(levels, key=lambda level: level.criterion)]
    figure = new_figure(columns=len(groups), width=6.0)
    for (criterion, group), axes in zip(groups, figure.axes, strict=True):
        x = [level.threshold for level in group]
        rpe, ate = ([getattr(level, name) for level in group] for name in ("rpe", "ate"))
        axes.errorbar(x, rpe, [v.rpe_half_width for v in group], color=SERIES[0], label="RPE", **ERROR_BAR)
        axes.errorbar(x, ate, [v.ate_half_width for v in group], color=SERIES[1], label="ATE", **ERROR_BAR)
        default = next(level.threshold for level in group if level.factor == 1.0)
        axes.axvline(default, color="#8b95a1", linestyle=":", label="default")
        axes.set_xscale("log")
        ticks_at(axes.xaxis, [float(f"{value:.2g}") for value in x[:: 1 + len(x) // 8]])
        axes.set_yscale("log")
        highest = max(*rpe, *ate)
        ticks_at(axes.yaxis, [value for value in ERRORS if value <= 2 * highest])
        axes.set_ylim(ERRORS[0], 1.3 * max(highest, 1.0))
        unit = "bits" if criterion == "bits" else "as Eq. 20"
        axes.set(xlabel=f"threshold ({unit})", ylabel="normalised error")
        axes.legend(frameon=False)
    return figure
