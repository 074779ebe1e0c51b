"""report.html of one run, from what its folder holds."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from ..definitions.camera import Pinhole
from ..errors import IdRgbdoError
from ..evaluation import absolute_error, hints
from ..text.files import read_json, read_table, read_text
from ..trajectory import Trajectory, read_tum
from .charts import STATUSES, certainty_chart, chart_html, error_charts, time_chart
from .glimpses import Glimpse
from .page import Section, page, preformatted, tiles
from .scene import pack, scene

SCRIPTS = ("scene.js", "charts.js", "player.js")
LAYERS = {  # what can be switched off in the scene, with its colour there
    "map": ("map", "#9aa5b1"),
    "estimate": ("path as it came", "#ff8a3d"),
    "refined": ("refined path", "#4da3ff"),
    "reference": ("reference", "#c3cad2"),
    "keyframes": ("keyframes; yellow: in the window", "#ffc53d"),
    "points": ("points by bits", "#2a9d8f"),
}


def run_page(
    folder: Path,
    title: str,
    groundtruth: Trajectory | None = None,
    glimpses: Sequence[Glimpse] = (),
    camera: Pinhole | None = None,
) -> str:
    """The page of a run folder (trajectory.txt, frames.csv, summary.json, config.toml, maps), as HTML text.

    glimpses: what watch() kept of single frames. camera: of their images.
    """
    rows = read_table(folder / "frames.csv", ("timestamp", "status", "reason", "keyframe", "decode_ms", "ms"))
    summary = read_json(folder / "summary.json")
    estimate = read_tum(folder / "trajectory.txt")
    path = folder / "trajectory_refined.txt"
    refined = read_tum(path) if path.exists() else None
    apart = "" if groundtruth is None else _why_apart(estimate, groundtruth)
    reference = None if apart else groundtruth
    times = np.array([float(row["timestamp"]) for row in rows])
    keyframes = [number for number, row in enumerate(rows) if row["keyframe"] == "1"]
    drawn = scene(folder, estimate, refined, reference, times, keyframes, glimpses, camera)
    charts: list[dict[str, Any]] = []

    def chart(*specs: dict[str, Any]) -> str:
        charts.extend(specs)
        return "".join(chart_html(len(charts) - len(specs) + k) for k in range(len(specs)))

    laid = "" if reference is None else "The reference is laid onto the run by rigid alignment without scale. "
    note = f"The ground truth is not shown. {apart}" if apart else laid
    how = "Drag to turn, with two fingers or the right button to move, wheel or pinch to zoom."
    sections = [Section("Map", _scene_html(drawn, summary, glimpses), note + how)]
    if reference is not None:
        known = _sentences(*hints(estimate, reference))
        sections.append(Section("Error", _card(chart(*error_charts(times, estimate, refined, reference))), known))
    if any(_entropies(row) for row in rows):
        bits = np.array([_entropies(row) or [np.nan] * 6 for row in rows])
        note = "Of the pose against its keyframe, in bits: one more is a standard deviation twice as large."
        sections.append(Section("Certainty", _card(chart(certainty_chart(bits, keyframes))), note))
    ms = np.array([_number(row["ms"]) for row in rows])
    decode_ms = np.array([_number(row["decode_ms"]) for row in rows])
    sections.append(Section("Time", _card(chart(time_chart(decode_ms, ms, keyframes)))))
    trouble = "\n".join(
        f"{time - times[0]:8.2f} s  {row['status']:5s} {row['reason']}"
        for time, row in zip(times, rows, strict=True)
        if row["status"] != "ok"
    )
    if trouble:
        sections.append(Section("Doubts", preformatted(trouble, f"{trouble.count(chr(10)) + 1} frames weak or lost")))
    config = read_text(folder / "config.toml")
    sections.append(Section("Configuration", preformatted(config, "config.toml")))
    data = {
        "times": pack(times - times[0] if len(times) else times),
        "status": pack(np.array([STATUSES.index(row["status"]) for row in rows], np.uint8)),
        "reasons": {number: row["reason"] for number, row in enumerate(rows) if row["reason"]},
        "keyframes": pack(np.array(keyframes, np.uint32)),
        "ms": pack(ms),
        "scene": drawn,
        "charts": charts,
    }
    subtitle = f"{summary['frames']} frames, {summary['path_length_m']:.2f} m"
    style = _web("run.css")
    footer = f"Made from {folder.name}."
    return page(title, subtitle, tiles(_key_figures(summary)), sections, footer, False, style, _scripts(data))


def _scene_html(drawn: dict[str, Any], summary: dict[str, Any], glimpses: Sequence[Glimpse]) -> str:
    """Where the scripts draw: the scene, the image, and below both the slider with the statuses."""
    absent = {name for name in ("refined", "reference") if name not in drawn["lines"]}
    absent |= set() if drawn["map"]["total"] else {"map"}
    absent |= set() if any(len(one.points) for one in glimpses) else {"points"}
    layers = "".join(
        f'<button data-layer="{name}"><s style="background:{color}"></s>{escape(text)}</button>'
        for name, (text, color) in LAYERS.items()
        if name not in absent
    )
    views = "".join(
        f'<button id="view-{name}">{text}</button>'
        for name, text in (("all", "all"), ("above", "from above"), ("behind", "with the camera"))
    )
    tracked, weak = summary["tracked"], summary["weak"]
    counts = {"ok": tracked - weak, "weak": weak, "lost": summary["frames"] - tracked}
    legend = ", ".join(f"{counts[name]} {name}" for name in STATUSES)
    ramp = f'<span class="ramp" style="background:linear-gradient(90deg,{",".join(drawn["ramp"][::4])})"></span>'
    return (
        '<div class="card"><div id="scene">'
        f'<div><canvas id="space"></canvas><div class="bar">{views}<span id="grid"></span></div>'
        f'<div class="bar">{layers}</div></div>'
        f'<div id="image"><canvas id="seen"></canvas><div class="bar">{ramp}<span id="seen-about"></span></div></div>'
        "</div></div>"
        '<div class="card" id="player"><div class="bar"><button id="play" aria-label="play">▶</button>'
        '<input id="slider" type="range" min="0" value="0" aria-label="frame">'
        '<button id="doubt">next doubt</button></div>'
        f'<canvas id="strip" role="img" aria-label="status of each frame: {legend}"></canvas>'
        '<div class="bar"><span id="state"></span><span id="about"></span><span id="reason"></span></div>'
        f'<div class="bar"><span>statuses: {legend}; ticks: keyframes</span></div></div>'
    )


def _scripts(data: dict[str, Any]) -> str:
    """The data, in which no text can end the script early, and what draws it."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    code = "\n".join(_web(name) for name in SCRIPTS)
    return f'<script type="application/json" id="data">{text}</script><script>{code}</script>'


