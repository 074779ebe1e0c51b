"""Where each equation of the paper is, by the docstrings and by the README's map, and what runs meanwhile."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from pathlib import Path
from types import CodeType, FrameType

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "idrgbdo_torch"
TAGS = [*(f"Eq. ({number})." for number in range(1, 27)), "Algorithm 1."]
HAVE_DOCSTRINGS = (ast.FunctionDef, ast.ClassDef, ast.Module)


def homes(tag: str) -> list[str]:
    """`file.py:name` of everything in the package whose docstring opens with the tag."""
    return [place for place, docstring in docstrings() if docstring.startswith(tag)]


@cache
def docstrings() -> list[tuple[str, str]]:
    """`file.py:name` and docstring of everything in the package that has one."""
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, HAVE_DOCSTRINGS) and (docstring := ast.get_docstring(node)):
                found.append((f"{path.relative_to(PACKAGE)}:{getattr(node, 'name', 'module')}", docstring))
    return found


def label(tag: str) -> str:
    """What the first cell of a tag's row says: "18", "Algorithm 1"."""
    return re.sub(r"[().]", "", tag.removeprefix("Eq. ")).strip()


def rows() -> dict[str, list[str]]:
    """The other cells of the README's table rows by what stands in their first one."""
    lines = [line for line in (ROOT / "README.md").read_text().splitlines() if line.startswith("|")]
    cells = [[cell.strip(" `") for cell in line.strip("|").split("|")] for line in lines]
    return {cell[0]: cell[1:] for cell in cells}


def code_of(place: str) -> CodeType:
    """The code of a function `file.py:name`, compiled or not."""
    file, name = place.split(":")
    module = import_module("idrgbdo_torch." + file.removesuffix(".py").replace("/", "."))
    function = getattr(module, name)
    code = getattr(function, "py_func", function).__code__
    assert isinstance(code, CodeType)
    return code


@contextmanager
def called() -> Iterator[set[CodeType]]:
    """The code of every Python function that this thread calls meanwhile."""
    codes: set[CodeType] = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            codes.add(frame.f_code)

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        yield codes
    finally:
        sys.setprofile(before)
