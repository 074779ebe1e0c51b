"""What unit the timestamps of a file are in: seconds, or milliseconds, microseconds, nanoseconds read as such."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

UNITS = {"milliseconds": 10**3, "microseconds": 10**6, "nanoseconds": 10**9}  # ticks per second
NO_SECONDS = 1e11  # no clock that counts seconds has got so far
NO_STEP_S = 1e4  # nor do two poses or images lie so far apart
SINCE_1970_S = (6.3e8, 4.1e9)  # the years 1990 to 2099
USUAL_STEP_S = 0.05  # between images
LEAST_TICKS = 8  # ms between images; numbers that grow by less count something else


def unit_of(stamps: Sequence[float]) -> str | None:
    """The unit of the stamps of a file, "seconds" or one of UNITS; None where they are no clock, such as ids.

    A number above 1e11 is no time in seconds: the unit is the one that makes it a date of our time, else (a clock that
    began at some start) the one that makes the steps most like those of a camera.
    """
    inside = sorted(stamps)
    steps = sorted(b - a for a, b in pairwise(inside) if b > a)
    step = steps[len(steps) // 2] if steps else 0
    last = abs(inside[-1]) if inside else 0
    if last <= NO_SECONDS and step <= NO_STEP_S:
        return "seconds"
    low, high = SINCE_1970_S
    for name, ticks in UNITS.items():
        if low <= last / ticks <= high and step / ticks <= NO_STEP_S:
            return name
    if len(inside) > 1 and step < 2:  # one by one: ids
        return None
    return min(UNITS, key=lambda name: abs(math.log(max(step, 1) / UNITS[name] / USUAL_STEP_S)))


def doubtful_seconds(times: Sequence[float]) -> tuple[float, str] | None:
    """The usual step and what increasing times (s) may be instead, "numbers of frames" or "milliseconds" from 0 on.

    None for those that are seconds by all appearances.
    """
    gaps = sorted(b - a for a, b in pairwise(times))
    if len(gaps) < 2 or any(time % 1 for time in times):
        return None
    gap = gaps[len(gaps) // 2]
    if gap == 1 and times[0] < 1e6:
        return gap, "numbers of frames"
    return (gap, "milliseconds") if LEAST_TICKS <= gap < 1000 and times[0] < SINCE_1970_S[0] else None


def in_seconds(stamp: float, unit: str) -> float:
    """A stamp (an int where it has too many digits for a float) of a unit in seconds."""
    return stamp / UNITS[unit] if unit in UNITS else float(stamp)
