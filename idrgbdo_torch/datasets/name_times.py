"""The times in the names of a folder of images."""

from __future__ import annotations

import calendar
import math
import re
import statistics
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise
from pathlib import Path

from ..text.clock import LEAST_TICKS, NO_SECONDS, UNITS, in_seconds, unit_of
from .midnight import over_midnight
from .names import EPOCH_S, Names, counts, gaps, is_epoch, is_fraction, varying
from .number_steps import are_few, steps_back, tick_gap

SHORTEST_GAP_S = 2e-3  # no depth camera is faster; what counts faster is a counter
FLOAT_DECIMALS = 7  # that a float of seconds since 1970 has
MUCH_EVENER = 2.0  # times: what an unlikely reading of digits must gain
SLOWEST_GAP_S = 3600.0  # of a time lapse
CAMERA_GAPS_S = (2e-3, 1.999)  # of a camera that films; narrow enough for one unit alone to fit
MOST_BETWEEN = 3.0  # times the usual gap, from one second to the next
FARTHEST_PICKED = 8000  # frames apart; numbers that are farther apart are ticks of a clock
FRACTIONS = {3: "milliseconds", 6: "microseconds", 9: "nanoseconds"}  # by the digits of a part of a second
OF_DAY = "time of day"  # the kind of times without a date
DATE = re.compile(
    r"(?<!\d)(?P<day>\d{4}[-_.:]?\d\d[-_.:]?\d\d)[-_.T ]{0,3}"
    r"(\d\d)[-_.:h]?(\d\d)[-_.:m]?(\d\d)(?:s?[-_.,:]?(\d{1,9}))?(?!\d)"
)
TIME_OF_DAY = re.compile(r"(?<!\d)(?P<day>)(\d\d)[-_.:h](\d\d)[-_.:m](\d\d)s?[-_.,:](\d{3,9})(?!\d)")


@dataclass(frozen=True)
class Times:
    """The times in the names of a folder's images."""

    seconds: list[float]  # one a file
    kind: str  # what stands in the names, for people
    columns: tuple[int, ...]  # of the names that they were read from


def times_in(names: Names) -> Times | None:
    """The times that the names surely are: of a date, since 1970, seconds with a fraction, a counter beside a clock."""
    if not names.files:
        return None
    for reading in READINGS:
        for times in reading(names):
            if _possible(times.seconds):
                return times
    return None


def ticks_in(names: Names) -> Times | None:
    """The times of names that are one number each which grows as a clock does: unevenly, at the pace of a camera.

    So do the numbers of picked frames; so this is for images whose numbers do not belong together.
    """
    places = varying(names)
    return _clock(names, places[0]) if len(places) == 1 and len(names.files) > 2 else None


def set_back(names: Names, times: Times) -> Path | None:
    """The first image whose time is before that of the image numbered before it: the clock was set back there."""
    for place in varying(names):
        numbers = [int(field) for field in names.columns[place]]
        if place in times.columns or is_fraction(names, place) or not counts(numbers):
            continue
        back = steps_back(numbers, times.seconds)
        if back and are_few(back, numbers):
            return names.files[back[0]]
    return None


def long_gap(times: Times) -> float | None:
    """The usual gap of seconds that count from some start, where it is so long that they may be milliseconds."""
    if times.kind != "seconds" or len(times.seconds) < 3 or max(times.seconds) >= EPOCH_S[0]:
        return None
    usual = statistics.median(gaps(times.seconds))
    return usual if usual >= LEAST_TICKS else None


def _possible(seconds: Sequence[float]) -> bool:
    """Whether these are the times of frames: all different, and neither faster nor slower than cameras are."""
    steps = gaps(seconds)
    if not steps:
        return True
    return min(steps) > 0 and SHORTEST_GAP_S <= statistics.median(steps) <= SLOWEST_GAP_S


def _unevenness(seconds: Sequence[float]) -> float:
    """How far the gaps are from being alike; two readings of the same names differ by much."""
    steps = gaps(seconds)
    if not steps or min(steps) <= 0:
        return math.inf
    middle = statistics.median(steps)
    return sum(abs(math.log(step / middle)) for step in steps) / len(steps)


