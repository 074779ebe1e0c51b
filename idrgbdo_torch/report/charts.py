"""What charts.js draws: named series with a value a frame, nan where there is none."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from ..evaluation import absolute_error, relative_error
from ..trajectory import Trajectory
from .scene import frame_of, pack

STATUSES = ("ok", "weak", "lost")  # numbered in the page
FREEDOMS = ("v_x", "v_y", "v_z", "w_x", "w_y", "w_z")
FREEDOM_COLORS = ("#c2410c", "#ea8a3c", "#e0a526", "#1d4e89", "#3f88c5", "#8ecae6")
ESTIMATE, REFINED, QUIET = "#c2410c", "#3f88c5", "#9aa5b1"

Array = NDArray[np.float64]


def chart_html(number: int) -> str:
    """Where the script draws that chart."""
    return f'<div class="chart" data-chart="{number}"></div>'


def error_charts(
    times: Array, estimate: Trajectory, refined: Trajectory | None, reference: Trajectory
) -> tuple[dict[str, Any], ...]:
    """Position error after alignment and drift over one second, mm, of each frame; times (N,) s of the frames."""
    position, drift = [], []
    for name, trajectory, color in (("as it came", estimate, ESTIMATE), ("refined", refined, REFINED)):
        if trajectory is None:
            continue
        ate, rpe = absolute_error(trajectory, reference), relative_error(trajectory, reference)
        position.append(_series(name, color, _at_frames(times, ate.timestamps, 1000 * ate.errors_m)))
        if rpe is not None:
            drift.append(_series(name, color, _at_frames(times, rpe.timestamps, 1000 * rpe.errors_m)))
    charts = [_chart("position after alignment", "mm", position, zero=True)]
    if drift:
        charts.append(_chart("drift over the second that follows", "mm", drift, zero=True))
    return tuple(charts)


def certainty_chart(bits: Array, keyframes: Sequence[int]) -> dict[str, Any]:
    """Entropy of each degree of freedom, bits (N, 6); keyframes: numbers of their frames."""
    series = [_series(*one) for one in zip(FREEDOMS, FREEDOM_COLORS, bits.T, strict=True)]
    title = "entropy of each degree of freedom; dotted: keyframes"
    return _chart(title, "bits", series, height=300) | {"marks": list(keyframes)}


def time_chart(decode_ms: Array, ms: Array, keyframes: Sequence[int]) -> dict[str, Any]:
    """Milliseconds (N,) of each frame: waiting for its images, and tracking it."""
    made = np.zeros(len(ms), bool)
    made[list(keyframes)] = True
    series = [
        _series("waiting for images", QUIET, decode_ms),
        _series("tracking", REFINED, np.where(made, np.nan, ms)),
        _series("tracking and a new keyframe", ESTIMATE, np.where(made, ms, np.nan)),
    ]
    return _chart("milliseconds a frame", "ms", [one | {"dots": True} for one in series], log=True)


def _chart(
    title: str, unit: str, series: list[dict[str, Any]], zero: bool = False, log: bool = False, height: int = 220
) -> dict[str, Any]:
    return {"title": title, "unit": unit, "series": series, "zero": zero, "log": log, "height": height}


def _series(name: str, color: str, values: Array) -> dict[str, Any]:
    return {"name": name, "color": color, "values": pack(values)}


def _at_frames(times: Array, timestamps: Tensor, values: Tensor) -> Array:
    """(N,) values at the frames that have their times."""
    out = np.full(len(times), np.nan)
    out[frame_of(timestamps.numpy(), times)] = values.numpy()
    return out
