"""Fig. 4: accuracy against entropy. The runs are those of Fig. 3."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean
from typing import TYPE_CHECKING

from ..config import Config
from . import fig3
from .drawing import MODE_COLORS, new_figure, ticks_at
from .fig3 import MODES, Point
from .lab import Lab, Report, Table
from .task import prior_entropy_bits

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Row = tuple[str, int, float, float, float]  # mode, points, K2FE m, entropy bits, entropy reduction bits


def run(lab: Lab) -> Report:
    """Entropy of the pose of a frame, and how far tracking reduced it below what the motion prior says."""
    rows = entropies(fig3.survey(lab))
    columns = ("mode", "points", "accumulated K2FE m", "entropy bits", "entropy reduction bits")
    return Report(
        f"Fig. 4: accuracy against entropy, {lab.source}",
        {"fig4": Table(columns, tuple(rows))},
        (f"over all modes and numbers of points, the rank correlation of entropy and K2FE is {_rank(rows):.2f}",),
        lambda: draw(rows),
    )


def entropies(points: Sequence[Point]) -> list[Row]:
    """Mean entropy of each point of Fig. 3."""
    prior = prior_entropy_bits(Config())
    rows: list[Row] = []
    for point in points:
        bits = fmean(run.entropy_bits for _, runs in point.runs for run in runs if run.entropy_bits is not None)
        rows.append((point.mode, point.points, point.k2fe_m, bits, prior - bits))
    return rows


def _rank(rows: Sequence[Row]) -> float:
    from scipy.stats import spearmanr

    return float(spearmanr([row[3] for row in rows], [row[2] for row in rows]).statistic)


def draw(rows: Sequence[Row]) -> Figure:
    """Left against points, from black to blue with the entropy reduction; right against absolute entropy."""
    from matplotlib.colors import LinearSegmentedColormap, Normalize

    figure = new_figure(columns=2)
    left, right = figure.axes
    shades = LinearSegmentedColormap.from_list("reduction", ["black", "#2f6bff"])
    scale = Normalize(min(row[4] for row in rows), max(row[4] for row in rows))
    for mode, style in zip(MODES, (":", "--", "-.", "-"), strict=True):
        line = [row for row in rows if row[0] == mode]
        points, errors = [row[1] for row in line], [row[2] for row in line]
        left.plot(points, errors, style, color="#b8c0c8", linewidth=1.2, label=mode, zorder=1)
        dots = left.scatter(points, errors, c=[row[4] for row in line], cmap=shades, norm=scale, s=28, zorder=2)
        right.plot([row[3] for row in line], errors, "o-", color=MODE_COLORS[mode], markersize=4, label=mode)
    figure.colorbar(dots, ax=left, label="entropy reduction (bits)")
    left.set_xscale("log")
    ticks_at(left.xaxis, sorted({row[1] for row in rows}))
    left.set_xlabel("points")
    right.set_xlabel("entropy (bits)")
    for axes in (left, right):
        axes.set_ylabel("accumulated K2FE (m)")
        axes.set_ylim(bottom=0)
        axes.legend(frameon=False)
    return figure
