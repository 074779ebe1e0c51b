"""As much YAML as camera calibrations are written in: nested keys, lists, numbers, text; OpenCV's dialect too."""

from __future__ import annotations

import re
from typing import Any

from ..errors import IdRgbdoError
from ..text.plain import shown

MOST_LETTERS, MOST_LINES = 1 << 20, 20_000  # calibrations are shorter, and time grows with the square of the lines
DEEPEST = 20  # lists in lists

Lines = list[tuple[int, str]]  # indentation, text


def parse_yaml(text: str, where: str) -> dict[str, Any]:
    """The mapping that the text is. Tags (`!!opencv-matrix`) and comments are dropped; anchors are not known.

    Raises IdRgbdoError, showing the line, for anything else.
    """
    lines: Lines = []
    indent = 0
    rows = text.splitlines()
    if len(text) > MOST_LETTERS or len(rows) > MOST_LINES:
        raise IdRgbdoError(
            f"{where}: expected a calibration, got {len(rows)} lines; write the camera into a file of its own"
        )
    parts: list[str] = []  # of a list in brackets that goes on in the next line
    depth = 0  # of the brackets that are open
    for raw in rows:
        line = re.sub(r"(^|\s)#.*$", "", raw).rstrip()
        if not line.strip() or (line.startswith(("%", "---", "...")) and not depth):
            continue
        line = line.replace("\t", "  ")
        indent = indent if depth else len(line) - len(line.lstrip())
        parts.append(line.strip())
        depth = max(0, depth + sum(map(line.count, "[{")) - sum(map(line.count, "]}")))
        if not depth:
            lines.append((indent, " ".join(parts)))
            parts = []
    if parts:
        raise IdRgbdoError(f"{where}: a list in brackets has no end; correct it")
    value, rest = _block(lines, where)
    if rest or not isinstance(value, dict):
        first = rest[0][1] if rest else text[:40]
        raise IdRgbdoError(f"{where}: expected lines `key: value`, got '{shown(first, quoted=False)}'; correct it")
    return value


def _block(lines: Lines, where: str) -> tuple[Any, Lines]:
    """The value that begins at the first line, and the lines behind it."""
    if not lines:
        return {}, []
    indent = lines[0][0]
    if lines[0][1].startswith("- ") or lines[0][1] == "-":
        return _items(lines, indent, where)
    found: dict[str, Any] = {}
    while lines and lines[0][0] == indent:
        key, colon, text = lines[0][1].partition(":")
        if not colon or (text and not text[0].isspace()):
            raise IdRgbdoError(f"{where}: expected `key: value`, got '{shown(lines[0][1], quoted=False)}'; correct it")
        lines, text = lines[1:], re.sub(r"^\s*!!?[\w-]+", "", text).strip()
        deeper = lines and (lines[0][0] > indent or (lines[0][0] == indent and lines[0][1].startswith("- ")))
        if not text and deeper:
            value, lines = _block(lines, where)
        else:
            value = _scalar(text)
        found[key.strip().strip("\"'")] = value
    return found, lines


def _items(lines: Lines, indent: int, where: str) -> tuple[list[Any], Lines]:
    items = []
    while lines and lines[0][0] == indent and lines[0][1].startswith("-"):
        text = lines[0][1][1:].strip()
        if text.startswith("- ") or re.match(r"[\w.\"']+:(\s|$)", text):  # what begins behind the dash goes on below
            within = indent + len(lines[0][1]) - len(text)
            value, lines = _block([(within, text), *lines[1:]], where)
        elif text:
            value, lines = _scalar(text), lines[1:]
        else:
            value, lines = _block(lines[1:], where)
        items.append(value)
    return items, lines


def _scalar(text: str, depth: int = 0) -> Any:
    """A list in brackets, a mapping in braces, a number, or text; text, too, what is nested deeper than any list is."""
    if text.startswith("[") and text.endswith("]") and depth < DEEPEST:
        return [_scalar(part, depth + 1) for part in _split(text[1:-1])]
    if text.startswith("{") and text.endswith("}") and depth < DEEPEST:
        pairs = (part.partition(":") for part in _split(text[1:-1]))
        return {key.strip().strip("\"'"): _scalar(value.strip(), depth + 1) for key, _, value in pairs}
    try:
        return float(text)
    except ValueError:
        return text.strip("\"'")


def _split(inner: str) -> list[str]:
    """The parts between commas that stand in no bracket of their own."""
    parts, depth, start = [], 0, 0
    for at, letter in enumerate(inner):
        depth += (letter in "[{") - (letter in "]}")
        if letter == "," and depth == 0:
            parts.append(inner[start:at])
            start = at + 1
    return [part.strip() for part in [*parts, inner[start:]] if part.strip()]
