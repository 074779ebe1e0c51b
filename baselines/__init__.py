"""The odometries people would otherwise use, and ours, behind one interface. Nothing is imported until it is made."""

from __future__ import annotations

from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any

from idrgbdo_torch.comparison.methods import Method

if TYPE_CHECKING:
    from idrgbdo_torch.odometry import Odometry


def _make(family: str, options: tuple[Any, ...], seed: int) -> Odometry:
    """The odometry that a file of this package makes, whatever the seed."""
    made: Odometry = import_module(f"{__name__}.{family}").make(*options)
    return made


def _make_ours(options: tuple[Any, ...], seed: int) -> Odometry:
    made: Odometry = import_module(f"{__name__}.ours").make(*options, seed)
    return made


def _settings(family: str, options: tuple[Any, ...]) -> str:
    return str(import_module(f"{__name__}.{family}").settings(*options))


def _library(family: str, description: str, option: str, library: str) -> Method:
    """A method of a library with its makers' defaults."""
    return Method(
        description, partial(_make, family, (option,)), settings=partial(_settings, "checked", ()), libraries=(library,)
    )


def _family(family: str, description: str, *libraries: str) -> Method:
    """A method of our own making."""
    make, settings = partial(_make, family, ()), partial(_settings, family, ())
    return Method(description, make, settings=settings, libraries=("torch", *libraries))


def _ours(description: str, points: int, mode: str = "inf+grid") -> Method:
    make, settings = partial(_make_ours, (points, mode)), partial(_settings, "ours", (points, mode))
    libraries = ("torch", "numba", "numpy")
    return Method(description, make, "ours", random=mode == "rand", settings=settings, libraries=libraries)


OPEN3D, OPENCV = "open3d", "opencv-python-headless"

METHODS: dict[str, Method] = {
    "ours-24": _ours("ID-RGBDO, 24 informative points spread over the image", 24),
    "ours-256": _ours("ID-RGBDO, 256 points", 256),
    "ours-24-inf": _ours("ID-RGBDO, the 24 most informative points wherever they lie", 24, "inf"),
    "ours-24-grid": _ours("ID-RGBDO, 24 points of a grid", 24, "grid"),
    "ours-24-rand": _ours("ID-RGBDO, 24 points at random", 24, "rand"),
    "open3d-tensor-point-to-plane": _library("open3d_tensor", "Open3D tensor, ICP", "PointToPlane", OPEN3D),
    "open3d-tensor-intensity": _library("open3d_tensor", "Open3D tensor, photometric", "Intensity", OPEN3D),
    "open3d-tensor-hybrid": _library("open3d_tensor", "Open3D tensor, photometric and depth", "Hybrid", OPEN3D),
    "open3d-legacy-color": _library("open3d_legacy", "Open3D legacy, photometric", "Color", OPEN3D),
    "open3d-legacy-hybrid": _library("open3d_legacy", "Open3D legacy, photometric and depth", "Hybrid", OPEN3D),
    "opencv-rgb": _library("opencv", "OpenCV, photometric", "RGB", OPENCV),
    "opencv-depth": _library("opencv", "OpenCV, ICP", "DEPTH", OPENCV),
    "opencv-rgb-depth": _library("opencv", "OpenCV, photometric and ICP", "RGB_DEPTH", OPENCV),
    "dense": _family("dense", "dense photometric and depth alignment, after DVO"),
    "features": _family("features", "ORB features, PnP and a small local map, after ORB-SLAM2", OPENCV),
    "edges": _family("edges", "edge alignment, after Canny-VO", OPENCV),
    "constant-velocity": Method("null baseline: never looks at an image", partial(_make, "null", ()), "null"),
}
