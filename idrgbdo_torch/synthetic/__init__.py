"""Rendered scenes along a known path, filmed by a realistic RGB-D sensor."""

from .config import KINDS, Kind, SensorConfig, SynthConfig
from .sequence import RenderedSequence, Shot, synth, write_tum

__all__ = ["KINDS", "Kind", "RenderedSequence", "SensorConfig", "Shot", "SynthConfig", "synth", "write_tum"]
