"""Ablation: one switch of the method at a time, against the defaults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import fmean, geometric_mean
from typing import TYPE_CHECKING, Any

from ..config import Config
from ..text import configfile
from .drawing import SERIES, new_figure
from .lab import Lab, Report, Table
from .table1 import with_points
from .task import Measured, Task

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DEFAULT = "default"
SWITCHES: dict[str, dict[str, dict[str, Any]]] = {
    "covariance as printed (Eq. 8)": {"noise": {"variance": "paper"}},
    "no pixel noise": {"noise": {"sigma_pixel": 0.0}},
    "pixel noise x 2": {"noise": {"sigma_pixel": 2 * Config().noise.sigma_pixel}},
    "no blur noise": {"noise": {"blur": 0.0}},
    "no distortion weight (Eq. 7)": {"noise": {"c_h": 0.0}},
    "no depth residual": {"noise": {"depth_residual": False}},
    "gradient of the frame alone": {"noise": {"gradient_blend": 0.0}},
    "gradient of the keyframe alone": {"noise": {"gradient_blend": 1.0}},
    "selection: rand": {"selection": {"mode": "rand"}},
    "selection: grid": {"selection": {"mode": "grid"}},
    "selection: inf": {"selection": {"mode": "inf"}},
    "selection once a keyframe": {"selection": {"per_frame": False}},
    "objective as printed (Eq. 18)": {"selection": {"objective": "paper"}},
    "no spread term": {"selection": {"spread": 0.0}},
    "spread term x 4": {"selection": {"spread": 4 * Config().selection.spread}},
    "points may touch": {"selection": {"distance": 0.0}},
    "no margin": {"selection": {"margin": 0.0}},
    "500 candidates": {"selection": {"candidates": 500}},
    "weak motion prior (x 100)": {
        "tracking": {
            "sigma_velocity": 100 * Config().tracking.sigma_velocity,
            "sigma_turn": 100 * Config().tracking.sigma_turn,
        }
    },
    "strong motion prior (/ 3)": {
        "tracking": {
            "sigma_velocity": Config().tracking.sigma_velocity / 3,
            "sigma_turn": Config().tracking.sigma_turn / 3,
        }
    },
    "24 points on coarse levels": {"tracking": {"points_coarse": 24}},
    "coarse levels only start the search": {"noise": {"coarse": 0.0}},
    "patch of 1 pixel": {"tracking": {"patch": 1}},
    "DSO's patches, flat": {"tracking": {"slant": False}},
    "keyframes by Eq. 20 as printed": {"keyframe": {"criterion": "ratio"}},
    "no window": {"window": {"enabled": False}},
    "window of 5 keyframes": {"window": {"keyframes": 5}},
    "24 points in the window": {"window": {"points": 24}},
    "no first-estimate Jacobians": {"window": {"first_estimates": False}},
    "removal: oldest first": {"window": {"removal": "oldest"}},
}
METRICS = (("RPE", "rpe_m_per_s"), ("ATE", "ate_m"), ("K2FE", "k2fe_mean_m"))
CLEAR = 1.02  # a switch that is better by more than this deserves a word
QUICK = (
    *("covariance as printed (Eq. 8)", "no pixel noise", "no depth residual", "selection: rand", "selection: grid"),
    *("selection: inf", "selection once a keyframe", "no spread term", "no window", "removal: oldest first"),
)


def switched(changes: Mapping[str, Mapping[str, Any]]) -> Config:
    """The defaults with some keys changed."""
    return configfile.merge(Config(), changes)


def run(lab: Lab) -> Report:
    """Every switch, relative to the defaults on the same clips with the same seeds."""
    configs = variants(lab)
    clips = [(clip.shifted(seed, lab.seeds), seed) for clip in lab.clips for seed in range(lab.seeds)]
    tasks = [Task(clip, config=config, seed=seed) for config in configs.values() for clip, seed in clips]
    results = iter(lab.measure(tasks))
    runs = {name: [next(results) for _ in clips] for name in configs}
    rows = [_row(name, runs[name], runs[DEFAULT]) for name in configs]
    columns = (
        *("switch", "RPE x", "ATE x", "K2FE x", "RPE better on %", "RPE mm/s", "ATE mm", "K2FE mm"),
        *("lost %", "ms median", "ms mean"),
    )
    better = [f"{row[0]} ({row[1]:.2f} x RPE, {row[9] / rows[0][9]:.1f} x time)" for row in rows if _is_better(row)]
    return Report(
        f"Ablation: one switch at a time, {lab.source}, {Config().selection.points} points",
        {"ablation": Table(columns, tuple(rows))},
        (f"more accurate than the defaults by over 2 %: {'; '.join(better) or 'none'}",),
        lambda: draw(rows),
    )


def variants(lab: Lab) -> dict[str, Config]:
    """The configurations by name, the default first."""
    names = QUICK if lab.quick else tuple(SWITCHES)
    configs = {DEFAULT: Config(), **{name: switched(SWITCHES[name]) for name in names}}
    if not lab.quick:
        configs["256 points"] = with_points(Config(), 256)
    if lab.paper is not None:
        configs["all as printed"] = lab.paper
    return configs


def _row(name: str, runs: Sequence[Measured], default: Sequence[Measured]) -> tuple[Any, ...]:
    """Geometric means of the ratios to the default, then plain means."""
    ratios, means = [], []
    for _, field in METRICS:
        pairs = [(getattr(a, field), getattr(b, field)) for a, b in zip(runs, default, strict=True)]
        known = [(a, b) for a, b in pairs if a and b]
        ratios.append(geometric_mean(a / b for a, b in known) if known else None)
        means.append(1000 * fmean(a for a, _ in known) if known else None)
    wins = [
        a.rpe_m_per_s < b.rpe_m_per_s for a, b in zip(runs, default, strict=True) if a.rpe_m_per_s and b.rpe_m_per_s
    ]
    lost = 100 * sum(run.lost for run in runs) / max(sum(run.frames for run in runs), 1)
    times = [
        fmean(t) if (t := [getattr(r, f) for r in runs if getattr(r, f)]) else None for f in ("ms_median", "ms_mean")
    ]
    return (name, *ratios, 100 * fmean(wins) if wins else None, *means, lost, *times)


def _is_better(row: tuple[Any, ...]) -> bool:
    return row[1] is not None and row[1] * CLEAR < 1.0


def draw(rows: Sequence[tuple[Any, ...]]) -> Figure:
    """Bars: RPE and K2FE relative to the defaults."""
    figure = new_figure(width=8.0, height=0.6 + 0.32 * len(rows))
    (axes,) = figure.axes
    names = [row[0] for row in rows][::-1]
    for offset, (title, column), color in ((0.18, ("RPE", 1), SERIES[0]), (-0.18, ("K2FE", 3), SERIES[1])):
        values = [row[column] or 0.0 for row in rows][::-1]
        axes.barh([k + offset for k in range(len(names))], values, 0.34, color=color, label=title)
    axes.axvline(1.0, color="#1d2733", linewidth=1)
    axes.set_yticks(range(len(names)), names)
    largest = max((row[k] or 0.0 for row in rows for k in (1, 3)), default=1.0)
    axes.set(xlabel="error relative to the defaults", xlim=(0.0, min(max(largest, 1.2), 4.0)))
    axes.legend(frameon=False)
    return figure