def _web(name: str) -> str:
    return files(__package__).joinpath("web", name).read_text(encoding="utf-8")


def _card(html: str) -> str:
    return f'<div class="card">{html}</div>'


def _why_apart(estimate: Trajectory, groundtruth: Trajectory) -> str:
    """Why the estimate cannot be laid onto the ground truth; empty where it can."""
    try:
        absolute_error(estimate, groundtruth)
    except IdRgbdoError as error:
        return _sentences(str(error), *hints(estimate, groundtruth))
    return ""


def _sentences(*texts: str) -> str:
    return " ".join(f"{text[:1].upper()}{text[1:]}." for text in texts)


def _key_figures(summary: dict[str, Any]) -> list[tuple[str, str]]:
    errors, timing = summary.get("evaluation", {}), summary["timing_ms"]
    weak = f", {summary['weak']} of them weak" if summary["weak"] else ""
    values = [
        (f"frames tracked{weak}", f"{summary['tracked']}/{summary['frames']}"),
        ("keyframes", str(summary["keyframes"])),
    ]
    for name, key, unit, factor in (
        ("ATE, RMSE", "ate_rmse_m", "mm", 1000.0),
        ("RPE over 1 s, RMSE", "rpe_rmse_m_per_s", "mm/s", 1000.0),
        ("RPE of the rotation, RMSE", "rpe_rmse_deg_per_s", "deg/s", 1.0),
        ("K2FE, mean", "k2fe_mean_m", "mm", 1000.0),
    ):
        if errors.get(key) is not None:
            values.append((name, f"{factor * errors[key]:.2f} {unit}"))
    if timing["track_median"] is not None:
        values.append(("a frame, median", f"{timing['track_median']:.1f} ms"))
        values.append(("frames per second", f"{summary['frames_per_second']:.0f}"))
    return values


def _entropies(row: dict[str, str]) -> list[float]:
    """Six bits, or nothing."""
    cells = [value for name, value in row.items() if name.startswith("entropy_")]
    return [float(cell) for cell in cells] if all(cells) else []


def _number(cell: str) -> float:
    return float(cell) if cell else np.nan
