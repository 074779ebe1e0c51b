"""The machine that something was measured on."""

from __future__ import annotations

import os
import platform
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
