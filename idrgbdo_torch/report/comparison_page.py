"""report.html of a comparison."""

from __future__ import annotations

import colorsys
from contextlib import suppress

from ..comparison import Comparison
from ..comparison.table import LEGEND, Table, best_cells, provenance, tables
from ..errors import IdRgbdoError
from ..text.files import read_text
from . import figures, series
from .figures import Line
from .page import Section, figure, page, pair, preformatted, table, tiles

HUES = {"ours": 0.055, "open3d": 0.575, "opencv": 0.42, "external": 0.11}  # of the families; others follow
GRAY = "#9aa5b1"
FAR_OFF = 8.0  # times the median ATE; such a line is shown after a click only


def comparison_page(comparison: Comparison, title: str = "Comparison") -> str:
    """Tables and figures of a comparison, as HTML text."""
    colors = _colors(comparison)
    everything = tables(comparison)
    overall = everything[0]
    several = len(comparison.sequences) > 1
    sections = [Section("Results" if several else overall.title, _table_html(overall), LEGEND)]
    sections[0] = Section(sections[0].title, sections[0].html + figure(_accuracy(comparison, colors)), LEGEND)
    by_title = {each.title: each for each in everything}
    for sequence in comparison.sequences:
        html = _table_html(by_title[sequence]) if several else ""
        sections.append(
            Section(sequence if several else f"{sequence}: figures", html + _sequence(comparison, sequence, colors))
        )
    sections.append(Section("Methods", _descriptions(comparison), "Settings of those that have any."))
    subtitle = f"{len(comparison.methods)} methods on {len(comparison.sequences)} sequences"
    return page(title, subtitle, tiles(_key_figures(comparison)), sections, provenance(comparison))


def _key_figures(comparison: Comparison) -> list[tuple[str, str]]:
    rows = comparison.rows() if len(comparison.sequences) > 1 else comparison.rows(comparison.sequences[0])
    accurate = [(s.mean, row) for row in rows if (s := row.spread("rpe_rmse_m_per_s")) is not None]
    timed = [(row.track_ms, row) for row in rows if row.track_ms is not None and row.outcomes[0].kind != "null"]
    values = [("runs", str(len(comparison.outcomes)))]
    if accurate:
        drift, row = min(accurate, key=lambda item: item[0])
        values.append((f"least drift: {row.method}", f"{1000 * drift:.2f} mm/s"))
    if timed:
        ms, row = min(timed, key=lambda item: item[0])
        values.append((f"fastest: {row.method}", f"{ms:.1f} ms"))
    return values


def _sequence(comparison: Comparison, sequence: str, colors: dict[str, str]) -> str:
    """Trajectories, errors and agreement on one sequence."""
    reference = comparison.groundtruths[sequence]
    found = [(name, comparison.trajectory(name, sequence)) for name in comparison.methods]
    errors = {row.method: row.spread("ate_rmse_m") for row in comparison.rows(sequence)}
    known = sorted(spread.mean for spread in errors.values() if spread is not None)
    limit = FAR_OFF * known[len(known) // 2] if known else float("inf")
    lines = []
    for name, trajectory in found:
        if trajectory is not None and len(trajectory) > 2:
            spread = errors.get(name)
            shown = name != "constant-velocity" and (spread is None or spread.mean <= limit)
            lines.append(Line(name, trajectory, colors[name], shown=shown))
    on_reference = figures.aligned(lines, reference)
    reference = reference if on_reference else None  # it does not overlap: the methods are still to be seen
    lines = on_reference or lines
    if not lines:
        return ""
    html = pair(
        figure(figures.trajectories_3d(lines, reference)), figure(figures.trajectories_from_above(lines, reference))
    )
    if reference is not None:
        html += figure(series.errors_over_time(lines, reference, float(reference.timestamps[0])))
    agreement = comparison.agreement(sequence)
    return html + figure(figures.agreement_map(agreement.methods, agreement.rpe_m_per_s))


def _accuracy(comparison: Comparison, colors: dict[str, str]) -> object:
    rows = comparison.rows() if len(comparison.sequences) > 1 else comparison.rows(comparison.sequences[0])
    points = []
    for row in rows:
        spread, ms = row.spread("rpe_rmse_m_per_s"), row.track_ms
        if spread is not None and ms is not None and row.outcomes[0].kind != "null":
            points.append((row.method, ms, 1000 * spread.mean, colors[row.method]))
    return figures.accuracy_against_time(points)


def _colors(comparison: Comparison) -> dict[str, str]:
    """A hue for each family, from dark to light within it; the null baseline is gray."""
    families: dict[str, list[str]] = {}
    kinds = {outcome.method: outcome.kind for outcome in comparison.outcomes}
    for name, kind in kinds.items():
        families.setdefault(kind if kind in ("ours", "external", "null") else name.partition("-")[0], []).append(name)
    colors = {name: GRAY for name in families.pop("null", [])}
    free = iter((0.78, 0.0, 0.88, 0.5, 0.68, 0.3))
    for family, names in families.items():
        hue = HUES[family] if family in HUES else next(free, 0.6)
        for number, name in enumerate(names):
            light = 0.36 + 0.34 * number / max(len(names), 2)
            red, green, blue = (round(255 * c) for c in colorsys.hls_to_rgb(hue, light, 0.72))
            colors[name] = f"#{red:02x}{green:02x}{blue:02x}"
    return colors


def _table_html(each: Table) -> str:
    """A table whose least errors and times stand out."""
    return table(each.columns, each.rows, best_cells(each))


def _descriptions(comparison: Comparison) -> str:
    """What each method is, and its settings."""
    runs = {outcome.method: outcome for outcome in comparison.outcomes}
    html = table(("method", "what it is"), tuple((name, run.description) for name, run in runs.items()))
    for name, run in runs.items():
        text = ""
        with suppress(IdRgbdoError):  # there is none, or it is no text
            text = read_text(comparison.folder / run.folder / "config.toml").strip()
        html += preformatted(text, name) if text else ""
    return html
