"""What the names in a folder of images say: the time of each image, or its number."""

from __future__ import annotations

import calendar
import math
import re
import statistics
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise
from pathlib import Path

from ..text.clock import NO_SECONDS, UNITS, in_seconds, unit_of

STRAYS = 0.2  # at most this share of a folder's images may be named unlike the rest
SHORTEST_GAP_S = 2e-3  # no depth camera is faster; what counts faster is a counter
EPOCH_S = (9.4e8, 4.2e9)  # 1999 to 2103: seconds since 1970 of ten digits
FLOAT_DECIMALS = 7  # that a float of seconds since 1970 has
MUCH_EVENER = 2.0  # times: what an unlikely reading of digits must gain
SLOWEST_GAP_S = 3600.0  # of a time lapse
CAMERA_GAPS_S = (2e-3, 1.999)  # of a camera that films; narrow enough for one unit alone to fit
FRACTIONS = {3: "milliseconds", 6: "microseconds", 9: "nanoseconds"}  # by the digits of a part of a second
DATE = re.compile(
    r"(?<!\d)(?P<day>\d{4}[-_.:]?\d\d[-_.:]?\d\d)[-_.T ]{0,3}"
    r"(\d\d)[-_.:h]?(\d\d)[-_.:m]?(\d\d)(?:s?[-_.,:]?(\d{1,9}))?(?!\d)"
)
TIME_OF_DAY = re.compile(r"(?<!\d)(?P<day>)(\d\d)[-_.:h](\d\d)[-_.:m](\d\d)s?[-_.,:](\d{3,9})(?!\d)")

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
    return f"{whole}.0" if whole.isdecimal() and _is_epoch(whole) else path.stem


@dataclass(frozen=True)
class Times:
    """The times in the names of a folder's images."""

    seconds: list[float]  # one a file
    kind: str  # what stands in the names, for people


def times_in(names: Names) -> Times | None:
    """The times that the names surely are: of a date, since 1970, seconds with a fraction, a counter beside a clock."""
    if not names.files:
        return None
    for reading in (_dates, _ticks, _seconds_and_fraction, _decimals, _whole_seconds, _beside_a_counter):
        for times in reading(names):
            if _possible(times.seconds):
                return times
    return None


def ticks_in(names: Names) -> Times | None:
    """The times of names that are one number each which grows as a clock does: unevenly, at the pace of a camera.

    So do the numbers of picked frames; so this is for images whose numbers do not belong together.
    """
    varying = _varying(names)
    return _clock(names.columns[varying[0]]) if len(varying) == 1 and len(names.files) > 2 else None


def numbers_in(names: Names) -> list[list[int]]:
    """The numbers that each may stand for the frame: at one place in the names, all different; the last place first."""
    columns = names.columns if len(names.files) == 1 else [names.columns[k] for k in _varying(names)]
    return [[int(field) for field in column] for column in reversed(columns)]


def counts(numbers: Sequence[int]) -> bool:
    """Whether these count frames: all different, most of them one apart."""
    gaps = _gaps(numbers)
    return not gaps or (min(gaps) > 0 and statistics.median(gaps) == 1)


def set_back(names: Names, times: Times) -> Path | None:
    """The first image whose time is before that of the image numbered before it: the clock was set back there."""
    for column in (names.columns[k] for k in _varying(names)):
        numbers = [int(field) for field in column]
        if counts(numbers):
            ordered = sorted(zip(numbers, times.seconds, names.files, strict=True))
            for (_, before, _), (_, after, file) in pairwise(ordered):
                if after < before:
                    return file
    return None


def repeated(numbers: Sequence[int]) -> tuple[int, int] | None:
    """The places of two equal numbers, if there are such."""
    seen: dict[int, int] = {}
    for place, number in enumerate(numbers):
        if number in seen:
            return seen[number], place
        seen[number] = place
    return None


def _varying(names: Names) -> list[int]:
    return [k for k, column in enumerate(names.columns) if len(set(column)) > 1]


def _gaps(seconds: Sequence[float]) -> list[float]:
    ordered = sorted(seconds)
    return [b - a for a, b in pairwise(ordered)]


def _possible(seconds: Sequence[float]) -> bool:
    """Whether these are the times of frames: all different, and neither faster nor slower than cameras are."""
    gaps = _gaps(seconds)
    if not gaps:
        return True
    return min(gaps) > 0 and SHORTEST_GAP_S <= statistics.median(gaps) <= SLOWEST_GAP_S


def _unevenness(seconds: Sequence[float]) -> float:
    """How far the gaps are from being alike; two readings of the same names differ by much."""
    gaps = _gaps(seconds)
    if not gaps or min(gaps) <= 0:
        return math.inf
    middle = statistics.median(gaps)
    return sum(abs(math.log(gap / middle)) for gap in gaps) / len(gaps)