def _parts_of_a_second(fields: Sequence[str]) -> list[tuple[str, list[float]]]:
    """What digits behind whole seconds may mean: ticks whose leading zeros are written or not, or decimals."""
    lengths = {len(field) for field in fields}
    readings = [("decimals", [int(field) / 10 ** len(field) for field in fields])]
    digits = next((digits for digits in FRACTIONS if max(lengths) <= digits), None)
    if digits is not None and (len(lengths) > 1 or max(lengths) == digits or len(fields) == 1):
        unit = FRACTIONS[digits]
        readings.insert(0, (unit, [in_seconds(int(field), unit) for field in fields]))
    return readings


def _evenest(
    kind: str, columns: tuple[int, ...], whole: Sequence[float], fields: Sequence[str], point: bool = False
) -> Iterator[Times]:
    """Whole seconds and the reading of the digits behind them that makes the frames come evenly.

    columns: of the names that hold both.
    point: whether a decimal point stands between them, so that decimals are likelier than ticks.
    """
    readings = [
        Times([s + part for s, part in zip(whole, parts, strict=True)], f"{kind} and {unit}", columns)
        for unit, parts in _parts_of_a_second(fields)
    ]
    likely, *others = reversed(readings) if point else readings
    yield min((likely, *others), key=lambda times: _unevenness(times.seconds) * (1 if times is likely else MUCH_EVENER))


def _dates(names: Names) -> Iterator[Times]:
    """Date and time of day (taken for UTC), with or without a part of a second; or the time of day with one."""
    for pattern, kind in ((DATE, "date, time"), (TIME_OF_DAY, OF_DAY)):
        found = [pattern.search(path.stem) for path in names.files]
        moments = [_moment(match) for match in found if match is not None]
        whole = [moment for moment in moments if moment is not None]
        if len(whole) < len(found):
            continue
        if kind == OF_DAY:
            whole = over_midnight(whole)
        parts = [match[5] for match in found if match is not None]
        columns = next(_columns_of(match) for match in found if match is not None)
        if all(part is None for part in parts):
            if not (whole[0] % 86400 < 60 and set(gaps(whole)) == {1.0}):  # a date and a counter from 000000 on
                yield Times(whole, kind, columns)
        else:
            yield from _evenest(kind, columns, whole, [part or "0" for part in parts])


def _columns_of(match: re.Match[str]) -> tuple[int, ...]:
    """The places of the digits of a match among all digits of a name."""
    first = len(re.findall(r"\d+", match.string[: match.start()]))
    return tuple(range(first, first + len(re.findall(r"\d+", match[0]))))


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
    for place, column in enumerate(names.columns):
        values = [int(field) for field in column]
        unit = unit_of(values) if min(values) >= NO_SECONDS else None
        if unit is not None:
            yield Times([in_seconds(value, unit) for value in values], unit, (place,))


def _whole_seconds(names: Names) -> Iterator[Times]:
    """A number of seconds since 1970."""
    for place, column in enumerate(names.columns):
        if all(is_epoch(field) for field in column):
            yield Times([float(field) for field in column], "seconds", (place,))


def _seconds_and_fraction(names: Names) -> Iterator[Times]:
    """`SECS_NSECS` and its like: seconds since 1970, or a column that stays while the next one counts their parts."""
    for place, (a, b) in enumerate(pairwise(names.columns), start=1):
        digits = max(len(field) for field in b)
        if digits > 9:
            continue
        point = names.between[place] == "."
        stays = len(set(a)) < len(a) and (
            digits in (6, 9) or ((digits == 3 or (point and digits > 3)) and _starts_again(a, b))
        )
        if all(is_epoch(field) for field in a) or stays:
            likely = point and digits <= FLOAT_DECIMALS
            yield from _evenest("seconds", (place - 1, place), [float(field) for field in a], b, likely)


