"""Error against time over settings, and where the presets lie: what more time buys, and what less costs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean, geometric_mean
from typing import TYPE_CHECKING

from ..config import Config, settings_file
from ..text import configfile
from .drawing import SERIES, new_figure, ticks_at
from .lab import Lab, Report, Table
from .task import Measured, Task

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PRESETS = ("fast", "default", "accurate")
POINTS = (24, 48, 96, 256)  # tracked
REFINED = (24, 144, 256)  # of each keyframe, where no fewer than are tracked
KEYFRAMES = (0.42, 0.6)  # bits: a new keyframe sooner or later
QUICK_POINTS, QUICK_KEYFRAMES = (24, 256), (0.42,)
NEAR = 1.1  # times the least error that any setting reaches in the same time: on the frontier


@dataclass(frozen=True)
class Setting:
    """What a setting costs and reaches, over all clips."""

    name: str
    rpe_mm_s: float  # geometric mean
    ate_mm: float
    ms_median: float  # mean over the clips
    ms_mean: float
    lost_percent: float


def run(lab: Lab) -> Report:
    """Measure the settings and the presets; the frontier is what nothing beats in both error and time."""
    settings = survey(lab)
    best = frontier(settings)
    columns = ("setting", "RPE mm/s", "ATE mm", "median ms", "mean ms", "lost %", "on the frontier")
    rows = tuple(
        (s.name, s.rpe_mm_s, s.ate_mm, s.ms_median, s.ms_mean, s.lost_percent, "yes" if s in best else "")
        for s in sorted(settings, key=lambda s: s.ms_mean)
    )
    return Report(
        f"Error against time, {lab.source}",
        {"frontier": Table(columns, rows)},
        findings(settings),
        lambda: draw(settings),
    )


def variants(quick: bool) -> dict[str, Config]:
    """The presets, then every combination of points tracked, points refined and keyframes."""
    configs = {name: Config() if name == "default" else preset(name) for name in PRESETS}
    for bits in QUICK_KEYFRAMES if quick else KEYFRAMES:
        for points in QUICK_POINTS if quick else POINTS:
            for refined in (number for number in REFINED if number >= points):
                config = replace(Config(), selection=replace(Config().selection, points=points))
                config = replace(config, window=replace(config.window, points=refined))
                config = replace(config, keyframe=replace(config.keyframe, threshold_bits=bits))
                configs[f"{points} tracked, {refined} refined, keyframes at {bits:g} bits"] = config
    return configs


def preset(name: str) -> Config:
    """The configuration that comes along under a name."""
    return configfile.load(settings_file(Path(name)), Config())


def survey(lab: Lab) -> list[Setting]:
    """Every configuration on every clip."""
    configs = variants(lab.quick)
    plan = [(name, Task(clip, config=config)) for name, config in configs.items() for clip in lab.clips]
    runs: dict[str, list[Measured]] = {name: [] for name in configs}
    for (name, _), result in zip(plan, lab.measure([task for _, task in plan]), strict=True):
        runs[name].append(result)
    return [_setting(name, results) for name, results in runs.items()]


def _setting(name: str, runs: Sequence[Measured]) -> Setting:
    return Setting(
        name,
        1000 * geometric_mean(run.rpe_m_per_s or float("inf") for run in runs),
        1000 * geometric_mean(run.ate_m or float("inf") for run in runs),
        fmean(run.ms_median or float("nan") for run in runs),
        fmean(run.ms_mean or float("nan") for run in runs),
        100 * sum(run.lost for run in runs) / max(sum(run.frames for run in runs), 1),
    )


def frontier(settings: Sequence[Setting]) -> list[Setting]:
    """Those that no other beats in both error and mean time, the fastest first."""
    best: list[Setting] = []
    for setting in sorted(settings, key=lambda s: (s.ms_mean, s.rpe_mm_s)):
        if not best or setting.rpe_mm_s < best[-1].rpe_mm_s:
            best.append(setting)
    return best


def excess(setting: Setting, settings: Sequence[Setting]) -> float:
    """Its error over the least that any setting reaches in no more time."""
    return setting.rpe_mm_s / min(s.rpe_mm_s for s in settings if s.ms_mean <= setting.ms_mean)


def findings(settings: Sequence[Setting]) -> tuple[str, ...]:
    """Where the presets lie."""
    lines = []
    for setting in settings:
        if setting.name in PRESETS:
            times = excess(setting, settings)
            where = "on the frontier" if times <= NEAR else "off the frontier"
            lines.append(
                f"{setting.name} is {where}: {setting.rpe_mm_s:.2f} mm/s in {setting.ms_mean:.1f} ms a frame (mean), "
                f"{times:.2f} times the least error in that time"
            )
    return tuple(lines)


def draw(settings: Sequence[Setting]) -> Figure:
    """Error over mean time, both logarithmic; the frontier as steps, the presets by name."""
    figure = new_figure(width=6.4, height=4.4)
    (axes,) = figure.axes
    others = [s for s in settings if s.name not in PRESETS]
    axes.plot([s.ms_mean for s in others], [s.rpe_mm_s for s in others], "o", color="#8b95a1", markersize=4)
    best = [(s.ms_mean, s.rpe_mm_s) for s in frontier(settings)]
    axes.plot(*zip(*best, strict=True), drawstyle="steps-post", color=SERIES[1], linewidth=1.2)
    for setting in settings:
        if setting.name in PRESETS:
            at = (setting.ms_mean, setting.rpe_mm_s)
            axes.plot(*at, "o", color=SERIES[0], markersize=7)
            axes.annotate(setting.name, at, textcoords="offset points", xytext=(7, 5), color=SERIES[0])
    axes.set(xscale="log", yscale="log", xlabel="ms a frame, mean", ylabel="drift (RPE), mm/s")
    _ticks(axes.xaxis, [s.ms_mean for s in settings])
    _ticks(axes.yaxis, [s.rpe_mm_s for s in settings])
    return figure


def _ticks(axis: object, values: Sequence[float]) -> None:
    steps = [base * 10.0**power for power in range(-2, 4) for base in (1, 2, 3, 5)]
    inside = [step for step in steps if min(values) / 1.3 <= step <= 1.3 * max(values)]
    ticks_at(axis, inside)
