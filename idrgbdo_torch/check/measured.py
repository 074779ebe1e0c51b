"""What a check has measured, for those who judge it and draw it."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..definitions.camera import Pinhole
from ..tracker.camera_estimate import CameraEstimate
from .calibration import SelfCalibration
from .edges import EdgeFit
from .images import ImageStatistics
from .motion import ReferenceMotion
from .samples import Sample
from .scene import TwoMotions
from .timing import Lists, Timing
from .tracks import Tracks
from .view import ViewFit


@dataclass(frozen=True)
class Measured:
    """Everything that was measured; the findings are judged from it, the picture is drawn from it."""

    camera: Pinhole
    frames: int
    sampled: int
    broken: list[str]  # reasons of the sampled frames that cannot be read
    lists: Lists | None
    timing: Timing | None
    images: list[ImageStatistics]
    edges: EdgeFit
    tracks: Tracks
    calibration: SelfCalibration | None
    motion: ReferenceMotion | None
    shown: Sample | None  # the frame for the picture: most depth edges
    depth_scale: float | None = None  # depth values per metre, where the sequence tells
    view: ViewFit | None = None  # asked for only where colour and depth agree at no shift
    camera_seen: CameraEstimate | None = None
    motions_apart: list[TwoMotions] = field(default_factory=list)  # of the pairs that can tell
