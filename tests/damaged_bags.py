"""Recordings of ROS with something damaged: what is left of them."""

from __future__ import annotations

from pathlib import Path

from fuzz import recorded

from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.frame import RgbdFrame


def sound(files: recorded.Files, folder: Path) -> tuple[list[int], list[str]]:
    """Numbers of the film's frames that are read, and the warnings."""
    sequence = open_sequence(recorded.write(files, folder))
    base = 1_700_000_100.0
    times = [frame.timestamp for frame in sequence if isinstance(frame, RgbdFrame)]
    return [round((time - base) * 30) for time in times], sequence.warnings


def database() -> tuple[str, bytes]:
    """Name and bytes of the film as a database."""
    return next((name, data) for name, data in recorded.bag_of("sqlite3").items() if name.endswith(".db3"))
