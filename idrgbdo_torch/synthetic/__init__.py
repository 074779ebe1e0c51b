"""Rendered scenes along a known path, filmed by a realistic RGB-D sensor."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .config import KINDS, FaultConfig, Kind, SensorConfig, SynthConfig

if TYPE_CHECKING:
    from .sequence import RenderedSequence, Shot, synth, write_tum

__all__ = [
    "KINDS",
    "FaultConfig",
    "Kind",
    "RenderedSequence",
    "SensorConfig",
    "Shot",
    "SynthConfig",
    "synth",
    "write_tum",
]


def __getattr__(name: str) -> Any:
    """The renderer is imported when it is first asked for, so that the command's help need not wait for numpy."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from . import sequence

    return getattr(sequence, name)
