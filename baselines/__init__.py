"""The odometries people would otherwise use, and ours, behind one interface. Nothing is imported until it is made."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any

from idrgbdo_torch.methods import Method

if TYPE_CHECKING:
    from idrgbdo_torch.odometry import Odometry


def _make(family: str, options: tuple[Any, ...], seed: int) -> Odometry:
    """The odometry that a file of this package makes, whatever the seed."""
    made: Odometry = import_module(f"{__name__}.{family}").make(*options)
    return made


def _make_ours(options: tuple[Any, ...], seed: int) -> Odometry:
    made: Odometry = import_module(f"{__name__}.ours").make(*options, seed)
    return made


def _ours_settings(options: tuple[Any, ...]) -> str:
    return str(import_module(f"{__name__}.ours").settings(*options))


def _of(family: str, description: str, *options: Any, libraries: tuple[str, ...] = ("torch",)) -> Method:
    return Method(description, partial(_make, family, options), libraries=libraries)


def _ours(description: str, points: int, mode: str = "inf+grid") -> Method:
    make: Callable[[int], Odometry] = partial(_make_ours, (points, mode))
    settings = partial(_ours_settings, (points, mode))
    return Method(description, make, random=mode == "rand", settings=settings, libraries=("torch", "numba", "numpy"))


OPEN3D, OPENCV = ("open3d",), ("opencv-python-headless",)

METHODS: dict[str, Method] = {
    "ours-24": _ours("ID-RGBDO, 24 informative points spread over the image", 24),
    "ours-256": _ours("ID-RGBDO, 256 points", 256),
    "ours-24-inf": _ours("ID-RGBDO, the 24 most informative points wherever they lie", 24, "inf"),
    "ours-24-grid": _ours("ID-RGBDO, 24 points of a grid", 24, "grid"),
    "ours-24-rand": _ours("ID-RGBDO, 24 points at random", 24, "rand"),
    "open3d-tensor-point-to-plane": _of("open3d_tensor", "Open3D tensor, ICP", "PointToPlane", libraries=OPEN3D),
    "open3d-tensor-intensity": _of("open3d_tensor", "Open3D tensor, photometric", "Intensity", libraries=OPEN3D),
    "open3d-tensor-hybrid": _of("open3d_tensor", "Open3D tensor, photometric and depth", "Hybrid", libraries=OPEN3D),
    "open3d-legacy-color": _of("open3d_legacy", "Open3D legacy, photometric", "Color", libraries=OPEN3D),
    "open3d-legacy-hybrid": _of("open3d_legacy", "Open3D legacy, photometric and depth", "Hybrid", libraries=OPEN3D),
    "opencv-rgb": _of("opencv", "OpenCV, photometric", "RGB", libraries=OPENCV),
    "opencv-depth": _of("opencv", "OpenCV, ICP", "DEPTH", libraries=OPENCV),
    "opencv-rgb-depth": _of("opencv", "OpenCV, photometric and ICP", "RGB_DEPTH", libraries=OPENCV),
    "dense": _of("dense", "dense photometric and depth alignment, after DVO"),
    "features": _of(
        "features", "ORB features, PnP and a small local map, after ORB-SLAM2", libraries=("torch", *OPENCV)
    ),
    "edges": _of("edges", "edge alignment, after Canny-VO", libraries=("torch", *OPENCV)),
    "constant-velocity": _of("null", "null baseline: never looks at an image"),
}
