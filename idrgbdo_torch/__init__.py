"""Information-driven direct RGB-D odometry on Open3D and PyTorch. docs/api.md shows what the public names are for."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .alignment import AlignedPairs, align_pairs
    from .batched import NormalEquations, ResidualNoise, Target, linearise_pairs, residual_noise
    from .camera import Pinhole
    from .config import Config
    from .datasets import open_sequence
    from .errors import IdRgbdoError
    from .evaluation import evaluate
    from .frame import BrokenFrame, RgbdFrame
    from .id_rgbdo import IdRgbdo
    from .information import (
        conditional_covariance,
        entropy_bits,
        entropy_reduction_bits,
        information_from_rows,
        mutual_information_bits,
    )
    from .informative import select_rows
    from .odometry import Align, Alignment, FrameToFrame, Odometry, Run, Status, TrackResult, run
    from .photometric import depth_residual, linearize, warp
    from .points import HostPoints, host_points, pick_points, tracking_pyramid
    from .trajectory import Trajectory, read_tum, write_tum

__version__ = "0.1.0"

# where each public name lives; imported when first used, so that `import idrgbdo_torch` takes no time
_HOMES = {
    "Align": "odometry",
    "AlignedPairs": "alignment",
    "Alignment": "odometry",
    "BrokenFrame": "frame",
    "Config": "config",
    "FrameToFrame": "odometry",
    "HostPoints": "points",
    "IdRgbdo": "id_rgbdo",
    "IdRgbdoError": "errors",
    "NormalEquations": "batched",
    "Odometry": "odometry",
    "Pinhole": "camera",
    "ResidualNoise": "batched",
    "RgbdFrame": "frame",
    "Run": "odometry",
    "Status": "odometry",
    "Target": "batched",
    "TrackResult": "odometry",
    "Trajectory": "trajectory",
    "align_pairs": "alignment",
    "conditional_covariance": "information",
    "depth_residual": "photometric",
    "entropy_bits": "information",
    "entropy_reduction_bits": "information",
    "evaluate": "evaluation",
    "host_points": "points",
    "information_from_rows": "information",
    "linearise_pairs": "batched",
    "linearize": "photometric",
    "mutual_information_bits": "information",
    "open_sequence": "datasets",
    "pick_points": "points",
    "read_tum": "trajectory",
    "residual_noise": "batched",
    "run": "odometry",
    "select_rows": "informative",
    "tracking_pyramid": "points",
    "warp": "photometric",
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
    return getattr(import_module(f".{_HOMES[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
