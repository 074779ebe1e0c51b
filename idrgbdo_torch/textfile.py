"""Text as people's programs write it: how it is encoded, and in which unit its times are."""

from __future__ import annotations

import codecs
import statistics
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

UNITS = {1.0: "seconds", 1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}  # by ticks per second
SECONDS_BELOW = 1e11  # the year 5138; in milliseconds it was 1973
EPOCH_S = (9.4e8, 4.2e9)  # 1999 to 2103: what a clock that counts from 1970 can show
GAPS_S = (1e-3, 3600.0)  # between two frames, the slowest time lapse included
CAMERA_GAPS_S = (1e-3, 0.5)  # of a camera that films; narrow enough for one unit alone to fit


def read_text(path: Path) -> str:
    """The text of a file in UTF-8 or UTF-16 (as PowerShell's `>` writes), with or without a byte order mark.

    Raises OSError, or UnicodeDecodeError for bytes that are neither.
    """
    data = path.read_bytes()
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16")
    for encoding, zeros in (("utf-16-le", data[1:400:2]), ("utf-16-be", data[:400:2])):
        if zeros and zeros.count(0) > 0.5 * len(zeros):  # digits and Latin letters have a byte 0 there
            return data.decode(encoding)
    return data.decode("utf-8-sig")


def ticks_per_second(stamps: Sequence[float]) -> float:
    """The unit of time stamps as ticks per second: 1 (seconds), 1e3, 1e6 or 1e9.

    Large numbers are ticks since 1970 where that gives a date and a possible pace; where it does not (a clock that
    counts from the start of the machine), the unit is the one in which the pace is a camera's.
    """
    if not stamps:
        return 1.0
    ordered = sorted(set(stamps))
    gap = statistics.median([b - a for a, b in pairwise(ordered)] or [0.0])
    largest = ordered[-1]
    if largest < SECONDS_BELOW and gap < 1000:
        return 1.0
    for ticks in (1e3, 1e6, 1e9):
        dated = EPOCH_S[0] <= largest / ticks <= EPOCH_S[1]
        if dated and (gap == 0 or GAPS_S[0] <= gap / ticks <= GAPS_S[1]):
            return ticks
    for ticks in (1e3, 1e6, 1e9):
        if gap and CAMERA_GAPS_S[0] <= gap / ticks <= CAMERA_GAPS_S[1]:
            return ticks
    if largest < SECONDS_BELOW:
        return 1.0
    return 1e3 if largest < 1e14 else 1e6 if largest < 1e17 else 1e9
