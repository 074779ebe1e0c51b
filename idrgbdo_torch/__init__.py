"""Information-driven direct RGB-D odometry on Open3D and PyTorch."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .camera import Pinhole
    from .config import Config
    from .datasets import open_sequence
    from .errors import IdRgbdoError
    from .evaluation import evaluate
    from .frame import BrokenFrame, RgbdFrame
    from .id_rgbdo import IdRgbdo
    from .odometry import Align, Alignment, FrameToFrame, Odometry, Run, Status, TrackResult, run
    from .trajectory import Trajectory, read_tum, write_tum

__version__ = "0.1.0"

# where each public name lives; imported when first used, so that `import idrgbdo_torch` takes no time
_HOMES = {
    "Align": "odometry",
    "Alignment": "odometry",
    "BrokenFrame": "frame",
    "Config": "config",
    "FrameToFrame": "odometry",
    "IdRgbdo": "id_rgbdo",
    "IdRgbdoError": "errors",
    "Odometry": "odometry",
    "Pinhole": "camera",
    "RgbdFrame": "frame",
    "Run": "odometry",
    "Status": "odometry",
    "TrackResult": "odometry",
    "Trajectory": "trajectory",
    "evaluate": "evaluation",
    "open_sequence": "datasets",
    "read_tum": "trajectory",
    "run": "odometry",
    "write_tum": "trajectory",
}

__all__ = [
    "Align",
    "Alignment",
    "BrokenFrame",
    "Config",
    "FrameToFrame",
    "IdRgbdo",
    "IdRgbdoError",
    "Odometry",
    "Pinhole",
    "RgbdFrame",
    "Run",
    "Status",
    "TrackResult",
    "Trajectory",
    "evaluate",
    "open_sequence",
    "read_tum",
    "run",
    "write_tum",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_HOMES[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
