"""The tables of a comparison as cells: what the terminal, Markdown, CSV and the page show."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from ..text.latex import booktabs
from .summary import Agreement, Comparison, Row, Spread


@dataclass(frozen=True)
class Column:
    """A column: its title with the unit, and what stands in a row's cell."""

    title: str
    cell: Callable[[Row], str]


@dataclass(frozen=True)
class Table:
    """Titles and cells."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def _millimetres(name: str) -> Callable[[Row], str]:
    return lambda row: _spread(row.spread(name), 1000.0, seeds=bool(row.sequence))


def _degrees(name: str) -> Callable[[Row], str]:
    return lambda row: _spread(row.spread(name), 1.0, seeds=bool(row.sequence), digits=3)


def _number(name: str, digits: int, suffix: str = "") -> Callable[[Row], str]:
    def cell(row: Row) -> str:
        value = getattr(row, name)
        return "" if value is None else f"{value:.{digits}f}{suffix}"

    return cell


COLUMNS = (
    Column("method", lambda row: row.method),
    Column("ATE mm", _millimetres("ate_rmse_m")),
    Column("RPE mm/s", _millimetres("rpe_rmse_m_per_s")),
    Column("RPE deg/s", _degrees("rpe_rmse_deg_per_s")),
    Column("K2FE mm", _millimetres("k2fe_mean_m")),
    Column("made of", lambda row: row.made_of),
    Column(
        "tracked", lambda row: f"{row.frames - row.lost}/{row.frames}" + (f" ({row.weak} weak)" if row.weak else "")
    ),
    Column("found again", lambda row: f"{row.found_again} of {row.breaks}" if row.breaks else ""),
    Column("ms median", _number("track_ms", 1)),
    Column("ms 95 %", _number("track_ms_p95", 1)),
    Column("speed", _number("speedup", 1, " x")),
    Column("MB", _number("peak_memory_mb", 0)),
    Column("lost because", lambda row: row.error or _reasons(row)),
)
AGREEMENT = ": RPE between methods, mm/s (needs no reference)"
LEGEND = (
    "ATE: RMSE after rigid alignment without scale. RPE: RMSE of the drift over 1 s. K2FE: mean error of a frame "
    "against its keyframe, where a method has keyframes. made of: the poses behind ATE and pairs behind RPE, "
    "where the reference covers only a part. found again: of the times that a track was lost and went on, those where "
    "it went on in the same map. ms: in track() alone, decoding excluded. speed: how many "
    "times as fast as the fastest baseline. MB: peak memory of a process of its own, libraries included. "
    "Where a method is random: mean ± standard deviation (worst) over seeds."
)


def tables(comparison: Comparison) -> list[Table]:
    """Over all sequences where there are several, then each sequence, then who agrees with whom."""
    found = []
    if len(comparison.sequences) > 1:
        rows = comparison.rows()
        found.append(_table(f"mean over {len(comparison.sequences)} sequences", rows))
    for sequence in comparison.sequences:
        found.append(_table(sequence, comparison.rows(sequence)))
    return found + [_agreement(comparison.agreement(sequence)) for sequence in comparison.sequences]


def best_cells(table: Table) -> set[tuple[int, int]]:
    """The least error and time of each column, as (row, column); the null baseline is no rival."""
    best = set()
    for column, title in enumerate(table.columns):
        if title.split(" ")[0] in ("ATE", "RPE", "K2FE", "ms"):
            values = {r: float(row[column].split(" ")[0]) for r, row in enumerate(table.rows) if row[column]}
            values = {r: value for r, value in values.items() if table.rows[r][0] != "constant-velocity"}
            if values:
                best.add((min(values, key=lambda r: values[r]), column))
    return best


def to_latex(comparison: Comparison) -> str:
    """The tables as LaTeX with booktabs, without memory and reasons; agreement is left to the page."""
    parts = []
    for table in tables(comparison):
        if table.title.endswith(AGREEMENT):
            continue
        kept = [c for c, title in enumerate(table.columns) if title not in ("made of", "MB", "lost because")]
        best = {(r, kept.index(c)) for r, c in best_cells(table) if c in kept}
        rows = [[row[c] for c in kept] for row in table.rows]
        parts.append(booktabs([table.columns[c] for c in kept], rows, table.title, table.title, best))
    notes = "".join(f"% {line}\n" for line in (LEGEND, provenance(comparison)))
    return notes + "\n".join(parts)


def to_markdown(comparison: Comparison) -> str:
    """All tables, the legend, the machine and the versions."""
    parts = [_markdown(table) for table in tables(comparison)]
    return "\n\n".join([*parts[:1], LEGEND, *parts[1:], provenance(comparison)]) + "\n"


def provenance(comparison: Comparison) -> str:
    """When, where and with which versions the figures came about."""
    dates = sorted({outcome.date[:10] for outcome in comparison.outcomes if outcome.date})
    machines = sorted({outcome.machine for outcome in comparison.outcomes if outcome.machine})
    versions = sorted({f"{name} {v}" for outcome in comparison.outcomes for name, v in outcome.versions.items()})
    when = dates[0] if len(set(dates)) == 1 else " to ".join((dates[0], dates[-1])) if dates else "undated"
    return f"Measured {when} on {'; '.join(machines) or 'an unknown machine'}. Versions: {', '.join(versions)}."


def to_csv(comparison: Comparison) -> str:
    """A line for each method on each sequence, figures in metres and seconds, spreads in columns of their own."""
    buffer = io.StringIO()
    lines = [_flat(row) for sequence in comparison.sequences for row in comparison.rows(sequence)]
    writer = csv.DictWriter(buffer, fieldnames=list(lines[0]) if lines else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    return buffer.getvalue()


def to_json(comparison: Comparison) -> str:
    """Everything: rows, single outcomes, and agreement."""
    return json.dumps(
        {
            "rows": [_flat(row) for sequence in ("", *comparison.sequences) for row in comparison.rows(sequence)],
            "agreement": [asdict(comparison.agreement(sequence)) for sequence in comparison.sequences],
            "outcomes": [asdict(outcome) for outcome in comparison.outcomes],
        },
        indent=1,
    )


def _table(title: str, rows: list[Row]) -> Table:
    shown = [column for column in COLUMNS if column.title == "method" or any(column.cell(row) for row in rows)]
    cells = tuple(tuple(column.cell(row) for column in shown) for row in rows)
    return Table(title, tuple(column.title for column in shown), cells)


def _agreement(agreement: Agreement) -> Table:
    numbers = {name: str(number) for number, name in enumerate(agreement.methods, start=1)}
    rows = tuple(
        (f"{numbers[a]} {a}", *("" if value is None else f"{1000 * value:.1f}" for value in row))
        for a, row in zip(agreement.methods, agreement.rpe_m_per_s, strict=True)
    )
    title = agreement.sequence + AGREEMENT
    return Table(title, ("method", *numbers.values()), rows)


def _reasons(row: Row) -> str:
    return ", ".join(f"{count} x {why}" for why, count in list(row.reasons.items())[:2])


def _spread(spread: Spread | None, factor: float, seeds: bool, digits: int = 2) -> str:
    """Mean, with deviation and worst where that is over seeds."""
    if spread is None:
        return ""
    mean = f"{factor * spread.mean:.{digits}f}"
    if spread.count == 1 or not seeds:
        return mean
    return f"{mean} ± {factor * spread.std:.{digits}f} ({factor * spread.worst:.{digits}f})"


def _markdown(table: Table) -> str:
    lines = [table.columns, tuple("---" if i == 0 else "---:" for i in range(len(table.columns))), *table.rows]
    return "\n".join([f"### {table.title}", "", *("| " + " | ".join(line) + " |" for line in lines)])


def _flat(row: Row) -> dict[str, Any]:
    """A row as plain columns."""
    flat: dict[str, Any] = {"method": row.method, "sequence": row.sequence or "all", "description": row.description}
    for name in ("ate_rmse_m", "rpe_rmse_m_per_s", "rpe_rmse_deg_per_s", "k2fe_mean_m"):
        spread = row.spread(name)
        for part in ("mean", "std", "worst"):
            flat[f"{name}_{part}"] = None if spread is None else getattr(spread, part)
    for name in (
        "frames",
        "lost",
        "weak",
        "breaks",
        "found_again",
        "track_ms",
        "track_ms_p95",
        "speedup",
        "peak_memory_mb",
        "error",
    ):
        flat[name] = getattr(row, name)
    flat["matched_poses"], flat["rpe_pairs"] = row.matched_poses, row.rpe_pairs
    flat["runs"] = len(row.outcomes)
    flat["lost_because"] = "; ".join(f"{count} x {reason}" for reason, count in row.reasons.items())
    return flat
