"""Fig. 5: error, number of points and entropy reduction, sequence by sequence. The runs are those of Fig. 3."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean
from typing import TYPE_CHECKING

from ..config import Config
from . import fig3
from .drawing import SERIES, new_figure, ticks_at
from .lab import Lab, Report, Table
from .task import prior_entropy_bits

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = 3  # sequences in the figure, as in the paper; the table has all
Row = tuple[str, int, float, float]  # sequence, points, K2FE mm, entropy reduction bits


def run(lab: Lab) -> Report:
    """The mode inf+grid on each sequence."""
    prior = prior_entropy_bits(Config())
    rows: list[Row] = []
    for point in fig3.survey(lab):
        for clip, runs in point.runs if point.mode == "inf+grid" else ():
            errors = [run.k2fe_mean_m for run in runs if run.k2fe_mean_m is not None]
            bits = [run.entropy_bits for run in runs if run.entropy_bits is not None]
            if errors and bits:
                rows.append((clip.name, point.points, 1000 * fmean(errors), prior - fmean(bits)))
    rows.sort(key=lambda row: (row[0], row[1]))
    columns = ("sequence", "points", "mean K2FE mm", "entropy reduction bits")
    names = _spread(rows)
    return Report(
        f"Fig. 5: entropy reduction on single sequences, {lab.source}",
        {"fig5": Table(columns, tuple(rows))},
        (f"with equally many points, K2FE differs by a factor of up to {_factor(rows):.1f} between sequences",),
        lambda: draw([row for row in rows if row[0] in names], names),
    )


def _factor(rows: Sequence[Row]) -> float:
    of_points: dict[int, list[float]] = {}
    for row in rows:
        of_points.setdefault(row[1], []).append(row[2])
    return max(max(errors) / min(errors) for errors in of_points.values())


def _spread(rows: Sequence[Row]) -> list[str]:
    """The sequences with the least, the middle and the largest error."""
    mean = {name: fmean(row[2] for row in rows if row[0] == name) for name in {row[0] for row in rows}}
    ordered = sorted(mean, key=lambda name: mean[name])
    count = min(SHOWN, len(ordered))
    return [ordered[round(k * (len(ordered) - 1) / max(count - 1, 1))] for k in range(count)]


def draw(rows: Sequence[Row], names: Sequence[str]) -> Figure:
    """As the paper draws it."""
    figure = new_figure(columns=3, width=4.4)
    left, middle, right = figure.axes
    for name, color in zip(names, SERIES, strict=False):
        line = [row for row in rows if row[0] == name]
        points, errors, bits = ([row[k] for row in line] for k in (1, 2, 3))
        for axes, x, y in ((left, bits, errors), (middle, bits, points), (right, points, errors)):
            axes.plot(x, y, "o-", color=color, markersize=4, linewidth=1.6, label=name)
    left.set(xlabel="entropy reduction (bits)", ylabel="mean K2FE (mm)")
    middle.set(xlabel="entropy reduction (bits)", ylabel="points")
    right.set(xlabel="points", ylabel="mean K2FE (mm)", xscale="log")
    ticks_at(right.xaxis, sorted({row[1] for row in rows}))
    left.legend(frameon=False, fontsize=8)
    return figure
