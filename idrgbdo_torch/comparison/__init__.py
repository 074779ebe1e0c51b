"""Methods on sequences: run once, remembered, and laid side by side."""

from __future__ import annotations

from .outcome import Outcome
from .runner import External, Progress, compare, parse_external
from .summary import Comparison, Row, Spread
from .worker import Source

__all__ = [
    "Comparison",
    "External",
    "Outcome",
    "Progress",
    "Row",
    "Source",
    "Spread",
    "compare",
    "parse_external",
]
