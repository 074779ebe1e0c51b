"""Many runs side by side: a row each, as a page that leads to their reports, and as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

from .page import Section, page, table, tiles

COLUMNS = (
    *("recording", "frames", "weak", "lost", "keyframes", "path m", "ATE mm", "RPE mm/s", "RPE deg/s", "ms a frame"),
    "note",
)
Row = Mapping[str, Any]  # a run's summary, its recording's name, and the error where there is nothing else


def cells(row: Row) -> tuple[str, ...]:
    """A row in the order of COLUMNS; empty where nothing is known."""
    errors, timing = row.get("evaluation") or {}, row.get("timing_ms") or {}
    return (
        str(row["recording"]),
        *(str(row.get(name, "")) for name in ("frames", "weak", "lost", "keyframes")),
        _number(row.get("path_length_m"), 1.0, 2),
        _number(errors.get("ate_rmse_m"), 1000.0, 2),
        _number(errors.get("rpe_rmse_m_per_s"), 1000.0, 2),
        _number(errors.get("rpe_rmse_deg_per_s"), 1.0, 3),
        _number(timing.get("track_median"), 1.0, 1),
        _note(row),
    )


def to_csv(rows: Sequence[Row]) -> str:
    """A line a recording."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([COLUMNS, *map(cells, rows)])
    return text.getvalue()


def batch_page(title: str, rows: Sequence[Row]) -> str:
    """The page as HTML text; the recordings' names lead to their own reports, in folders beside it."""
    tracked = [row for row in rows if "frames" in row]
    failed = [row for row in rows if row.get("error")]
    frames, lost = (sum(row[name] for row in tracked) for name in ("frames", "lost"))
    key = [
        ("recordings", str(len(rows))),
        ("tracked", str(len(tracked))),
        ("failed", str(len(failed))),
        ("frames", str(frames)),
        ("lost frames", f"{100 * lost / frames:.2f} %" if frames else "0"),
    ]
    links = [f"{row['recording']}/report.html" if row.get("frames") else "" for row in rows]
    sections = [Section("Recordings", table(COLUMNS, tuple(map(cells, rows)), links=links))]
    if failed:
        reasons = tuple((str(row["recording"]), str(row["error"])) for row in failed)
        sections.append(Section("Failed", table(("recording", "why"), reasons)))
    machines = sorted({str(row["machine"]) for row in tracked if row.get("machine")})
    return page(title, "Recordings tracked together", tiles(key), sections, "; ".join(machines), plots=False)


def _note(row: Row) -> str:
    if "frames" not in row:
        return str(row.get("error") or "not yet")
    return "; ".join(row.get("warnings") or ())


def _number(value: float | None, factor: float, digits: int) -> str:
    return "" if value is None else f"{factor * value:.{digits}f}"
