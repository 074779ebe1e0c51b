"""The figure of errors over time."""

from __future__ import annotations

from collections.abc import Sequence

import plotly.graph_objects as go
import torch
from plotly.subplots import make_subplots

from ..evaluation import absolute_error, relative_error
from ..trajectory import Trajectory
from .figures import Line, styled, thinned, visible

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


def _over_time(figure: go.Figure, title: str, height: int, span_s: float | None) -> go.Figure:
    """The look of a figure over time: the legend above, so that it takes nothing from the axis."""
    figure = styled(figure, title, height)
    legend = {"orientation": "h", "x": 1, "xanchor": "right", "y": 1.01, "yanchor": "bottom"}
    figure.update_layout(margin={"l": LEFT, "r": RIGHT, "t": 72}, legend=legend)
    figure.update_yaxes(automargin=False)
    if span_s:
        figure.update_xaxes(range=[-0.01 * span_s, 1.01 * span_s])
    return figure
