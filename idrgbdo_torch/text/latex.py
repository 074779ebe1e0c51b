"""Tables for papers: LaTeX with booktabs."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

SPECIAL = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "±": r"$\pm$", "°": r"$^\circ$", "×": r"$\times$",
    "<": r"\textless{}", ">": r"\textgreater{}",
}  # fmt: skip
NUMBER = re.compile(r"[-+]?\d[\d.]*(?:e[-+]?\d+)?( .*)?$")


def escaped(text: str) -> str:
    """Text that LaTeX prints as it stands."""
    return "".join(SPECIAL.get(letter, letter) for letter in text)


def booktabs(
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    caption: str,
    label: str,
    best: Collection[tuple[int, int]] = (),
) -> str:
    """A table as LaTeX text, to be read with \\input; needs the package booktabs.

    best: cells (row, column) to print bold. Columns of numbers stand right. An empty cell becomes a dash.
    """
    name = re.sub("[^A-Za-z0-9]+", "-", label).strip("-")
    kinds = "".join("r" if _is_numbers([row[c] for row in rows if row[c]]) else "l" for c in range(len(columns)))
    lines = [
        r"\begin{table}",
        r"  \centering",
        rf"  \caption{{{escaped(caption)}}}",
        rf"  \label{{tab:{name}}}",
        rf"  \begin{{tabular}}{{{kinds}}}",
        r"    \toprule",
        f"    {_line([escaped(column) for column in columns])}",
        r"    \midrule",
    ]
    for r, row in enumerate(rows):
        cells = [escaped(cell) if cell else "--" for cell in row]
        lines.append("    " + _line([_bold(cell) if (r, c) in best else cell for c, cell in enumerate(cells)]))
    return "\n".join([*lines, r"    \bottomrule", r"  \end{tabular}", r"\end{table}", ""])


def _is_numbers(cells: Sequence[str]) -> bool:
    return bool(cells) and all(NUMBER.match(cell) for cell in cells)


def _bold(cell: str) -> str:
    return rf"\textbf{{{cell}}}"


def _line(cells: Sequence[str]) -> str:
    return " & ".join(cells) + r" \\"
