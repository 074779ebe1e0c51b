"""What every attack checks: a public door answers or raises IdRgbdoError with a sentence, soon, in little memory."""

from __future__ import annotations

import resource
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TypeVar

from numpy.random import Generator

from idrgbdo_torch.errors import IdRgbdoError

MOST_S = 10  # of the processor
WAITING = 12  # times as long may it take on a busy machine, or wait for something
MOST_BYTES = 1 << 30  # that the peak of this process may rise by in one attack
Value = TypeVar("Value")


@dataclass(frozen=True)
class Attack:
    """One kind of attack."""

    run: Callable[[Generator, Path], None]  # with an empty folder; raises whatever shows that a promise was broken
    every: int = 1  # of so many seeds that are its turn it is made for one: processes that are killed take seconds
    most_s: int = MOST_S  # of the processor
    ready: Callable[[], object] = lambda: None  # what is done before and counts for no attack, such as compiling


def refused(call: Callable[[], object]) -> IdRgbdoError | None:
    """The error with which a door refuses; None where it answers. Any other exception is a broken promise."""
    try:
        call()
    except IdRgbdoError as error:
        assert str(error) and len(str(error)) < 100_000, "an error without a sentence"
        return error
    return None


def fresh_peak() -> int:
    """The memory of this process in bytes, from which its peak is counted now, where the system allows that."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    return peak()


def peak() -> int:
    """The most memory that this process had, in bytes."""
    with suppress(OSError, StopIteration):
        lines = Path("/proc/self/status").read_text().splitlines()
        return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


@contextmanager
def limits(most_s: int, most_bytes: int = MOST_BYTES) -> Iterator[None]:
    """Raises TimeoutError in what hangs, MemoryError after what took too much."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"still at it after {most_s} s")

    before = {number: signal.signal(number, stop) for number in (signal.SIGALRM, signal.SIGPROF)}
    signal.alarm(WAITING * most_s)
    signal.setitimer(signal.ITIMER_PROF, most_s)
    begin, worked = time.monotonic(), time.process_time()
    least = fresh_peak()
    try:
        yield
    finally:
        signal.alarm(0)
        signal.setitimer(signal.ITIMER_PROF, 0)
        for number, handler in before.items():
            signal.signal(number, handler)
    # though what was attacked caught the TimeoutError, which is an OSError
    if time.process_time() - worked > most_s or time.monotonic() - begin > WAITING * most_s:
        raise TimeoutError(f"took {time.process_time() - worked:.0f} s of {time.monotonic() - begin:.0f} s")
    rise = peak() - least
    if rise > most_bytes:
        raise MemoryError(f"the peak of memory rose by {rise >> 20} MB")
