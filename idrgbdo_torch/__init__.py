"""Information-driven direct RGB-D odometry on Open3D and PyTorch. docs/api.md shows what the public names are for."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .config import Config
    from .datasets import open_sequence
    from .definitions.camera import Pinhole
    from .definitions.information import (
        conditional_covariance,
        entropy_bits,
        entropy_reduction_bits,
        information_from_rows,
        mutual_information_bits,
    )
    from .definitions.linearise import NormalEquations, ResidualNoise, Target, residual_noise
    from .definitions.pairs import AlignedPairs
    from .definitions.photometric import depth_residual, linearize, warp
    from .definitions.points import HostPoints
    from .definitions.selection import select_rows
    from .errors import IdRgbdoError
    from .evaluation import evaluate
    from .frame import BrokenFrame, RgbdFrame
    from .odometry import Align, Alignment, FrameToFrame, Odometry, Run, Status, TrackResult, run
    from .runs import live
    from .tracker.id_rgbdo import IdRgbdo
    from .tracker.pairs import align_pairs, host_points, linearise_pairs, pick_points, tracking_pyramid
    from .trajectory import Trajectory, read_tum, write_tum

__version__ = "0.1.0"

# where each public name lives; imported when first used, so that `import idrgbdo_torch` takes no time
_HOMES = {
    "Align": "odometry",
    "AlignedPairs": "definitions.pairs",
    "Alignment": "odometry",
    "BrokenFrame": "frame",
    "Config": "config",
    "FrameToFrame": "odometry",
    "HostPoints": "definitions.points",
    "IdRgbdo": "tracker.id_rgbdo",
    "IdRgbdoError": "errors",
    "NormalEquations": "definitions.linearise",
    "Odometry": "odometry",
    "Pinhole": "definitions.camera",
    "ResidualNoise": "definitions.linearise",
    "RgbdFrame": "frame",
    "Run": "odometry",
    "Status": "odometry",
    "Target": "definitions.linearise",
    "TrackResult": "odometry",
    "Trajectory": "trajectory",
    "align_pairs": "tracker.pairs",
    "conditional_covariance": "definitions.information",
    "depth_residual": "definitions.photometric",
    "entropy_bits": "definitions.information",
    "entropy_reduction_bits": "definitions.information",
    "evaluate": "evaluation",
    "host_points": "tracker.pairs",
    "information_from_rows": "definitions.information",
    "linearise_pairs": "tracker.pairs",
    "linearize": "definitions.photometric",
    "live": "runs.live",  # the module itself
    "mutual_information_bits": "definitions.information",
    "open_sequence": "datasets",
    "pick_points": "tracker.pairs",
    "read_tum": "trajectory",
    "residual_noise": "definitions.linearise",
    "run": "odometry",
    "select_rows": "definitions.selection",
    "tracking_pyramid": "tracker.pairs",
    "warp": "definitions.photometric",
    "write_tum": "trajectory",
}

__all__ = [
    "Align",
    "AlignedPairs",
    "Alignment",
    "BrokenFrame",
    "Config",
    "FrameToFrame",
    "HostPoints",
    "IdRgbdo",
    "IdRgbdoError",
    "NormalEquations",
    "Odometry",
    "Pinhole",
    "ResidualNoise",
    "RgbdFrame",
    "Run",
    "Status",
    "Target",
    "TrackResult",
    "Trajectory",
    "align_pairs",
    "conditional_covariance",
    "depth_residual",
    "entropy_bits",
    "entropy_reduction_bits",
    "evaluate",
    "host_points",
    "information_from_rows",
    "linearise_pairs",
    "linearize",
    "live",
    "mutual_information_bits",
    "open_sequence",
    "pick_points",
    "read_tum",
    "residual_noise",
    "run",
    "select_rows",
    "tracking_pyramid",
    "warp",
    "write_tum",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = import_module(f".{_HOMES[name]}", __name__)
    return getattr(home, name, home)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
