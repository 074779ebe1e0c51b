"""The ratios that must stay within their ranges, which ranges.json holds."""

from __future__ import annotations

import json
from pathlib import Path

RANGES: dict[str, tuple[float | None, float | None]] = json.loads((Path(__file__).parent / "ranges.json").read_text())


def wanted(name: str) -> str:
    """The range of a ratio in words."""
    low, high = RANGES[name]
    return f"at most {high:g}" if low is None else f"at least {low:g}" if high is None else f"{low:g} to {high:g}"


def outside(name: str, value: float) -> str:
    """What is wrong with a ratio; nothing where it is within its range."""
    low, high = RANGES[name]
    within = (low is None or value >= low) and (high is None or value <= high)
    return "" if within else f"{name}: {value:.3g}, {wanted(name)} wanted"
