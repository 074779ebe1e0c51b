"""Fig. 7: what tracking a frame costs against the number of points, with and without choosing them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from . import cost
from .drawing import SERIES, new_figure
from .lab import Lab, Report, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REPEATS, QUICK_REPEATS = 300, 50
Row = tuple[int, float, float, float]  # points, then ms: tracking, selection, both


def run(lab: Lab) -> Report:
    """Time it on a rendered pair, in this process, whatever the recordings are."""
    return report(survey(QUICK_REPEATS if lab.quick else REPEATS))


def survey(repeats: int, points: Sequence[int] = cost.POINTS, shrink: int = 1) -> list[Row]:
    """The rows of the table."""
    scene = cost.pair(shrink)
    cases = [
        case
        for count in points
        for case in (
            cost.tracking_case(scene, count),
            cost.selection_case(scene, count),
            cost.tracking_case(scene, count, select=True),
        )
    ]
    times = iter(cost.median_ms(cases, repeats))
    return [(count, next(times), next(times), next(times)) for count in points]


def report(rows: Sequence[Row]) -> Report:
    """Table, figure, and how the cost grows."""
    first, last = rows[0], rows[-1]
    slope, offset, fit = linear(rows, 1)
    columns = ("points", "tracking ms", "selection ms", "with selection ms")
    return Report(
        "Fig. 7: cost of tracking, a rendered 640x480 pair, equally many points on every level",
        {"fig7": Table(columns, tuple(rows))},
        (
            f"tracking {last[0]} points costs {last[1] / first[1]:.1f} times as much as {first[0]}, "
            f"with selection {last[3] / first[3]:.1f} times",
            f"tracking grows linearly: {1000 * offset:.0f} us + {1000 * slope:.2f} us a point, R^2 {fit:.3f}",
            f"selecting {first[0]} points costs {first[2] / first[1]:.0%} of tracking them",
        ),
        lambda: draw(rows),
    )


def linear(rows: Sequence[Row], column: int) -> tuple[float, float, float]:
    """Slope, offset and R^2 of a column of milliseconds over the points."""
    x, y = np.array([row[0] for row in rows], float), np.array([row[column] for row in rows])
    slope, offset = np.polyfit(x, y, 1)
    left = ((y - slope * x - offset) ** 2).sum() / max(((y - y.mean()) ** 2).sum(), 1e-12)
    return float(slope), float(offset), float(1 - left)


def draw(rows: Sequence[Row]) -> Figure:
    """As the paper draws it."""
    figure = new_figure()
    (axes,) = figure.axes
    points = [row[0] for row in rows]
    for column, label, color in ((3, "with selection", SERIES[0]), (1, "without", SERIES[1])):
        axes.plot(points, [row[column] for row in rows], "o-", color=color, label=label, markersize=4)
    axes.set(xlabel="points", ylabel="time per frame (ms)", ylim=(0, None))
    axes.legend(frameon=False)
    return figure
