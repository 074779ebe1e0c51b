"""Where a sequence's camera comes from: a TOML file, the folder's calibration.txt, or the TUM camera in its name."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from .. import configfile
from ..camera import Pinhole
from ..configfile import Count, Positive
from ..errors import IdRgbdoError


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
        return Pinhole(width=width, height=height, fx=self.fx, fy=self.fy, cx=self.cx, cy=self.cy)


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


NAN = float("nan")
UNSET = Calibration(NAN, NAN, NAN, NAN)


def find_calibration(folder: Path, camera: Path | None = None) -> Calibration:
    """The calibration from `camera` (TOML), else folder/calibration.txt, else the TUM camera in the folder's name.

    Raises IdRgbdoError where none of the three is there, or the one that is cannot be read.
    """
    if camera is not None:
        return _from_toml(camera)
    text = folder / "calibration.txt"
    if text.exists():
        return _from_text(text)
    tum = re.search(r"(?:freiburg|fr)([123])(?!\d)", folder.resolve().name, flags=re.IGNORECASE)
    if tum:
        return TUM_CAMERAS[tum[1]]
    raise IdRgbdoError(
        f"camera: unknown intrinsics for '{folder}'; pass --camera F.toml with fx, fy, cx, cy, or put them into "
        f"'{text}' as one line `fx fy cx cy [k1 k2 p1 p2 k3]`"
    )


def _from_toml(path: Path) -> Calibration:
    calibration = configfile.load(path, UNSET)
    for name in ("fx", "fy", "cx", "cy"):
        if np.isnan(getattr(calibration, name)):
            raise IdRgbdoError(f"{path}: {name}: expected the camera's value in pixels, got none; add `{name} = ...`")
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


class Undistortion:
    """The precomputed map from distorted images to the pinhole of the same intrinsics."""

    def __init__(self, calibration: Calibration, camera: Pinhole) -> None:
        K = camera.matrix().numpy()
        self._map_u, self._map_v = cv2.initUndistortRectifyMap(
            K, np.array(calibration.distortion), np.eye(3), K, (camera.width, camera.height), cv2.CV_32FC1
        )

    def color(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Bilinear; pixels from outside repeat the border, so that no false edge arises there."""
        remapped = cv2.remap(image, self._map_u, self._map_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(remapped, dtype=np.uint8)

    def depth(self, image: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Nearest neighbour, since a mean over a depth edge is no surface; 0 (invalid) from outside."""
        remapped = cv2.remap(image, self._map_u, self._map_v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)
        return np.asarray(remapped, dtype=np.uint16)
