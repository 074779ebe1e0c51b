"""What a check finds: a row each, with a verdict and what to do."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Verdict(Enum):
    """GOOD; NOTE, worth knowing; FAULT, will spoil the poses; UNKNOWN, this recording cannot tell."""

    GOOD = "good"
    NOTE = "note"
    FAULT = "fault"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Finding:
    """One row."""

    name: str
    verdict: Verdict
    value: str  # what was measured, with units
    advice: str = ""  # what is wrong and what to do about it; empty where nothing is to be done
