"""Tasks for the tests of the sweep, in a module so that other processes can import them."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Job:
    """A number to square, and where calls are counted."""

    number: int
    log: Path
    trouble: str = ""


def square(job: Job) -> dict[str, Any]:
    """number^2; counts its calls, and does what its trouble says."""
    with (job.log / str(job.number)).open("a") as file:
        file.write("x")
    calls = len((job.log / str(job.number)).read_text())
    if job.trouble == "always":
        raise RuntimeError("it never\nworks")
    if job.trouble == "once" and calls == 1:
        raise ValueError("the first time")
    if job.trouble == "kill" or (job.trouble == "kill once" and calls == 1):
        os.kill(os.getpid(), signal.SIGKILL)
    if job.trouble == "slow":
        time.sleep(0.4)
    return {"square": job.number**2, "threads": os.environ.get("OMP_NUM_THREADS")}


def calls_of(log: Path) -> dict[int, int]:
    """How often each number was squared."""
    return {int(path.name): len(path.read_text()) for path in log.iterdir()}
