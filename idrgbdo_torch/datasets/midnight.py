"""Times of day, of which those after midnight are the smaller ones."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from itertools import pairwise

DAY_S = 86400.0


def over_midnight(seconds: Sequence[float]) -> list[float]:
    """Times of day (s) in which the recording goes on after midnight: half a day without images is the rest of it."""
    ordered = sorted(seconds)
    evening = next((after for before, after in pairwise(ordered) if after - before > DAY_S / 2), ordered[0])
    return [time if time >= evening else time + DAY_S for time in seconds]


def day_beside(seconds: Sequence[float], others: Sequence[float]) -> list[float]:
    """Times of day (s), a day later where the others', of the same recording, are more than half a day ahead."""
    behind = statistics.median(others) - statistics.median(seconds) > DAY_S / 2
    return [time + DAY_S for time in seconds] if behind else list(seconds)
