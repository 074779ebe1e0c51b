"""How the numbers in the names of images go on from one to the next."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from itertools import pairwise

from ..text.clock import LEAST_TICKS
from .names import gaps

MOST_STEPS_BACK = 0.1  # of a clock that was set; against what goes back more often, it is the other that counts nothing
NEAR_USUAL = 0.1  # of the usual gap, by which at least half of a clock's gaps differ at most


def tick_gap(numbers: Sequence[int]) -> float | None:
    """The usual gap of numbers that may be ticks of a clock: 8 or more, about alike, of no common stride."""
    steps = gaps(numbers)
    stride = math.gcd(*map(int, steps))
    if len(steps) < 2 or min(steps) <= 0:
        return None
    usual = statistics.median(steps)
    alike = sum(abs(step - usual) <= NEAR_USUAL * usual for step in steps)
    return usual if usual >= LEAST_TICKS * stride and 2 * alike >= len(steps) else None


def steps_back(numbers: Sequence[int], seconds: Sequence[float]) -> list[int]:
    """The places of the files whose time is before that of the file numbered before it."""
    ordered = sorted(range(len(numbers)), key=numbers.__getitem__)
    return [after for before, after in pairwise(ordered) if seconds[after] < seconds[before]]


def are_few(back: Sequence[int], numbers: Sequence[int]) -> bool:
    """Whether so few steps go back that the times are those of the numbered files, by a clock that was set."""
    return len(back) <= max(1, MOST_STEPS_BACK * len(numbers))
