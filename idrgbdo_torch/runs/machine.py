"""The machine that something was measured on: its name, and what it says of a process's memory and of energy."""

from __future__ import annotations

import os
import platform
import sys
from functools import cache
from pathlib import Path


@cache
def machine_name() -> str:
    """Processor, cores, system and Python: what times depend on."""
    name = platform.processor()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        models = [line for line in cpuinfo.read_text().splitlines() if line.startswith("model name")]
        name = models[0].partition(":")[2].strip() if models else name
    return (
        f"{name or platform.machine()}, {os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}"
    )


def peak_memory_mb() -> float | None:
    """The most memory this process ever held, MB; None where the system does not say."""
    status = Path("/proc/self/status")
    if status.exists():  # getrusage would include what the parent held before this process began
        lines = [line.split() for line in status.read_text().splitlines() if line.startswith("VmHWM")]
        return float(lines[0][1]) / 1024 if lines else None
    if sys.platform == "win32":
        return None
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024**2 if sys.platform == "darwin" else 1024)


class EnergyMeter:
    """The energy that the processors take, by the kernel's RAPL counters; often only root may read them."""

    def __init__(self, folder: Path = Path("/sys/class/powercap")) -> None:
        """Starts now. folder: the kernel's, in which every package (socket) and every part of one has its own."""
        self._packages: list[tuple[Path, int]] = []  # counter, uJ at which it starts from 0 again
        for name in sorted(folder.glob("*/name")):
            if not name.read_text().startswith("package"):
                continue  # a part, which its package counts
            try:
                largest = int((name.parent / "max_energy_range_uj").read_text())
                int((name.parent / "energy_uj").read_text())
            except (OSError, ValueError):
                continue
            self._packages.append((name.parent / "energy_uj", largest))
        self._last = [int(counter.read_text()) for counter, _ in self._packages]
        self._joules = 0.0

    def joules(self) -> float | None:
        """Since the start, of all that ran on the machine; None where the kernel does not tell.

        A counter starts again after some minutes: ask at least once a minute.
        """
        if not self._packages:
            return None
        for number, (counter, largest) in enumerate(self._packages):
            now = int(counter.read_text())
            self._joules += (now - self._last[number]) % (largest + 1) / 1e6
            self._last[number] = now
        return self._joules
