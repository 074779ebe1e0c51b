"""How long a frame is waited for: on an idle machine, and beside a busy process on every core."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import islice

import numpy as np
from endless import back_and_forth
from rendered import Film

from idrgbdo_torch import IdRgbdo

WORK = """
import os
parent = os.getppid()
while os.getppid() == parent:
    sum(range(10_000))
"""


@contextmanager
def busy_processes(count: int) -> Iterator[None]:
    """Python processes that do nothing but work."""
    others = [subprocess.Popen([sys.executable, "-c", WORK]) for _ in range(count)]
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()


def spent(odometry: IdRgbdo, frames: Iterator[object], count: int) -> np.ndarray:
    """(count, 2) ms of every frame: waited, and of the thread on the processor."""
    out = []
    for frame in islice(frames, count):
        begin, busy = time.perf_counter_ns(), time.thread_time_ns()
        odometry.track(frame)  # type: ignore[arg-type]
        out.append((time.perf_counter_ns() - begin, time.thread_time_ns() - busy))
    return np.array(out) / 1e6


def test_a_frame_is_not_waited_for_long_beside_busy_processes(
    full: bool, footage: Film, show: Callable[[str], None], ratio: Callable[[str, float], None]
) -> None:
    odometry, frames = IdRgbdo(), back_and_forth(footage.frames)
    count = 600 if full else 4
    spent(odometry, frames, 60 if full else 2)
    for name, others in (("idle", 0), ("a busy process a core", (os.cpu_count() or 1) if full else 1)):
        with busy_processes(others):
            ms = spent(odometry, frames, count)
        waited = ", ".join(f"{value:.2f}" for value in np.percentile(ms[:, 0], [50, 95, 99]))
        worked = ", ".join(f"{value:.2f}" for value in np.percentile(ms[:, 1], [50, 95, 99]))
        show(f"{name}: waited {waited} ms (median, 95 %, 99 %), of the processor {worked} ms")
        ratio(f"latency: median wall over processor time, {name}", float(np.divide(*np.median(ms, axis=0))))
