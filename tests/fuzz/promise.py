"""What every attack checks: a public door answers or raises IdRgbdoError with a sentence, soon, in little memory."""

from __future__ import annotations

import resource
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TypeVar

from numpy.random import Generator

from idrgbdo_torch.errors import IdRgbdoError

MOST_S = 10
MOST_BYTES = 1 << 30  # that the peak of this process may rise by in one attack
Value = TypeVar("Value")


@dataclass(frozen=True)
class Attack:
    """One kind of attack."""

    run: Callable[[Generator, Path], None]  # with an empty folder; raises whatever shows that a promise was broken
    every: int = 1  # of so many seeds that are its turn it is made for one: processes that are killed take seconds
    most_s: int = MOST_S


def refused(call: Callable[[], object]) -> IdRgbdoError | None:
    """The error with which a door refuses; None where it answers. Any other exception is a broken promise."""
    try:
        call()
    except IdRgbdoError as error:
        assert str(error) and len(str(error)) < 100_000, "an error without a sentence"
        return error
    return None


@contextmanager
def limits(most_s: int) -> Iterator[None]:
    """Raises TimeoutError in what hangs, MemoryError after what took too much."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"still at it after {most_s} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(most_s)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    rise = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak)
    if rise > MOST_BYTES:
        raise MemoryError(f"the peak of memory rose by {rise >> 20} MB")
