"""Every equation has one home, and the README's map leads to it."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
TAGS = [*(f"Eq. ({number})." for number in range(1, 27)), "Algorithm 1."]
HAVE_DOCSTRINGS = (ast.FunctionDef, ast.ClassDef, ast.Module)


def homes(tag: str) -> list[str]:
    """`file.py:name` of everything in the package whose docstring opens with the tag."""
    found = []
    for path in sorted((ROOT / "idrgbdo_torch").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, HAVE_DOCSTRINGS) and (ast.get_docstring(node) or "").startswith(tag):
                found.append(f"{path.relative_to(ROOT / 'idrgbdo_torch')}:{getattr(node, 'name', 'module')}")
    return found


def rows() -> dict[str, str]:
    """The README's table rows by what stands in their first cell."""
    lines = [line for line in (ROOT / "README.md").read_text().splitlines() if line.startswith("|")]
    cells = [[cell.strip(" `") for cell in line.strip("|").split("|")] for line in lines]
    return {cell[0]: " | ".join(cell[1:]) for cell in cells}


@pytest.mark.parametrize("tag", TAGS)
def test_one_home_and_one_row(tag: str) -> None:
    found = homes(tag)
    assert len(found) == 1, f"{tag} opens {len(found)} docstrings: {found}"
    file, name = found[0].split(":")
    label = re.sub(r"[().]", "", tag.removeprefix("Eq. ")).strip()  # "18", "Algorithm 1"
    row = next((text for first, text in rows().items() if first in (label, f"({label})", tag, tag.rstrip("."))), None)
    assert row is not None, f"the README's equation map has no row for {tag}"
    assert file in row, f"the row of {tag} does not name {file}: {row}"
    assert name in row, f"the row of {tag} does not name {name}: {row}"