def _starts_again(whole: Sequence[str], parts: Sequence[str]) -> bool:
    """Whether one number goes on by ones, and the other one starts again meanwhile, as parts of a second do.

    Between the last part of a second and the first one of the next no more time goes by than usual: else these are
    numbers of frames beside those of a room or a camera.
    """
    ordered = sorted((int(a), int(b)) for a, b in zip(whole, parts, strict=True))
    if not counts(sorted({a for a, _ in ordered})):
        return False
    steps = pairwise((a, a + b / 10 ** max(map(len, parts))) for a, b in ordered)
    gaps_of = [(after[0] > before[0], after[1] - before[1]) for before, after in steps]
    over = [gap for goes_over, gap in gaps_of if goes_over]
    usual = statistics.median(gap for _, gap in gaps_of)
    return bool(over) and statistics.median(over) <= MOST_BETWEEN * usual


def _decimals(names: Names) -> Iterator[Times]:
    """Nothing but a decimal number of seconds."""
    if names.between == ("", ".", ""):
        yield _with_decimals(names, 1)


def _decimals_behind_words(names: Names) -> Iterator[Times]:
    """A decimal number of seconds among words, with three decimals or more."""
    for place in range(1, len(names.columns)):
        if _are_decimals(names, place):
            yield _with_decimals(names, place)


def _with_decimals(names: Names, place: int) -> Times:
    whole, part = names.columns[place - 1], names.columns[place]
    return Times([float(f"{a}.{b}") for a, b in zip(whole, part, strict=True)], "seconds", (place - 1, place))


def _are_decimals(names: Names, place: int) -> bool:
    """Whether digits behind a point are decimals, not a number of their own as in `cam0.001` and `v1.2.001`."""
    before, part = names.columns[place - 1], names.columns[place]
    if names.between[place] != ".":
        return False
    apart = names.between[place - 1][-1:].isalpha() or "." in (names.between[place - 1][-1:], names.between[place + 1])
    digits = {len(field) for field in part}
    if apart or len(digits) > 1 or min(digits) < 3:
        return False
    if len(set(before)) == 1:  # the first second, or a number of a take
        ticks, unit = tick_gap([int(field) for field in part]), FRACTIONS.get(min(digits))
        return ticks is not None and unit is not None and in_seconds(ticks, unit) >= LEAST_TICKS / 1e3
    if len(set(before)) < len(before):  # several frames a second, or a room
        return _starts_again(before, part)
    return not counts([int(field) for field in before])


def _beside_a_counter(names: Names) -> Iterator[Times]:
    """`NUMBER-MICROSECONDS`: one place counts the frames by one, another goes on at the pace of a camera's clock."""
    places = varying(names)
    numbers = {k: [int(field) for field in names.columns[k]] for k in places if not is_fraction(names, k)}
    counters = {k: column for k, column in numbers.items() if counts(column)}
    for place in places:
        others = [column for k, column in counters.items() if k != place]
        clock = _clock(names, place, uneven=False) if others else None
        if clock and any(are_few(steps_back(column, clock.seconds), column) for column in others):
            yield clock


def _from_a_start(names: Names) -> Iterator[Times]:
    """Micro- or nanoseconds from some start: numbers too far apart for frames."""
    places = [place for place in varying(names) if not is_fraction(names, place)]
    values = [int(field) for field in names.columns[places[0]]] if len(places) == 1 else []
    if len(values) > 2 and min(values) < NO_SECONDS and statistics.median(gaps(values)) >= FARTHEST_PICKED:
        clock = _clock(names, places[0], uneven=False)
        if clock is not None:
            yield clock


def _clock(names: Names, place: int, uneven: bool = True) -> Times | None:
    """The times of a column whose numbers grow at the pace of a camera in one unit."""
    values = [int(field) for field in names.columns[place]]
    steps = gaps(values)
    if not steps or min(steps) <= 0 or (uneven and min(steps) == max(steps)):
        return None
    gap = statistics.median(steps)
    if gap < LEAST_TICKS:  # a counter with a stride
        return None
    for unit, ticks in UNITS.items():
        if CAMERA_GAPS_S[0] <= gap / ticks <= CAMERA_GAPS_S[1]:
            return Times([value / ticks for value in values], unit, (place,))
    return None


READINGS = (  # the surest first
    _dates,
    _ticks,
    _seconds_and_fraction,
    _decimals,
    _whole_seconds,
    _beside_a_counter,
    _decimals_behind_words,
    _from_a_start,
)
