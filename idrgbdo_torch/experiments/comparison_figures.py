"""Figures of a comparison for papers: drift against time, in metres and in degrees."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..comparison import Comparison
from ..errors import IdRgbdoError
from .drawing import SERIES, new_figure, save_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KINDS = {"rpe_rmse_m_per_s": ("RPE (mm/s)", 1000.0), "rpe_rmse_deg_per_s": ("RPE (deg/s)", 1.0)}
MARKERS = "osD^v<>PX*"


def draw_figures(comparison: Comparison, out: Path) -> list[Path]:
    """Write comparison.svg and comparison.pdf; none where matplotlib is missing or nothing was measured."""
    try:
        figure = draw(comparison)
    except IdRgbdoError:
        return []
    paths = [out / f"comparison.{suffix}" for suffix in ("svg", "pdf")]
    for path in paths:
        save_figure(figure, path)
    return paths


def draw(comparison: Comparison) -> Figure:
    """A point a method, over all sequences where there are several; the null baseline is left out."""
    several = len(comparison.sequences) > 1
    rows = comparison.rows() if several else comparison.rows(comparison.sequences[0])
    figure = new_figure(columns=2, width=4.4, height=3.6)
    for axes, (name, (title, factor)) in zip(figure.axes, KINDS.items(), strict=True):
        for number, row in enumerate(row for row in rows if row.outcomes[0].kind != "null"):
            spread, ms = row.spread(name), row.track_ms
            if spread is not None and spread.mean > 0 and ms:
                color, marker = SERIES[number % len(SERIES)], MARKERS[number // len(SERIES) % len(MARKERS)]
                axes.scatter(ms, factor * spread.mean, s=45, color=color, marker=marker, label=row.method)
        axes.set(xscale="log", yscale="log", xlabel="median time per frame (ms)", ylabel=title)
    if figure.axes[1].has_data():
        figure.axes[1].legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure
