"""The HTML around figures and tables: one file, its scripts and styles inside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any
from urllib.parse import quote

STYLE = """
:root { --ink: #1d2733; --muted: #66727f; --line: #dfe4ea; --card: #ffffff; --page: #f4f6f8; --accent: #c2410c; }
* { box-sizing: border-box; }
body { margin: 0; background: var(--page); color: var(--ink); font: 15px/1.5 system-ui, -apple-system, "Segoe UI",
  Roboto, "Helvetica Neue", Arial, sans-serif; }
main { max-width: 1240px; margin: 0 auto; padding: 32px 24px 64px; }
h1 { margin: 0; font-size: 28px; letter-spacing: -0.01em; }
h2 { margin: 40px 0 4px; font-size: 20px; }
.subtitle, .note { color: var(--muted); margin: 4px 0 12px; max-width: 90ch; }
nav { margin: 12px 0 0; display: flex; flex-wrap: wrap; gap: 8px; }
nav a { color: var(--accent); text-decoration: none; border: 1px solid var(--line); border-radius: 999px;
  padding: 2px 12px; background: var(--card); font-size: 14px; }
.card { background: var(--card); border: 1px solid var(--line); border-radius: 10px; padding: 12px; margin: 12px 0;
  overflow: hidden; }
.pair { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(440px, 100%), 1fr)); gap: 12px; }
.pair .card { margin: 0; min-width: 0; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(150px, 1fr)); gap: 12px; margin: 20px 0; }
.tile { background: var(--card); border: 1px solid var(--line); border-radius: 10px; padding: 12px 16px; }
.tile b { display: block; font-size: 20px; white-space: nowrap; font-variant-numeric: tabular-nums; }
.tile span { color: var(--muted); font-size: 13px; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: 14px; font-variant-numeric: tabular-nums; }
th, td { padding: 5px 10px; text-align: right; white-space: nowrap; border-bottom: 1px solid var(--line); }
th:first-child, td:first-child, .text { text-align: left; }
td.text { white-space: normal; min-width: 16em; }
th { color: var(--muted); font-weight: 600; cursor: pointer; user-select: none; }
tbody tr:hover { background: #faf6f3; }
td.best { color: var(--accent); font-weight: 700; }
pre { margin: 0; overflow-x: auto; font-size: 13px; }
summary { cursor: pointer; color: var(--muted); }
footer { margin-top: 40px; color: var(--muted); font-size: 13px; }
@media (max-width: 600px) {
  main { padding: 16px 10px 32px; } h1 { font-size: 22px; overflow-wrap: anywhere; } h2 { margin-top: 28px; }
  .tiles { grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 8px; }
  .tile { padding: 8px 12px; } .tile b { font-size: 18px; }
  .card { padding: 8px; }
}
"""

SCRIPT = """
// while the page was being read, some figures had more room than in the end
for (const plot of document.querySelectorAll(".js-plotly-plot")) Plotly.Plots.resize(plot);
// a method switched off in one legend disappears from every figure of its section
for (const plot of document.querySelectorAll(".js-plotly-plot")) plot.on("plotly_restyle", change => {
  if (plot.busy || !("visible" in change[0])) return;
  const seen = new Map(plot.data.map(trace => [trace.name, trace.visible ?? true]));
  for (const other of plot.closest("section").querySelectorAll(".js-plotly-plot")) {
    if (other === plot || !other.data.some(trace => seen.has(trace.name))) continue;
    other.busy = true;
    Plotly.restyle(other, {visible: other.data.map(trace => seen.get(trace.name) ?? trace.visible ?? true)})
      .then(() => other.busy = false);
  }
});
for (const th of document.querySelectorAll("th")) th.addEventListener("click", () => {
  const body = th.closest("table").tBodies[0], column = th.cellIndex, down = th.dataset.down !== "1";
  const value = row => { const n = parseFloat(row.cells[column].textContent); return isNaN(n) ? null : n; };
  th.dataset.down = down ? "1" : "";
  [...body.rows].sort((a, b) => {
    const x = value(a), y = value(b);
    if (x === null && y === null) return a.cells[column].textContent.localeCompare(b.cells[column].textContent);
    if (x === null || y === null) return x === null ? 1 : -1;
    return down ? x - y : y - x;
  }).forEach(row => body.append(row));
});
"""


@dataclass(frozen=True)
class Section:
    """A heading with HTML below it."""

    title: str
    html: str
    note: str = ""


def page(
    title: str,
    subtitle: str,
    intro: str,
    sections: list[Section],
    footer: str,
    plots: bool = True,
    style: str = "",
    after: str = "",
) -> str:
    """The whole document; where it has plots, plotly's script stands inside, so that it works without a network.

    style: more of it. after: HTML at the end of the body, which finds all that stands before.
    """
    script = ""
    if plots:
        from plotly.offline import get_plotlyjs

        script = f"<script>{get_plotlyjs()}</script>"
    links = "".join(f'<a href="#{_anchor(s.title)}">{escape(s.title)}</a>' for s in sections)
    body = "".join(
        f'<section><h2 id="{_anchor(s.title)}">{escape(s.title)}</h2>'
        + (f'<p class="note">{escape(s.note)}</p>' if s.note else "")
        + f"{s.html}</section>"
        for s in sections
    )
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1"><link rel="icon" href="data:,">'
        f"<style>{STYLE}{style}</style>{script}</head><body><main>"
        f'<h1>{escape(title)}</h1><p class="subtitle">{escape(subtitle)}</p><nav>{links}</nav>{intro}{body}'
        f"<footer>{escape(footer)}</footer></main><script>{SCRIPT}</script>{after}</body></html>\n"
    )


def figure(drawn: Any) -> str:
    """A plotly figure in a card."""
    html = drawn.to_html(include_plotlyjs=False, full_html=False, config={"displaylogo": False, "responsive": True})
    return f'<div class="card">{html}</div>'


def pair(*cards: str) -> str:
    """Cards side by side where there is room."""
    return f'<div class="pair">{"".join(cards)}</div>'


def tiles(values: list[tuple[str, str]]) -> str:
    """The key figures: value and what it is."""
    cards = (f'<div class="tile"><b>{escape(value)}</b><span>{escape(name)}</span></div>' for name, value in values)
    return f'<div class="tiles">{"".join(cards)}</div>'


def table(
    columns: tuple[str, ...],
    rows: tuple[tuple[str, ...], ...],
    best: set[tuple[int, int]] | None = None,
    links: Sequence[str] = (),
) -> str:
    """A table that sorts by a click on a heading; best: cells (row, column) that stand out.

    links: where the first cell of each row leads, an address relative to the page; empty for nowhere.
    """
    words = {c for c in range(1, len(columns)) if not any(row[c][:1].isdigit() for row in rows if row[c][1:2] != " ")}
    kind = [" class=text" if c in words else "" for c in range(len(columns))]
    head = "".join(f"<th{kind[c]}>{escape(column)}</th>" for c, column in enumerate(columns))
    body = ""
    for r, row in enumerate(rows):
        texts = [escape(cell) for cell in row]
        if links and links[r]:
            texts[0] = f'<a href="{escape(quote(links[r]))}">{texts[0]}</a>'
        cells = (
            f"<td{' class=best' if best and (r, c) in best else kind[c]}>{text}</td>" for c, text in enumerate(texts)
        )
        body += f"<tr>{''.join(cells)}</tr>"
    return f'<div class="card scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def preformatted(text: str, summary: str) -> str:
    """Text that is shown when asked for."""
    return f'<div class="card"><details><summary>{escape(summary)}</summary><pre>{escape(text)}</pre></details></div>'


def _anchor(title: str) -> str:
    return "".join(letter if letter.isalnum() else "-" for letter in title.lower())
