"""The figures, from trajectories and series of numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import plotly.graph_objects as go
import torch
from torch import Tensor

from ..definitions.se3 import transform
from ..evaluation import ASSOCIATION_LIMIT_S, absolute_error
from ..trajectory import Trajectory, associate

REFERENCE = "#1d2733"
INK, GRID = "#1d2733", "#e6eaee"
MOST_TICKS = 9  # that a logarithmic axis has room for
MOST_POINTS = 600  # of a line


@dataclass(frozen=True)
class Line:
    """A named trajectory."""

    name: str
    trajectory: Trajectory
    color: str
    width: float = 2.0
    shown: bool = True  # else only after a click on the legend


def aligned(lines: Sequence[Line], reference: Trajectory | None) -> list[Line]:
    """The lines in the reference's world, by rigid alignment; as they are without one (all begin at the identity)."""
    if reference is None:
        return list(lines)
    moved = []
    for line in lines:
        of_line, _ = associate(line.trajectory.timestamps, reference.timestamps, ASSOCIATION_LIMIT_S)
        if len(of_line) < 3:
            continue
        T_reference_line = absolute_error(line.trajectory, reference).T_reference_estimate
        world = Trajectory(line.trajectory.timestamps, T_reference_line @ line.trajectory.T_world_cam)
        moved.append(Line(line.name, world, line.color, line.width, line.shown))
    return moved


def trajectories_3d(lines: Sequence[Line], reference: Trajectory | None) -> go.Figure:
    """Camera paths in space, up being the cameras' mean up."""
    drawn = _with_reference(lines, reference)
    R = upright(drawn[0].trajectory)
    figure = go.Figure()
    for line in drawn:
        x, y, z = thinned(transform(rigid(R), line.trajectory.positions)).T.tolist()
        style = {"color": line.color, "width": 2 * line.width}
        figure.add_scatter3d(
            x=x, y=y, z=z, mode="lines", name=line.name, line=style, visible=visible(line),
            hovertemplate="%{x:.3f} %{y:.3f} %{z:.3f} m",
        )  # fmt: skip
    low, high = _box(drawn[0].trajectory, R)
    look = {"backgroundcolor": "white", "gridcolor": GRID, "linecolor": "#c3cad2"}
    axes = {
        f"{axis}axis": {"title": f"{axis} (m)", "range": [a, b], **look}
        for axis, a, b in zip("xyz", low, high, strict=True)
    }
    eye = {"x": 1.2, "y": -1.9, "z": 1.2}
    figure.update_layout(scene={"aspectmode": "data", "camera": {"eye": eye}, **axes}, showlegend=False)
    return styled(figure, "in space", 520).update_layout(margin={"l": 0, "r": 0, "b": 0})


def trajectories_from_above(lines: Sequence[Line], reference: Trajectory | None) -> go.Figure:
    """Camera paths seen along the cameras' mean up axis."""
    drawn = _with_reference(lines, reference)
    R = upright(drawn[0].trajectory)
    figure = go.Figure()
    for line in drawn:
        x, y, _ = thinned(transform(rigid(R), line.trajectory.positions)).T.tolist()
        figure.add_scatter(
            x=x, y=y, mode="lines", name=line.name, line={"color": line.color, "width": line.width},
            visible=visible(line), hovertemplate="%{x:.3f} %{y:.3f} m",
        )  # fmt: skip
    low, high = _box(drawn[0].trajectory, R)
    figure.update_xaxes(title="m", range=[low[0], high[0]])
    figure.update_yaxes(title="m", range=[low[1], high[1]], scaleanchor="x")
    return styled(figure, "from above", 520)


def accuracy_against_time(points: Sequence[tuple[str, float, float, str]]) -> go.Figure:
    """Methods by median milliseconds and drift: (name, ms, mm/s, colour). Below and to the left is better."""
    figure = go.Figure()
    for number, (name, ms, drift, color) in enumerate(sorted(points, key=lambda point: point[2])):
        place = ("top center", "bottom center")[number % 2]  # neighbours do not write over each other
        figure.add_scatter(
            x=[ms], y=[drift], mode="markers+text", text=[name], textposition=place, name=name,
            marker={"color": color, "size": 12, "line": {"color": "white", "width": 1}}, showlegend=False,
            textfont={"size": 11}, hovertemplate=f"{name}: %{{y:.2f}} mm/s in %{{x:.1f}} ms<extra></extra>",
        )  # fmt: skip
    figure.update_xaxes(title="ms a frame, median", type="log", tickvals=decades([ms for _, ms, _, _ in points]))
    figure.update_yaxes(title="RPE, mm/s", type="log", tickvals=decades([drift for _, _, drift, _ in points]))
    return styled(figure, "accuracy against time: below and to the left is better", 480)


