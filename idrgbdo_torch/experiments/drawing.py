"""The look of the figures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import IdRgbdoError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MODE_COLORS = {"rand": "#8b95a1", "grid": "#1d4e89", "inf": "#ea8a3c", "inf+grid": "#c2410c"}
SERIES = ("#c2410c", "#1d4e89", "#2a9d8f", "#8e5ea2", "#ea8a3c", "#6b7280")
ERROR_BAR: dict[str, Any] = {"capsize": 2.5, "linewidth": 1.6, "marker": "o", "markersize": 4}
FIGURES = ("png", "svg", "pdf")  # kinds of file
BLUE, MAGENTA = "#1f4fd8", "#d81fb0"  # of the paper's Fig. 1


def new_figure(columns: int = 1, rows: int = 1, width: float = 5.2, height: float = 3.8, **options: Any) -> Figure:
    """A figure with a grid of axes (figure.axes, row by row). Raises IdRgbdoError without matplotlib."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise IdRgbdoError('experiment: needs matplotlib; pip install "idrgbdo-torch[experiments]"') from error
    figure = Figure(figsize=(columns * width, rows * height), layout="constrained")
    figure.subplots(rows, columns, **options)
    for axes in figure.axes:
        axes.grid(True, color="#e6eaee", linewidth=0.8)
        axes.set_axisbelow(True)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    return figure


def ticks_at(axis: Any, values: Any) -> None:
    """Exactly these ticks on an axis, written as they are, on a logarithmic scale too."""
    axis.set_ticks(list(values), labels=[f"{value:g}" for value in values])
    axis.set_ticks([], minor=True)


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as the name's ending says, without the time in it."""
    dates = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    figure.savefig(path, dpi=130, metadata=dates.get(path.suffix))
