"""What the names in a folder of images are made of, and the numbers in them."""

from __future__ import annotations

import re
import statistics
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

STRAYS = 0.2  # at most this share of a folder's images may be named unlike the rest
EPOCH_S = (9.4e8, 4.2e9)  # 1999 to 2103: seconds since 1970 of ten digits

Columns = list[list[str]]  # the digits at each place of the names that have digits; (columns, names)


@dataclass(frozen=True)
class Names:
    """The images of a folder whose names are built alike."""

    files: list[Path]
    columns: Columns
    between: tuple[str, ...]  # what stands before, between and behind the columns
    strays: tuple[Path, ...] = ()  # named unlike the rest


def read_names(files: Sequence[Path]) -> Names:
    """Sort out the few files that are named unlike the rest; where most are, all are known by their last number."""
    shapes = {path: tuple(re.split(r"\d+", _stem(path))) for path in files}
    counts = Counter(shapes.values()).most_common(1)
    if counts and 0 < len(files) - counts[0][1] <= max(1, STRAYS * len(files)) < counts[0][1]:
        strays = tuple(path for path in files if shapes[path] != counts[0][0])
        files = [path for path in files if shapes[path] == counts[0][0]]
        return Names(list(files), _columns(files), counts[0][0], strays)
    if counts and counts[0][1] == len(files):
        return Names(list(files), _columns(files), counts[0][0])
    last = [(re.findall(r"\d+", path.stem)[-1:], path) for path in files]
    known = [(number[0], path) for number, path in last if number]
    return Names([path for _, path in known], [[number for number, _ in known]] if known else [], ("", ""))


def _columns(files: Sequence[Path]) -> Columns:
    return [list(column) for column in zip(*(re.findall(r"\d+", _stem(path)) for path in files), strict=True)]


def _stem(path: Path) -> str:
    """The name without suffix; a whole number of seconds since 1970 with the point that its neighbours have."""
    whole = path.stem.removesuffix(".")
    return f"{whole}.0" if whole.isdecimal() and is_epoch(whole) else path.stem


def is_epoch(field: str) -> bool:
    """Whether these digits are a number of seconds since 1970."""
    return len(field) == 10 and EPOCH_S[0] <= int(field) <= EPOCH_S[1]


def numbers_in(names: Names, of_times: Collection[int] = ()) -> list[list[int]]:
    """The numbers that each may stand for the frame, one a file: at one place in the names, the likeliest place first.

    of_times: the columns that are known to be times.
    A counter counts by one, and goes on as the names do when they are read from left to right; else the last is likely.
    """
    places = range(len(names.columns)) if len(names.files) == 1 else varying(names)
    choices = [(k, [int(field) for field in names.columns[k]]) for k in places if k not in of_times]
    in_order = sorted(range(len(names.files)), key=lambda file: [int(column[file]) for column in names.columns])

    def likely(choice: tuple[int, list[int]]) -> tuple[bool, bool, bool, int]:
        place, numbers = choice
        goes_on = all(numbers[a] < numbers[b] for a, b in pairwise(in_order))
        return not is_fraction(names, place), counts(numbers), goes_on, place

    return [numbers for _, numbers in sorted(choices, key=likely, reverse=True)]


def counts(numbers: Sequence[int]) -> bool:
    """Whether these count frames: all different, most of them one apart."""
    steps = gaps(numbers)
    return not steps or (min(steps) > 0 and statistics.median(steps) == 1)


def is_fraction(names: Names, place: int) -> bool:
    """Whether a column stands behind the decimal point of another one that goes on with the frames."""
    return place > 0 and names.between[place] == "." and len(set(names.columns[place - 1])) > 1


def repeated(numbers: Sequence[int]) -> tuple[int, int] | None:
    """The places of two equal numbers, if there are such."""
    seen: dict[int, int] = {}
    for place, number in enumerate(numbers):
        if number in seen:
            return seen[number], place
        seen[number] = place
    return None


def varying(names: Names) -> list[int]:
    """The columns that are not the same in all names."""
    return [k for k, column in enumerate(names.columns) if len(set(column)) > 1]


def gaps(values: Sequence[float]) -> list[float]:
    """The steps from each value to the next larger one."""
    ordered = sorted(values)
    return [b - a for a, b in pairwise(ordered)]
