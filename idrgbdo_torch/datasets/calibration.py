"""Where a recording's camera comes from: a TOML file, the folder's calibration.txt, or the data set in its name."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .. import configfile
from ..configfile import Count, Positive
from ..definitions.camera import Pinhole
from ..errors import IdRgbdoError

EXAMPLE = "`fx = 525.0`, `fy = 525.0`, `cx = 319.5`, `cy = 239.5`, `depth_scale = 1000.0` (depth values per metre)"


@dataclass(frozen=True)
class DepthCamera:
    """A depth camera beside the colour camera, for depth that is not registered; without fx there is none."""

    fx: Positive | None = None
    fy: Positive | None = None
    cx: float | None = None
    cy: float | None = None
    T_color_depth: tuple[tuple[float, ...], ...] = ()  # 3 or 4 rows of 4; the identity where empty


@dataclass(frozen=True)
class Calibration:
    """Intrinsics in pixels and radial-tangential distortion of the colour image that the depth is registered to."""

    fx: Positive
    fy: Positive
    cx: float
    cy: float
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    width: Count | None = None  # px; checked against the images where given
    height: Count | None = None
    depth_scale: Positive | None = None  # depth values per metre
    fps: Positive | None = None  # frames per second, where nothing else tells the times
    depth: DepthCamera = DepthCamera()

    @property
    def distortion(self) -> tuple[float, ...]:
        """k1, k2, p1, p2, k3, in OpenCV's order."""
        return (self.k1, self.k2, self.p1, self.p2, self.k3)

    def pinhole(self, width: int, height: int) -> Pinhole:
        """The camera of undistorted images of this size. Raises IdRgbdoError where it was calibrated for another."""
        stated = (self.width or width, self.height or height)
        if stated != (width, height):
            raise IdRgbdoError(
                f"camera: calibrated for {stated[0]}x{stated[1]}, but the images are {width}x{height}; "
                "give the intrinsics of these images"
            )
        if not (0 < self.cx < width and 0 < self.cy < height):
            raise IdRgbdoError(
                f"camera: expected a principal point inside the images of {width}x{height}, got cx={self.cx:g}, "
                f"cy={self.cy:g}; give the intrinsics of these images"
            )
        return Pinhole(width=width, height=height, fx=self.fx, fy=self.fy, cx=self.cx, cy=self.cy)

    def T_color_depth(self) -> NDArray[np.float64]:
        """(4, 4) pose of the depth camera in the colour camera. Raises IdRgbdoError for no rigid motion."""
        T = np.eye(4)
        rows = self.depth.T_color_depth
        if rows:
            if len(rows) not in (3, 4) or any(len(row) != 4 for row in rows):
                raise IdRgbdoError("camera: depth.T_color_depth: expected 3 or 4 rows of 4 numbers; correct it")
            T[: len(rows)] = rows
        R = T[:3, :3]
        if not np.allclose(R @ R.T, np.eye(3), atol=1e-3) or np.linalg.det(R) < 0 or tuple(T[3]) != (0, 0, 0, 1):
            raise IdRgbdoError(
                "camera: depth.T_color_depth: expected a rotation and a translation in metres; correct it"
            )
        return T


# Published for the TUM RGB-D benchmark's three cameras; the third's images are already undistorted.
TUM_CAMERAS = {
    "1": Calibration(
        517.306408, 516.469215, 318.643040, 255.313989, 0.262383, -0.953104, -0.005358, 0.002628, 1.163314
    ),
    "2": Calibration(
        520.908620, 521.007327, 325.141442, 249.701764, 0.231222, -0.784899, -0.003257, -0.000105, 0.917205
    ),
    "3": Calibration(535.4, 539.2, 320.1, 247.6),
}
BONN = Calibration(542.822841, 542.576870, 315.593520, 237.756098, 0.039903, -0.099343, -0.000730, -0.000144)
ICL_NUIM = Calibration(481.2, 480.0, 319.5, 239.5)  # published with fy = -480, since its y axis points up
NAMED = {
    **{rf"(freiburg|fr){number}(?!\d)": camera for number, camera in TUM_CAMERAS.items()},
    r"rgbd_bonn_": BONN,
    r"traj\d\w*_frei_png|(^|_)(lr|of)_?kt\d|icl[-_]?nuim": ICL_NUIM,
}

NAN = float("nan")
UNSET = Calibration(NAN, NAN, NAN, NAN)


def find_calibration(folder: Path, camera: Path | None = None, default: Calibration | None = None) -> Calibration:
    """From `camera` (TOML), else the folder's camera.toml, its calibration.txt, the data set in its name, `default`.

    Raises IdRgbdoError where none of them is there, or the one that is cannot be read.
    """
    if camera is not None:
        return _from_toml(camera)
    toml, text = folder / "camera.toml", folder / "calibration.txt"
    if toml.exists():
        return _from_toml(toml)
    if text.exists():
        return _from_text(text)
    name = folder.resolve().name
    named = next((known for pattern, known in NAMED.items() if re.search(pattern, name, re.IGNORECASE)), default)
    if named is not None:
        return named
    raise IdRgbdoError(
        f"camera: unknown intrinsics for '{folder}'; write '{toml}' with the lines {EXAMPLE}, in pixels of your "
        "images, or pass --camera F.toml"
    )


def scaled(calibration: Calibration, size: tuple[int, int], new_size: tuple[int, int]) -> Calibration:
    """The calibration of images resized from `size` to `new_size`, both (width, height)."""
    s, t = new_size[0] / size[0], new_size[1] / size[1]
    return replace(
        calibration,
        fx=calibration.fx * s,
        fy=calibration.fy * t,
        cx=(calibration.cx + 0.5) * s - 0.5,
        cy=(calibration.cy + 0.5) * t - 0.5,
        width=None,
        height=None,
    )


def _from_toml(path: Path) -> Calibration:
    calibration = configfile.load(path, UNSET)
    for name in ("fx", "fy", "cx", "cy"):
        if np.isnan(getattr(calibration, name)):
            raise IdRgbdoError(f"{path}: {name}: expected the camera's value in pixels, got none; add `{name} = ...`")
    depth = calibration.depth
    if depth != DepthCamera() and None in (depth.fx, depth.fy, depth.cx, depth.cy):
        raise IdRgbdoError(f"{path}: [depth]: expected fx, fy, cx and cy of the depth camera; add what is missing")
    return calibration


def _from_text(path: Path) -> Calibration:
    expected = "fx fy cx cy [k1 k2 p1 p2 k3] in pixels"
    lines = [line.split("#")[0] for line in path.read_text(encoding="utf-8", errors="replace").splitlines()]
    try:
        numbers = [float(field) for field in " ".join(lines).split()]
    except ValueError as error:
        raise IdRgbdoError(f"{path}: expected {expected}, got text ({error}); correct it") from error
    if len(numbers) not in (4, 8, 9):
        raise IdRgbdoError(f"{path}: expected {expected}, got {len(numbers)} numbers; correct it")
    names = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
    return configfile.merge(UNSET, dict(zip(names, numbers, strict=False)), f"{path}: ")
