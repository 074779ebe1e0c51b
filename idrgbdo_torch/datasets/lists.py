"""Lists of images as people's programs write them: `timestamp file` a line, in any of the dialects."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from ..errors import IdRgbdoError
from ..text.clock import doubtful_seconds, in_seconds, unit_of
from ..text.files import read_text
from ..text.plain import shown
from ..text.tum import LATEST
from .images import IMAGE_SUFFIXES
from .pairing import MOST_REPEATED

MOST_FIELDS = 64  # of a line whose names of images hold blanks
LONGEST_PATH = 4096  # letters
STEP_BACK_S = 1.0  # a longer one is a clock that was set back
NUMBER_FRAMES = (
    "number the frames instead: remove or rename the lists, so that the images are paired by the numbers in their "
    "names, with `fps = ...` in camera.toml"
)
NAME = re.compile(rf"({'|'.join(re.escape(suffix) for suffix in sorted(IMAGE_SUFFIXES))})$", re.IGNORECASE)
DECIMAL_COMMA = re.compile(r"\d+,\d+")

Entry = tuple[float, Path]  # s, image file


@dataclass(frozen=True)
class ImageList:
    """One column of times with one of files, as a list has them."""

    entries: list[Entry]  # in the order of the lines
    unit: str  # of the times as they are written
    path: Path  # of the list
    lines: list[int]  # numbers of the entries' lines

    def by_time(self) -> tuple[list[Entry], tuple[str, ...]]:
        """The entries in the order of their times, each time once, and what a user should know.

        Raises IdRgbdoError for times that are no clock: many repeat, or they go back in a list that does not.
        """
        kept: dict[float, Path] = {}
        for time, file in self.entries:
            kept.setdefault(time, file)
        warnings = (*self._repeats(len(kept)), *self._steps_back(), *self._pace(sorted(kept)))
        return sorted(kept.items()), warnings

    def _repeats(self, different: int) -> tuple[str, ...]:
        repeats = len(self.entries) - different
        if not repeats:
            return ()
        first: dict[float, int] = {}
        place = next(k for k, (time, _) in enumerate(self.entries) if first.setdefault(time, k) != k)
        said = f"{self.path}: {repeats} of {len(self.entries)} lines repeat a time, first line {self.lines[place]}"
        if repeats > MOST_REPEATED * len(self.entries):
            raise IdRgbdoError(
                f"{said}, so these are not the times of the images; write the times in full, or {NUMBER_FRAMES}"
            )
        return (f"{said}; the first of equal times is taken",)

    def _steps_back(self) -> tuple[str, ...]:
        """Names in order while the times are not: the clock was set back. To be just not sorted is no fault."""
        times = [time for time, _ in self.entries]
        steps = [(b - a, k) for k, (a, b) in enumerate(pairwise(times), start=1)]
        back = [(step, k) for step, k in steps if step < 0]
        names = [_natural(file) for _, file in self.entries]
        if not back or names != sorted(names):
            return ()
        step, place = min(back)
        said = (
            f"{self.path}: the times run backwards at line {self.lines[place]}, by {-step:.6g} s, "
            "while the names of the images go on"
        )
        if -step > STEP_BACK_S:
            raise IdRgbdoError(f"{said}; was the clock set? Correct the times, or {NUMBER_FRAMES}")
        return (f"{said}; the frames are taken in the order of their times",)

    def _pace(self, times: Sequence[float]) -> tuple[str, ...]:
        """Whole numbers that count the frames, or milliseconds from 0 on, look like seconds but are none."""
        doubt = doubtful_seconds(times) if self.unit == "seconds" else None
        if doubt is None:
            return ()
        gap, guess = doubt
        return (
            f"{self.path}: the times are whole numbers {gap:g} apart and are taken as seconds; if they are {guess}, "
            "write seconds",
        )


def read_list(path: Path) -> ImageList:
    """The lines `timestamp file`. Raises IdRgbdoError, naming the line, for anything else."""
    return _columns(path, 2)[0]


def read_pairs(path: Path) -> tuple[ImageList, ImageList]:
    """The lines `timestamp file timestamp file`. Raises IdRgbdoError, naming the line, for anything else."""
    first, second = _columns(path, 4)
    return first, second


def _columns(path: Path, columns: int) -> list[ImageList]:
    """One list for each two columns."""
    lines = _lines(path, columns)
    lists = []
    for k in range(0, columns, 2):
        values = [_number(path, number, fields[k]) for number, fields in lines]
        unit = unit_of(values)
        if unit is None:
            raise IdRgbdoError(
                f"{path}: expected times, got {lines[0][1][k]} and so on, one by one, which are numbers of images; "
                f"{NUMBER_FRAMES}"
            )
        entries = [(in_seconds(value, unit), fields[k + 1]) for value, (_, fields) in zip(values, lines, strict=True)]
        files = [(time, _file(path, name)) for time, name in entries]
        lists.append(ImageList(files, unit, path, [number for number, _ in lines]))
    return lists


def _lines(path: Path, columns: int) -> list[tuple[int, list[str]]]:
    """Line numbers and fields, without comments and a header. Raises IdRgbdoError for other columns, or no line."""
    text = read_text(path, "sequence")
    numbered = [(number, line.strip()) for number, line in enumerate(text.splitlines(), start=1)]
    lines = [(number, line) for number, line in numbered if line and not line.startswith(("#", "//", "%"))]
    if len(lines) > 1 and not any(letter.isdigit() for letter in lines[0][1]):  # a header
        lines = lines[1:]
    if not lines:
        raise IdRgbdoError(f"sequence: '{path}' lists no image; expected lines `timestamp file`")
    split = [(number, _fields(line, columns)) for number, line in lines]
    for number, fields in split:
        if len(fields) != columns:
            expected = " ".join(["timestamp file"] * (columns // 2))
            raise IdRgbdoError(
                f"{path}, line {number}: expected `{expected}`, got {len(fields)} fields; correct the line"
            )
    return split


def _fields(line: str, columns: int) -> list[str]:
    """The fields of a line: by semicolons, blanks or commas, where names of images may hold blanks."""
    if ";" in line:
        fields = [field.strip() for field in line.split(";") if field.strip()]
    else:
        fields = line.split()
        decimal_commas = all(DECIMAL_COMMA.fullmatch(field) for field in fields[::2])
        if not (len(fields) == columns and decimal_commas):
            commas = [field.strip() for field in line.split(",") if field.strip()]
            apart = [field for part in fields for field in part.split(",") if field]
            fields = commas if len(commas) == columns else apart
    fields = [field.strip("\"'") for field in fields]
    return fields if len(fields) == columns else _with_blanks(fields, columns)


def _with_blanks(fields: list[str], columns: int) -> list[str]:
    """A time, then a name up to the field that ends like an image; the fields as they are where that does not fit."""
    joined: list[str] = []
    rest = list(fields) if len(fields) <= MOST_FIELDS else []
    while rest:
        joined.append(rest.pop(0))
        end = next((k for k, field in enumerate(rest) if NAME.search(field)), None)
        if end is None:
            break
        joined.append(" ".join(rest[: end + 1]))
        rest = rest[end + 1 :]
    return joined if len(joined) == columns and not rest else fields


def _number(path: Path, number: int, field: str) -> float:
    """A time as it is written; whole numbers keep all their digits."""
    said = f"{path}, line {number}: expected a timestamp, got '{shown(field, quoted=False)}'; correct the line"
    try:
        plain = field.replace(",", ".")
        value = int(plain) if plain.isdecimal() else float(plain)
    except ValueError as error:
        raise IdRgbdoError(said) from error
    if not abs(value) < LATEST:  # nor NaN
        raise IdRgbdoError(said)
    return value


def _file(path: Path, name: str) -> Path:
    """The file that a list names, beside the list.

    Where it is not there: the end of its path, as another machine's or Windows' list has it, or a file in the folder
    that is named like the list.
    """
    beside = path.parent / name
    if os.path.exists(beside) or len(name) > LONGEST_PATH:
        return beside
    parts = [part for part in re.split(r"[\\/]", name) if part not in ("", ".")]
    places = [path.parent.joinpath(*parts[k:]) for k in range(len(parts))]
    places.append(path.parent / path.stem / parts[-1] if parts else beside)
    return next((place for place in places if os.path.exists(place)), beside)


def _natural(file: Path) -> list[tuple[int, str]]:
    """A key that sorts names as people do: image9 before image10. Numbers may have any length."""
    parts = [part for part in re.split(r"(\d+)", file.name) if part]
    numbers = [part.lstrip("0") if part.isdecimal() else None for part in parts]
    return [
        (-1, part) if number is None else (len(number), number) for part, number in zip(parts, numbers, strict=True)
    ]
