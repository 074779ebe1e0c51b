"""Is a recording fit for RGB-D odometry? Frames, times, depth, registration, camera, motion; what to do about each."""

from __future__ import annotations

from .findings import Finding, Verdict
from .measured import Measured
from .report import Report, check, sampled_frames

__all__ = ["Finding", "Measured", "Report", "Verdict", "check", "sampled_frames"]
