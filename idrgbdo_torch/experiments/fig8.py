"""Fig. 8: what the window costs against points per keyframe and keyframes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from . import cost
from .drawing import SERIES, new_figure
from .lab import Lab, Report, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REPEATS, QUICK_REPEATS = 30, 7
QUICK_KEYFRAMES = (4, 8, 12)
Row = tuple[int, int, float, int]  # points, keyframes, ms, iterations


def run(lab: Lab) -> Report:
    """Time it on rendered keyframes, in this process, whatever the recordings are."""
    if lab.quick:
        return report(survey(QUICK_REPEATS, keyframes=QUICK_KEYFRAMES))
    return report(survey(REPEATS))


def survey(
    repeats: int,
    points: Sequence[int] = cost.POINTS,
    keyframes: Sequence[int] = cost.KEYFRAMES,
    shrink: int = 1,
) -> list[Row]:
    """The rows of the table."""
    scene = cost.window_scene(max(keyframes), shrink)
    sizes = [(count, size) for count in points for size in keyframes]
    cases = [cost.window_case(scene, *size) for size in sizes]
    times = cost.median_ms(cases, repeats)
    return [(*size, ms, int(case())) for size, ms, case in zip(sizes, times, cases, strict=True)]


def report(rows: Sequence[Row]) -> Report:
    """Table, figure, and how the cost grows."""
    points, sizes = sorted({row[0] for row in rows}), sorted({row[1] for row in rows})
    ms = {(row[0], row[1]): row[2] for row in rows}
    size = 8 if 8 in sizes else sizes[-1]
    many, few = points[-1], points[0]
    per_iteration = {(row[0], row[1]): row[2] / max(row[3], 1) for row in rows}
    of_points = _exponent(points, [per_iteration[count, size] for count in points])
    of_keyframes = _exponent(sizes, [per_iteration[many, k] for k in sizes])
    columns = ("points per keyframe", "keyframes", "ms", "iterations")
    return Report(
        "Fig. 8: cost of the window, rendered 640x480 keyframes",
        {"fig8": Table(columns, tuple(rows))},
        (
            f"with {size} keyframes, {many} points each cost {ms[many, size] / ms[few, size]:.1f} times as much as "
            f"{few}: {ms[many, size]:.1f} and {ms[few, size]:.1f} ms",
            f"an iteration grows with points^{of_points:.2f} ({size} keyframes) and with keyframes^{of_keyframes:.2f} "
            f"({many} points)",
        ),
        lambda: draw(rows),
    )


def _exponent(x: Sequence[int], y: Sequence[float]) -> float:
    """Of the power law through the points."""
    if len(x) < 2:
        return math.nan
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def draw(rows: Sequence[Row]) -> Figure:
    """As the paper draws it: a line for each size of the window."""
    figure = new_figure()
    (axes,) = figure.axes
    for size, color in zip(sorted({row[1] for row in rows}), SERIES, strict=False):
        line = [row for row in rows if row[1] == size]
        axes.plot(
            [r[0] for r in line], [r[2] for r in line], "o-", color=color, label=f"{size} keyframes", markersize=4
        )
    axes.set(xlabel="points per keyframe", ylabel="time per optimisation (ms)", ylim=(0, None))
    axes.legend(frameon=False)
    return figure
