"""report.html of one run, from what its folder holds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..errors import IdRgbdoError
from ..evaluation import absolute_error, hints
from ..text.files import read_json, read_table, read_text
from ..trajectory import Trajectory, read_tum
from . import figures, series
from .figures import Line
from .page import Section, figure, page, pair, preformatted, tiles
from .snapshots import Snapshot, snapshot_html


def run_page(
    folder: Path, title: str, groundtruth: Trajectory | None = None, snapshots: Sequence[Snapshot] = ()
) -> str:
    """The page of a run folder (trajectory.txt, frames.csv, summary.json, config.toml), as HTML text."""
    rows = read_table(folder / "frames.csv", ("timestamp", "status", "reason", "keyframe", "decode_ms", "ms"))
    summary = read_json(folder / "summary.json")
    lines = [Line("estimate", read_tum(folder / "trajectory.txt"), "#c2410c")]
    refined = folder / "trajectory_refined.txt"
    if refined.exists():
        lines.append(Line("refined", read_tum(refined), "#3f88c5"))
    times = [float(row["timestamp"]) for row in rows]
    begin, span = (times[0], times[-1] - times[0]) if times else (0.0, 0.0)
    seconds = [time - begin for time in times]
    apart = "" if groundtruth is None else _why_apart(lines[0].trajectory, groundtruth)
    reference = None if apart else groundtruth
    lines = figures.aligned(lines, reference) or lines
    keyframes = [s for s, row in zip(seconds, rows, strict=True) if row["keyframe"] == "1"]
    laid = "" if reference is None else "After rigid alignment without scale."
    sections = [
        Section(
            "Trajectory",
            pair(
                figure(figures.trajectories_3d(lines, reference)),
                figure(figures.trajectories_from_above(lines, reference)),
            ),
            f"The ground truth is not shown. {apart}" if apart else laid,
        )
    ]
    if reference is not None:
        drawn = series.errors_over_time(lines, reference, begin, span)
        sections.append(Section("Error", figure(drawn), _sentences(*hints(lines[0].trajectory, reference))))
    statuses, reasons = [row["status"] for row in rows], [row["reason"] for row in rows]
    sections.append(Section("Status", figure(series.statuses_over_time(seconds, statuses, reasons, span))))
    known = [(s, _entropies(row)) for s, row in zip(seconds, rows, strict=True) if _entropies(row)]
    if known:
        drawn = series.entropy_over_time([s for s, _ in known], [bits for _, bits in known], keyframes, span)
        note = "Of the pose against its keyframe, in bits: one more is a standard deviation twice as large."
        sections.append(Section("Certainty", figure(drawn), note))
    stages = {
        "waiting for images": [_number(row["decode_ms"]) for row in rows],
        "tracking": [_number(row["ms"]) if row["keyframe"] == "0" else None for row in rows],
        "tracking and a new keyframe": [_number(row["ms"]) if row["keyframe"] == "1" else None for row in rows],
    }
    sections.append(Section("Time", figure(series.milliseconds_over_time(seconds, stages, span))))
    if snapshots:
        html = f'<div class="card frames">{"".join(snapshot_html(s, begin) for s in snapshots)}</div>'
        note = "The points tracked in some of the frames; the larger a ring, the more bits the point adds to the pose."
        sections.append(Section("Points", html, note))
    trouble = "\n".join(
        f"{s:8.2f} s  {row['status']:5s} {row['reason']}"
        for s, row in zip(seconds, rows, strict=True)
        if row["status"] != "ok"
    )
    if trouble:
        sections.append(Section("Doubts", preformatted(trouble, f"{trouble.count(chr(10)) + 1} frames weak or lost")))
    config = read_text(folder / "config.toml")
    sections.append(Section("Configuration", preformatted(config, "config.toml")))
    subtitle = f"{summary['frames']} frames, {summary['path_length_m']:.2f} m"
    return page(title, subtitle, tiles(_key_figures(summary)), sections, f"Made from {folder.name}.")


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


def _number(cell: str) -> float | None:
    return float(cell) if cell else None
