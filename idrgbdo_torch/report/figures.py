"""The figures, from trajectories and series of numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import plotly.graph_objects as go
import torch
from plotly.subplots import make_subplots
from torch import Tensor

from ..definitions.se3 import transform
from ..evaluation import ASSOCIATION_LIMIT_S, absolute_error, relative_error
from ..trajectory import Trajectory, associate

REFERENCE = "#1d2733"
INK, GRID = "#1d2733", "#e6eaee"
DECADES = [m * 10.0**e for e in range(-3, 5) for m in (1, 2, 3, 5, 7)]
MOST_POINTS = 600  # of a line
FREEDOMS = ("v_x", "v_y", "v_z", "w_x", "w_y", "w_z")
FREEDOM_COLORS = ("#c2410c", "#ea8a3c", "#f2c069", "#1d4e89", "#3f88c5", "#8ecae6")


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
    R = _upright(drawn[0].trajectory)
    figure = go.Figure()
    for line in drawn:
        x, y, z = _thinned(transform(_rigid(R), line.trajectory.positions)).T.tolist()
        style = {"color": line.color, "width": 2 * line.width}
        figure.add_scatter3d(
            x=x, y=y, z=z, mode="lines", name=line.name, line=style, visible=_visible(line),
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
    return _styled(figure, "in space", 520).update_layout(margin={"l": 0, "r": 0, "b": 0})


def trajectories_from_above(lines: Sequence[Line], reference: Trajectory | None) -> go.Figure:
    """Camera paths seen along the cameras' mean up axis."""
    drawn = _with_reference(lines, reference)
    R = _upright(drawn[0].trajectory)
    figure = go.Figure()
    for line in drawn:
        x, y, _ = _thinned(transform(_rigid(R), line.trajectory.positions)).T.tolist()
        figure.add_scatter(
            x=x, y=y, mode="lines", name=line.name, line={"color": line.color, "width": line.width},
            visible=_visible(line), hovertemplate="%{x:.3f} %{y:.3f} m",
        )  # fmt: skip
    low, high = _box(drawn[0].trajectory, R)
    figure.update_xaxes(title="m", range=[low[0], high[0]])
    figure.update_yaxes(title="m", range=[low[1], high[1]], scaleanchor="x")
    return _styled(figure, "from above", 520)


def errors_over_time(lines: Sequence[Line], reference: Trajectory) -> go.Figure:
    """Position error after alignment, and drift over one second, of each frame."""
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.08)
    for line in lines:
        ate = absolute_error(line.trajectory, reference)
        rpe = relative_error(line.trajectory, reference)
        series = [(1, ate.timestamps, ate.errors_m)]
        series += [] if rpe is None else [(2, rpe.timestamps, rpe.errors_m)]
        for row, times, errors in series:
            both = _thinned(torch.stack([times - reference.timestamps[0], 1000 * errors], dim=1))
            x, y = both.T.tolist()
            figure.add_scatter(
                x=x, y=y, mode="lines", name=line.name, legendgroup=line.name, showlegend=row == 1, row=row, col=1,
                line={"color": line.color, "width": line.width}, visible=_visible(line),
                hovertemplate="%{y:.2f} at %{x:.2f} s",
            )  # fmt: skip
    figure.update_yaxes(title="position, mm", rangemode="tozero", row=1, col=1)
    figure.update_yaxes(title="drift over 1 s, mm", rangemode="tozero", row=2, col=1)
    figure.update_xaxes(title="s", row=2, col=1)
    return _styled(figure, "error over time", 520)


def entropy_over_time(times: Sequence[float], bits: Sequence[Sequence[float]], keyframes: Sequence[float]) -> go.Figure:
    """Entropy of each degree of freedom (bits, T x 6), keyframes as vertical lines."""
    figure = go.Figure()
    for name, color, values in zip(FREEDOMS, FREEDOM_COLORS, zip(*bits, strict=True), strict=True):
        figure.add_scatter(
            x=list(times), y=list(values), mode="lines", name=name, line={"color": color, "width": 1.6},
            hovertemplate="%{y:.2f} bits at %{x:.2f} s",
        )  # fmt: skip
    line = {"type": "line", "yref": "paper", "y0": 0, "y1": 1, "line": {"color": "#9aa5b1", "width": 1, "dash": "dot"}}
    # all at once: add_vline() copies those that are there
    figure.update_layout(shapes=[{**line, "x0": time, "x1": time} for time in keyframes])
    figure.update_xaxes(title="s")
    figure.update_yaxes(title="bits")
    return _styled(figure, "entropy per degree of freedom; dotted: keyframes", 400)


def milliseconds_over_time(times: Sequence[float], stages: Mapping[str, Sequence[float | None]]) -> go.Figure:
    """Time of each frame, a stage a colour, on a logarithmic scale."""
    figure = go.Figure()
    colors = ("#9aa5b1", "#3f88c5", "#c2410c", "#2a9d8f")
    for (name, values), color in zip(stages.items(), colors, strict=False):
        known = [(time, value) for time, value in zip(times, values, strict=True) if value is not None]
        if known:
            x, y = zip(*known, strict=True)
            median = sorted(y)[len(y) // 2]
            figure.add_scatter(
                x=x, y=y, mode="markers", name=f"{name}, median {median:.1f} ms", marker={"color": color, "size": 5},
                hovertemplate="%{y:.2f} ms at %{x:.2f} s",
            )  # fmt: skip
    figure.update_xaxes(title="s")
    figure.update_yaxes(title="ms", type="log", tickvals=DECADES)
    return _styled(figure, "milliseconds a frame", 360)


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
    figure.update_xaxes(title="ms a frame, median", type="log", tickvals=DECADES)
    figure.update_yaxes(title="RPE, mm/s", type="log", tickvals=DECADES)
    return _styled(figure, "accuracy against time: below and to the left is better", 480)


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
    return _styled(figure, "RPE between methods, mm/s", 160 + 26 * len(names))


def _styled(figure: go.Figure, title: str, height: int) -> go.Figure:
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


def _visible(line: Line) -> Any:
    return True if line.shown else "legendonly"


def _thinned(rows: Tensor) -> Tensor:
    """At most MOST_POINTS of (N, ...) rows, the last among them, to a tenth of a millimetre."""
    if len(rows) > MOST_POINTS:
        rows = rows[torch.linspace(0, len(rows) - 1, MOST_POINTS).long()]
    return (1e4 * rows).round() / 1e4


def _upright(trajectory: Trajectory) -> Tensor:
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


def _rigid(R: Tensor) -> Tensor:
    T = torch.eye(4, dtype=R.dtype)
    T[:3, :3] = R
    return T


def _box(trajectory: Trajectory, R: Tensor) -> tuple[list[float], list[float]]:
    """A box around a trajectory with room to either side, so that a method that runs away does not shrink the rest."""
    positions = transform(_rigid(R), trajectory.positions)
    low, high = positions.amin(0), positions.amax(0)
    room = 0.25 * float((high - low).max()) + 0.01
    return (low - room).tolist(), (high + room).tolist()