def agreement_map(names: Sequence[str], values: Sequence[Sequence[float | None]]) -> go.Figure:
    """RPE between every pair of methods, mm/s, on a logarithmic colour scale."""
    scaled = [[None if value is None else 1000 * value for value in row] for row in values]
    shades = [[None if value is None else max(value, 0.1) for value in row] for row in scaled]
    logs = [[None if value is None else float(torch.log10(torch.tensor(value))) for value in row] for row in shades]
    text = [["" if value is None else f"{value:.1f}" for value in row] for row in scaled]
    figure = go.Figure(
        go.Heatmap(
            z=logs,
            x=list(names),
            y=list(names),
            text=text,
            texttemplate="%{text}",
            textfont={"size": 10},
            colorscale="Blues",
            reversescale=True,
            showscale=False,
            hovertemplate="%{y} and %{x}: %{text} mm/s<extra></extra>",
        )
    )
    figure.update_yaxes(autorange="reversed")
    figure.update_xaxes(tickangle=40)
    return styled(figure, "RPE between methods, mm/s", 160 + 26 * len(names))


def decades(values: Sequence[float]) -> list[float]:
    """Ticks of a logarithmic axis over the values: as many to a decade as do not run into each other."""
    known = [value for value in values if value > 0] or [1.0]
    low, high = math.floor(math.log10(min(known))), math.ceil(math.log10(max(known)) + 1e-9)
    for steps in ((1, 2, 3, 5, 7), (1, 2, 5), (1, 3), (1,)):
        ticks = [m * 10.0**e for e in range(low, high + 1) for m in steps]
        if sum(min(known) / 2 <= tick <= 2 * max(known) for tick in ticks) <= MOST_TICKS:
            break
    return ticks


def styled(figure: go.Figure, title: str, height: int) -> go.Figure:
    """The figure in the look of all of them."""
    axis: dict[str, Any] = {"gridcolor": GRID, "zeroline": False, "linecolor": "#c3cad2", "ticks": "outside"}
    axis["tickcolor"] = "#c3cad2"
    figure.update_layout(
        title={"text": title, "font": {"size": 15}, "x": 0.01, "xanchor": "left"},
        height=height,
        margin={"l": 64, "r": 16, "t": 48, "b": 48},
        font={"family": "system-ui, sans-serif", "color": INK, "size": 12},
        paper_bgcolor="white",
        plot_bgcolor="white",
        legend={"font": {"size": 11}, "itemsizing": "constant"},
        hoverlabel={"namelength": -1},
    )
    figure.update_xaxes(axis)
    figure.update_yaxes(axis)
    return figure


def _with_reference(lines: Sequence[Line], reference: Trajectory | None) -> list[Line]:
    """The lines, the reference before them, cut to the time of the lines."""
    if reference is None:
        return list(lines)
    first = min(float(line.trajectory.timestamps[0]) for line in lines)
    last = max(float(line.trajectory.timestamps[-1]) for line in lines)
    within = (reference.timestamps >= first - 0.1) & (reference.timestamps <= last + 0.1)
    return [Line("reference", reference.at(within), REFERENCE, 3.0), *lines]


def visible(line: Line) -> Any:
    """What plotly calls its visibility."""
    return True if line.shown else "legendonly"


def thinned(rows: Tensor) -> Tensor:
    """At most MOST_POINTS of (N, ...) rows, the last among them, to a tenth of a millimetre."""
    if len(rows) > MOST_POINTS:
        rows = rows[torch.linspace(0, len(rows) - 1, MOST_POINTS).long()]
    return (1e4 * rows).round() / 1e4


def upright(trajectory: Trajectory) -> Tensor:
    """(3, 3) rotation of the world that brings the cameras' mean up axis to z and their mean view into the page."""
    R_world_cam = trajectory.T_world_cam[:, :3, :3]
    up = -R_world_cam[:, :, 1].mean(0)
    up = up / up.norm()
    view = R_world_cam[:, :, 2].mean(0)
    forward = view - (view @ up) * up
    if float(forward.norm()) < 1e-3:  # they look straight down
        forward = torch.linalg.cross(up, R_world_cam[0, :, 0])
    forward = forward / forward.norm()
    return torch.stack([torch.linalg.cross(forward, up), forward, up])


def rigid(R: Tensor) -> Tensor:
    """(4, 4) transform of a rotation (3, 3) alone."""
    T = torch.eye(4, dtype=R.dtype)
    T[:3, :3] = R
    return T


def _box(trajectory: Trajectory, R: Tensor) -> tuple[list[float], list[float]]:
    """A box around a trajectory with room to either side, so that a method that runs away does not shrink the rest."""
    positions = transform(rigid(R), trajectory.positions)
    low, high = positions.amin(0), positions.amax(0)
    room = 0.25 * float((high - low).max()) + 0.01
    return (low - room).tolist(), (high + room).tolist()
