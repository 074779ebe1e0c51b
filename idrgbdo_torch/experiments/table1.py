"""Table 1: every method on every sequence, the paper's own numbers beside those of the same name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from statistics import geometric_mean
from typing import TYPE_CHECKING

from ..comparison.shipped import shipped_methods
from ..config import Config
from .drawing import SERIES, new_figure
from .lab import Cell, Lab, Report, Table
from .paper import PUBLISHED, SEQUENCES, TABLE_1, PaperRow
from .task import Measured, Task

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..comparison.methods import Method

FEW, MANY = 24, 256
RIVALS = ("open3d", "opencv", "features", "edges")
SLOW = ("open3d-legacy-color", "open3d-legacy-hybrid")  # left out when it is to be quick
NEAR, FAST = 1.5, 1 / 20  # how close to the dense row in error, and at which share of its time
Results = Mapping[tuple[str, str], Measured]  # by row (method) and sequence
KINDS = {  # tables by the stems of their files: unit, field of a result, factor
    "table1_rpe": ("RPE mm/s", "rpe_m_per_s", 1000.0),
    "table1_rpe_deg": ("RPE deg/s", "rpe_deg_per_s", 1.0),
    "table1_ate": ("ATE mm", "ate_m", 1000.0),
    "table1_lost": ("lost frames", "lost", 1.0),
    "table1_ms": ("median ms a frame", "ms_median", 1.0),
    "table1_total": ("s in all", "total_s", 1.0),
}
SOURCES = tuple(f"{column.label}: {column.source}" for column in PUBLISHED)


def run(lab: Lab) -> Report:
    """Run all methods; errors, losses and times as one table each."""
    results = survey(lab)
    methods = list(dict.fromkeys(method for method, _ in results))
    names = [clip.name for clip in lab.clips]
    tables = {"table1_published": published(results, methods, names)} if lab.alone else {}
    for stem, (unit, field, factor) in KINDS.items():
        beside = _paper_columns("rpe" if stem == "table1_rpe" else "ate") if factor > 1 else {}
        columns = (f"sequence, {unit}", *methods, *beside)
        rows = tuple(
            (name, *(_scaled(getattr(results[method, name], field), factor) for method in methods),
             *(_scaled(getattr(TABLE_1[name], column), 1000.0) if name in TABLE_1 else None
               for column in beside.values()))
            for name in names
        )  # fmt: skip
        tables[stem] = Table(columns, rows)
    return Report(
        f"Table 1, {lab.source}; the paper's numbers are of the TUM recordings",
        tables,
        (*findings(results, methods, names), *(SOURCES if lab.alone else ())),
        lambda: draw(results, methods, names),
    )


def survey(lab: Lab) -> dict[tuple[str, str], Measured]:
    """Every method on every clip."""
    rows: dict[str, tuple[str, Config | None]] = {
        f"ours-{count}": ("ours", with_points(Config(), count)) for count in (FEW, MANY)
    }
    if lab.paper is not None:
        rows |= {f"paper-{count}": ("ours", with_points(lab.paper, count)) for count in (FEW, MANY)}
    if not lab.alone:
        rows |= {name: (name, None) for name in others(shipped_methods(), lab.quick)}
    plan = {
        (row, clip.name): Task(clip, method, config) for clip in lab.clips for row, (method, config) in rows.items()
    }
    return dict(zip(plan, lab.measure(list(plan.values())), strict=True))


def published(results: Results, methods: Sequence[str], names: Sequence[str]) -> Table:
    """Ours beside what others report for the same recordings, RPE in mm/s; empty where nobody has measured."""
    columns = ("sequence, RPE mm/s", *methods, *(f"{column.label} (published)" for column in PUBLISHED))
    rows = []
    for name in [*SEQUENCES, *(name for name in names if name not in SEQUENCES)]:
        ours = [_scaled(results[method, name].rpe_m_per_s, 1000.0) if name in names else None for method in methods]
        theirs = [_scaled(column.rpe_m_per_s.get(name), 1000.0) for column in PUBLISHED]
        rows.append((name, *ours, *theirs))
    return Table(columns, tuple(rows))


def others(methods: Mapping[str, Method], quick: bool) -> list[str]:
    """The names of the methods that are not ours."""
    return [name for name, method in methods.items() if method.kind != "ours" and not (quick and name in SLOW)]


def with_points(config: Config, points: int) -> Config:
    """A configuration that tracks so many points; the window has no fewer, nor have coarse levels that had as many."""
    coarse = config.tracking.points_coarse
    if coarse == config.selection.points:
        config = replace(config, tracking=replace(config.tracking, points_coarse=points))
    selection = replace(config.selection, points=points)
    window = replace(config.window, points=config.window.points and max(config.window.points, points))
    return replace(config, selection=selection, window=window)


def findings(results: Results, methods: Sequence[str], names: Sequence[str]) -> list[str]:
    """Who is ahead where, decided by RPE; a method that broke or was not measured is behind."""
    far = float("inf")

    def rpe(method: str, name: str) -> float:
        found = results[method, name].rpe_m_per_s
        return far if found is None or results[method, name].error else found

    lines = []
    if rivals := [method for method in methods if method.startswith(RIVALS)]:
        ahead = [name for name in names if all(rpe(f"ours-{FEW}", name) < rpe(method, name) for method in rivals)]
        lines.append(f"ours-{FEW} is ahead of every Open3D, OpenCV, feature and edge row on {_of(ahead, names)}")
    if "dense" in methods:
        near = [name for name in names if rpe(f"ours-{MANY}", name) <= NEAR * rpe("dense", name)]
        shares = [
            (results[f"ours-{MANY}", name].ms_median or far) / (results["dense", name].ms_median or far)
            for name in names
        ]
        quick = sum(share <= FAST for share in shares)
        lines.append(
            f"ours-{MANY} is within {NEAR:g} times dense on {_of(near, names)}, at {geometric_mean(shares):.3f} of its "
            f"time ({quick} of {len(names)} at no more than {FAST:g})"
        )
    for method in methods:
        losses = {name: results[method, name] for name in names if results[method, name].lost}
        if method.startswith(("ours", "paper")):
            detail = ", ".join(f"{name} {run.lost} of {run.frames}" for name, run in losses.items())
            lines.append(f"{method} lost frames on {len(losses)} of {len(names)}" + (f": {detail}" if detail else ""))
        broken = [name for name in names if results[method, name].error]
        if broken:
            lines.append(f"{method} broke on {', '.join(broken)}: {results[method, broken[0]].error}")
    return lines


def _of(found: Sequence[str], names: Sequence[str]) -> str:
    missing = [name for name in names if name not in found]
    return f"{len(found)} of {len(names)} sequences" + (f" (not on {', '.join(missing)})" if missing else "")


def _paper_columns(kind: str) -> dict[str, str]:
    """Titles and fields of the paper's columns."""
    titles = {"dvo": "DVO", "orb": "ORB-SLAM2", "canny": "Canny-VO", "ours": "ID-RGBDO"}
    found = [item.name for item in fields(PaperRow) if item.name.endswith(kind)]
    return {f"paper: {titles[name.partition('_')[0]]}": name for name in found}


def _scaled(value: float | int | None, factor: float) -> Cell:
    return value if value is None or factor == 1.0 else value * factor


def draw(results: Results, methods: Sequence[str], names: Sequence[str]) -> Figure:
    """Not in the paper: drift of each method on each sequence, against its time."""
    figure = new_figure(width=7.0, height=4.6)
    (axes,) = figure.axes
    shown = [method for method in methods if method != "constant-velocity"]
    for number, method in enumerate(shown):
        runs = [results[method, name] for name in names]
        known = [(r.ms_median, 1000 * r.rpe_m_per_s) for r in runs if r.ms_median and r.rpe_m_per_s]
        if known:
            ms, rpe = zip(*known, strict=True)
            color, marker = SERIES[number % len(SERIES)], "oosd^v<>PX*ph"[number // len(SERIES) * 4 % 13]
            axes.scatter(ms, rpe, s=8, color=color, alpha=0.35, linewidths=0)
            axes.scatter(
                geometric_mean(ms), geometric_mean(rpe), s=60, color=color, marker=marker, label=method,
                edgecolors="white",
            )  # fmt: skip
    axes.set(xscale="log", yscale="log", xlabel="median time per frame (ms)", ylabel="RPE (mm/s)")
    axes.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure
