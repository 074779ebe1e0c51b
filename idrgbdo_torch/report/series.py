"""The figures over time: errors, statuses, certainty, milliseconds. Their time axes lie below each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby

import plotly.graph_objects as go
import torch
from plotly.subplots import make_subplots

from ..evaluation import absolute_error, relative_error
from ..trajectory import Trajectory
from .figures import Line, decades, styled, thinned, visible

FREEDOMS = ("v_x", "v_y", "v_z", "w_x", "w_y", "w_z")
FREEDOM_COLORS = ("#c2410c", "#ea8a3c", "#f2c069", "#1d4e89", "#3f88c5", "#8ecae6")
STATUS_COLORS = {"lost": "#b91c1c", "weak": "#d99a06", "ok": "#2a9d8f"}  # from below
LEFT, RIGHT = 72, 24  # px beside every figure, so that one moment stands in one column of the page


def errors_over_time(
    lines: Sequence[Line], reference: Trajectory, begin_s: float, span_s: float | None = None
) -> go.Figure:
    """Position error after alignment, and drift over one second, of each frame; begin_s is called 0."""
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.08)
    for line in lines:
        ate = absolute_error(line.trajectory, reference)
        rpe = relative_error(line.trajectory, reference)
        series = [(1, ate.timestamps, ate.errors_m)]
        series += [] if rpe is None else [(2, rpe.timestamps, rpe.errors_m)]
        for row, times, errors in series:
            both = thinned(torch.stack([times - begin_s, 1000 * errors], dim=1))
            x, y = both.T.tolist()
            figure.add_scatter(
                x=x, y=y, mode="lines", name=line.name, legendgroup=line.name, showlegend=row == 1, row=row, col=1,
                line={"color": line.color, "width": line.width}, visible=visible(line),
                hovertemplate="%{y:.2f} at %{x:.2f} s",
            )  # fmt: skip
    figure.update_yaxes(title="position, mm", rangemode="tozero", row=1, col=1)
    figure.update_yaxes(title="drift over 1 s, mm", rangemode="tozero", row=2, col=1)
    figure.update_xaxes(title="s", row=2, col=1)
    return _over_time(figure, "error over time", 520, span_s)


def statuses_over_time(
    times: Sequence[float], statuses: Sequence[str], reasons: Sequence[str], span_s: float | None = None
) -> go.Figure:
    """Status of each frame ("ok", "weak", "lost"): a bar where it lasts, a mark with the reason where it is not ok."""
    figure = go.Figure()
    runs = []
    for status, group in groupby(range(len(times)), key=lambda k: statuses[k]):
        numbers = list(group)
        runs.append((status, times[numbers[0]], times[min(numbers[-1] + 1, len(times) - 1)]))
    for status, color in STATUS_COLORS.items():
        x = [value for name, begin, end in runs if name == status for value in (begin, end, None)]
        count = sum(name == status for name in statuses)
        share = f"{status}, {count} of {len(statuses)}"
        figure.add_scatter(
            x=x or [None], y=[status] * max(len(x), 1), mode="lines", line={"color": color, "width": 12}, name=share,
            legendgroup=status, hoverinfo="skip", connectgaps=False,
        )  # fmt: skip
        marked = [k for k, name in enumerate(statuses) if name == status and status != "ok"]
        if marked:
            figure.add_scatter(
                x=[times[k] for k in marked], y=[status] * len(marked), mode="markers", legendgroup=status,
                marker={"color": color, "size": 9, "symbol": "line-ns", "line": {"width": 2, "color": color}},
                text=[reasons[k] for k in marked], hovertemplate="%{x:.2f} s: %{text}<extra></extra>",
                showlegend=False,
            )  # fmt: skip
    figure.update_xaxes(title="s")
    figure.update_yaxes(categoryorder="array", categoryarray=list(STATUS_COLORS), range=[-0.6, 2.6], showgrid=False)
    return _over_time(figure, "status of each frame", 220, span_s)


def entropy_over_time(
    times: Sequence[float],
    bits: Sequence[Sequence[float]],
    keyframes: Sequence[float],
    span_s: float | None = None,
) -> go.Figure:
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
    return _over_time(figure, "entropy per degree of freedom; dotted: keyframes", 400, span_s)


def milliseconds_over_time(
    times: Sequence[float], stages: Mapping[str, Sequence[float | None]], span_s: float | None = None
) -> go.Figure:
    """Time of each frame, a stage a colour, on a logarithmic scale."""
    figure = go.Figure()
    values_ms = [value for values in stages.values() for value in values if value is not None]
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
    figure.update_yaxes(title="ms", type="log", tickvals=decades(values_ms))
    return _over_time(figure, "milliseconds a frame", 360, span_s)


def _over_time(figure: go.Figure, title: str, height: int, span_s: float | None) -> go.Figure:
    """The look of a figure over time: the legend above, so that it takes nothing from the axis."""
    figure = styled(figure, title, height)
    legend = {"orientation": "h", "x": 1, "xanchor": "right", "y": 1.01, "yanchor": "bottom"}
    figure.update_layout(margin={"l": LEFT, "r": RIGHT, "t": 72}, legend=legend)
    figure.update_yaxes(automargin=False)
    if span_s:
        figure.update_xaxes(range=[-0.01 * span_s, 1.01 * span_s])
    return figure