def _parts_of_a_second(fields: Sequence[str]) -> list[tuple[str, list[float]]]:
    """What digits behind whole seconds may mean: ticks whose leading zeros are written or not, or decimals."""
    lengths = {len(field) for field in fields}
    readings = [("decimals", [int(field) / 10 ** len(field) for field in fields])]
    digits = next((digits for digits in FRACTIONS if max(lengths) <= digits), None)
    if digits is not None and (len(lengths) > 1 or max(lengths) == digits or len(fields) == 1):
        unit = FRACTIONS[digits]
        readings.insert(0, (unit, [in_seconds(int(field), unit) for field in fields]))
    return readings


def _evenest(kind: str, whole: Sequence[float], fields: Sequence[str], point: bool = False) -> Iterator[Times]:
    """Whole seconds and the reading of the digits behind them that makes the frames come evenly.

    point: whether a decimal point stands between them, so that decimals are likelier than ticks.
    """
    readings = [
        Times([s + part for s, part in zip(whole, parts, strict=True)], f"{kind} and {unit}")
        for unit, parts in _parts_of_a_second(fields)
    ]
    likely, *others = reversed(readings) if point else readings
    yield min((likely, *others), key=lambda times: _unevenness(times.seconds) * (1 if times is likely else MUCH_EVENER))


def _dates(names: Names) -> Iterator[Times]:
    """Date and time of day (taken for UTC), with or without a part of a second; or the time of day with one."""
    for pattern, kind in ((DATE, "date, time"), (TIME_OF_DAY, "time of day")):
        found = [pattern.search(path.stem) for path in names.files]
        moments = [_moment(match) for match in found if match is not None]
        whole = [moment for moment in moments if moment is not None]
        if len(whole) < len(found):
            continue
        parts = [match[5] for match in found if match is not None]
        if all(part is None for part in parts):
            if not (whole[0] % 86400 < 60 and set(_gaps(whole)) == {1.0}):  # a date and a counter from 000000 on
                yield Times(whole, kind)
        else:
            yield from _evenest(kind, whole, [part or "0" for part in parts])


def _moment(match: re.Match[str]) -> float | None:
    """Seconds since 1970, or since midnight where there is no day; None where the digits are neither."""
    day = re.sub(r"\D", "", match["day"]) or "20000101"
    try:
        date = datetime.strptime(day + match[2] + match[3] + match[4], "%Y%m%d%H%M%S")
    except ValueError:
        return None
    if not match["day"]:
        return 3600.0 * date.hour + 60 * date.minute + date.second
    return float(calendar.timegm(date.timetuple())) if 1990 <= date.year < 2100 else None


def _ticks(names: Names) -> Iterator[Times]:
    """A number of milli-, micro- or nanoseconds since 1970, or since the machine's start where it is large."""
    for column in names.columns:
        values = [int(field) for field in column]
        unit = unit_of(values) if min(values) >= NO_SECONDS else None
        if unit is not None:
            yield Times([in_seconds(value, unit) for value in values], unit)


def _whole_seconds(names: Names) -> Iterator[Times]:
    """A number of seconds since 1970."""
    for column in names.columns:
        if all(_is_epoch(field) for field in column):
            yield Times([float(field) for field in column], "seconds")


def _is_epoch(field: str) -> bool:
    return len(field) == 10 and EPOCH_S[0] <= int(field) <= EPOCH_S[1]


def _seconds_and_fraction(names: Names) -> Iterator[Times]:
    """`SECS_NSECS` and its like: seconds since 1970, or a column that stays while the next one counts their parts."""
    for place, (a, b) in enumerate(pairwise(names.columns), start=1):
        if max(len(field) for field in b) > 9:
            continue
        stays = len(set(a)) < len(a) and max(len(field) for field in b) in (6, 9)
        if all(_is_epoch(field) for field in a) or stays:
            point = names.between[place] == "." and max(len(field) for field in b) <= FLOAT_DECIMALS
            yield from _evenest("seconds", [float(field) for field in a], b, point)


def _decimals(names: Names) -> Iterator[Times]:
    """Nothing but a decimal number of seconds."""
    if names.between == ("", ".", ""):
        whole, part = names.columns
        yield Times([float(f"{a}.{b}") for a, b in zip(whole, part, strict=True)], "seconds")


def _beside_a_counter(names: Names) -> Iterator[Times]:
    """`NUMBER-MICROSECONDS`: one place counts the frames by one, another goes on at the pace of a camera's clock."""
    varying = _varying(names)
    for place in varying:
        counted = any(counts([int(field) for field in names.columns[k]]) for k in varying if k != place)
        clock = _clock(names.columns[place], uneven=False) if counted else None
        if clock is not None:
            yield clock


def _clock(column: Sequence[str], uneven: bool = True) -> Times | None:
    """The times of numbers that grow at the pace of a camera in one unit."""
    values = [int(field) for field in column]
    gaps = _gaps(values)
    if not gaps or min(gaps) <= 0 or (uneven and min(gaps) == max(gaps)):
        return None
    gap = statistics.median(gaps)
    if gap < 8:  # ms, more than a hundred frames a second: a counter with a stride
        return None
    for unit, ticks in UNITS.items():
        if CAMERA_GAPS_S[0] <= gap / ticks <= CAMERA_GAPS_S[1]:
            return Times([value / ticks for value in values], unit)
    return None
