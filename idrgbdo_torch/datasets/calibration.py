"""A recording's camera, and the calibration file that it comes from."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from ..definitions.camera import Pinhole
from ..errors import IdRgbdoError
from ..text import configfile
from ..text.configfile import Bounds, Count
from .camera_files import camera_values, usual_file

EXAMPLE = (
    "`fx = 525.0`, `fy = 525.0`, `cx = 319.5`, `cy = 239.5` (and `depth_scale`, values per metre, unless as usual)"
)
CENTER_USUAL = 0.08  # of the image's width, from its middle to the principal point
USUAL_SIZES = (
    *((160, 120), (320, 240), (640, 480), (960, 720), (1280, 960), (1440, 1080), (2048, 1536)),  # 4:3
    *((640, 360), (960, 540), (1280, 720), (1920, 1080), (2560, 1440), (3840, 2160)),  # 16:9
    *((424, 240), (848, 480), (640, 400), (1280, 800), (640, 576), (512, 424), (1200, 680), (256, 192)),
)
FARTHEST_RAY = 3.0  # tangent of the angle off the axis: of an image of 143 degrees
FOLDED = 0.85  # of the way to the corner, from which on a fold is a matter of the corner alone
FARTHEST_M = 2.0  # that a depth camera stands from its colour camera; what is more is in millimetres
LEAST_FOCAL = 1e-3  # of the image's size: an angle of view of 179.9 degrees
MIDDLE = 0.06  # of the size, that a principal point of one of these is off at most


# what cameras have, with room to spare: beyond these a number is a mistake, and no memory holds the images it asks for
Focal = Annotated[float, Bounds(0, 1e6, low_excluded=True)]  # px
Pixel = Annotated[float, Bounds(-1e6, 1e6)]
Coefficient = Annotated[float, Bounds(-1e6, 1e6)]  # of a lens
Scale = Annotated[float, Bounds(1e-3, 1e9)]  # depth values per metre
Rate = Annotated[float, Bounds(1e-4, 1e5)]  # Hz
Growth = Annotated[float, Bounds(-0.1, 0.1)]  # 1/m
Readout = Annotated[float, Bounds(0, 200)]  # ms
Delay = Annotated[float, Bounds(-200, 200)]  # ms


@dataclass(frozen=True)
class DepthCamera:
    """A depth camera beside the colour camera, for depth that is not registered; without fx there is none."""

    fx: Focal | None = None
    fy: Focal | None = None
    cx: Pixel | None = None
    cy: Pixel | None = None
    T_color_depth: tuple[tuple[float, ...], ...] = ()  # 3 or 4 rows of 4; the identity where empty


@dataclass(frozen=True)
class Calibration:
    """Intrinsics in pixels and radial-tangential distortion of the colour image that the depth is registered to."""

    fx: Focal
    fy: Focal
    cx: Pixel
    cy: Pixel
    k1: Coefficient = 0.0
    k2: Coefficient = 0.0
    p1: Coefficient = 0.0
    p2: Coefficient = 0.0
    k3: Coefficient = 0.0
    k4: Coefficient = 0.0  # to k6: of the rational model, as an Azure Kinect has it
    k5: Coefficient = 0.0
    k6: Coefficient = 0.0
    width: Count | None = None  # px; checked against the images where given
    height: Count | None = None
    depth_scale: Scale | None = None
    depth_growth: Growth = 0.0  # 1/m, of the sensor's scale with distance: true = measured * (1 + growth * measured)
    readout_ms: Readout = 0.0  # of a rolling shutter, from the first to the last row of a colour image
    depth_delay_ms: Delay = 0.0  # by which the depth image is taken later than the colour image of the same time
    fps: Rate | None = None  # frames per second, where nothing else tells the times
    depth: DepthCamera = DepthCamera()
    origin: str = field(default="", compare=False)  # where it was found, for people

    @property
    def distortion(self) -> tuple[float, ...]:
        """k1, k2, p1, p2, k3, k4, k5, k6, in OpenCV's order."""
        return (self.k1, self.k2, self.p1, self.p2, self.k3, self.k4, self.k5, self.k6)

    def pinhole(self, width: int, height: int) -> Pinhole:
        """The camera of undistorted images of this size. Raises IdRgbdoError where it was calibrated for another."""
        stated = (self.width or width, self.height or height)
        who = self.origin or "camera"
        if stated != (width, height):
            raise IdRgbdoError(
                f"{who}: calibrated for {stated[0]}x{stated[1]}, but the images are {width}x{height}; "
                f"{self._advice(stated, (width, height))}"
            )
        if not (0 < self.cx < width and 0 < self.cy < height):
            raise IdRgbdoError(
                f"{who}: expected a principal point inside the images of {width}x{height}, got cx={self.cx:g}, "
                f"cy={self.cy:g}; {self._advice(self.likely_size(), (width, height))}"
            )
        if min(self.fx / width, self.fy / height) < LEAST_FOCAL:
            raise IdRgbdoError(
                f"{who}: expected focal lengths of images of {width}x{height}, got fx={self.fx:g}, fy={self.fy:g}, by "
                "which the camera sees all around; give them in pixels"
            )
        return Pinhole(
            width=width,
            height=height,
            fx=self.fx,
            fy=self.fy,
            cx=self.cx,
            cy=self.cy,
            readout_ms=self.readout_ms,
            depth_delay_ms=self.depth_delay_ms,
        )

    def likely_size(self) -> tuple[int, int] | None:
        """(width, height) in whose middle the principal point would be, among the usual ones; None for none of them."""

        def away(size: tuple[int, int]) -> float:
            return max(abs(self.cx - (size[0] - 1) / 2) / size[0], abs(self.cy - (size[1] - 1) / 2) / size[1])

        best = min(USUAL_SIZES, key=away)
        return best if away(best) < MIDDLE else None

    def size_doubt(self, width: int, height: int) -> str:
        """A sentence where the principal point is so far from the middle that it is of other images; else empty."""
        away = max(abs(self.cx - (width - 1) / 2), abs(self.cy - (height - 1) / 2)) / width
        if away <= CENTER_USUAL:
            return ""
        return (
            f"the principal point {self.cx:g}, {self.cy:g} is far from the middle of images of {width}x{height}: are "
            f"these the intrinsics of images of another size? {self._advice(self.likely_size(), (width, height))}"
        )

    def distortion_doubt(self, width: int, height: int) -> str:
        """A sentence where the distortion folds the image over within it, as no lens does; else empty."""
        corner = max(
            math.hypot((u - self.cx) / self.fx, (v - self.cy) / self.fy) for u in (0, width) for v in (0, height)
        )
        r2 = np.linspace(0.0, FARTHEST_RAY, 2000) ** 2
        with np.errstate(all="ignore"):
            above = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
            distorted = np.sqrt(r2) * above / (1 + r2 * (self.k4 + r2 * (self.k5 + r2 * self.k6)))
        outwards = np.diff(distorted) > 0  # false of what is no number
        if outwards.all() or distorted[np.argmin(outwards)] >= FOLDED * corner:
            return ""
        return (
            "the distortion folds the image over within it, as no lens does: are coefficients missing or in another "
            "order? k1, k2, p1, p2, k3, and k4, k5, k6 of the rational model, are all needed where there are eight"
        )

    def _advice(self, size: tuple[int, int] | None, images: tuple[int, int]) -> str:
        """What to write for images that were resized from `size` as a whole; in general where they were not."""
        if (
            size is None
            or size == images
            or abs(size[0] * images[1] - size[1] * images[0]) > 0.01 * size[0] * images[1]
        ):
            return "give the intrinsics of these images"
        c = scaled(self, size, images)
        return (
            f"if they were resized from {size[0]}x{size[1]}, write `fx = {c.fx:.6g}`, `fy = {c.fy:.6g}`, "
            f"`cx = {c.cx:.6g}`, `cy = {c.cy:.6g}`"
        )

    def T_color_depth(self) -> NDArray[np.float64]:
        """(4, 4) pose of the depth camera in the colour camera. Raises IdRgbdoError for no rigid motion."""
        T = np.eye(4)
        rows = self.depth.T_color_depth
        if rows:
            if len(rows) not in (3, 4) or any(len(row) != 4 for row in rows):
                raise IdRgbdoError("camera: depth.T_color_depth: expected 3 or 4 rows of 4 numbers; correct it")
            T[: len(rows)] = rows
        R = T[:3, :3]
        if np.isfinite(T).all() and np.abs(T[:3, 3]).max() > FARTHEST_M:
            raise IdRgbdoError(
                f"camera: depth.T_color_depth: expected a translation in metres, of at most {FARTHEST_M:g}, got "
                f"{', '.join(f'{value:g}' for value in T[:3, 3])}; divide it by 1000 where it is in millimetres"
            )
        if (
            not np.abs(T).max() <= FARTHEST_M  # nor NaN
            or not np.allclose(R @ R.T, np.eye(3), atol=1e-3)
            or np.linalg.det(R) < 0
            or tuple(T[3]) != (0, 0, 0, 1)
        ):
            raise IdRgbdoError(
                "camera: depth.T_color_depth: expected a rotation and a translation in metres; correct it"
            )
        return T


NAN = float("nan")
UNSET = Calibration(NAN, NAN, NAN, NAN)


def find_calibration(
    folder: Path, camera: Path | None = None, default: Calibration | Path | None = None
) -> Calibration:
    """From the file `camera`, else the folder's camera.toml or calibration.txt, another program's calibration under a
    usual name (camera_files.NAMES), `default`, which may be another file.

    Raises IdRgbdoError where none of them is there, or the one that is cannot be read.
    """
    ours = next((folder / name for name in ("camera.toml", "calibration.txt") if os.path.lexists(folder / name)), None)
    if camera is not None or ours is not None:
        return _from_file(camera or ours or folder)
    other = usual_file(folder) or (default if isinstance(default, Path) else None)
    if other is not None:
        return replace(_from_file(other), origin=f"camera of {other.name}")
    if isinstance(default, Calibration):
        return default
    raise IdRgbdoError(
        f"camera: unknown intrinsics for '{folder}'; write '{folder / 'camera.toml'}' with the lines {EXAMPLE}, in "
        f"pixels of your images, or pass --camera F.toml or another program's YAML or JSON{_perhaps(folder)}"
    )


def _perhaps(folder: Path) -> str:
    """The files that may hold one."""
    files = [path.name for path in sorted(folder.glob("*")) if path.suffix.lower() in (".yaml", ".yml", ".json")]
    return f"; is it in {', '.join(files[:3])}?" if files else ""


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


def believed(calibration: Calibration, where: str) -> Calibration:
    """The calibration, where each of its numbers is one that a camera can have.

    where: the file that says so. Raises IdRgbdoError, naming the number, for NaN, infinity and what is far too large.
    """
    configfile.check(calibration, f"{where}: ")
    return calibration


def _from_file(path: Path) -> Calibration:
    calibration = configfile.merge(UNSET, camera_values(path), f"{path}: ")
    for name in ("fx", "fy", "cx", "cy"):
        if np.isnan(getattr(calibration, name)):
            raise IdRgbdoError(f"{path}: {name}: expected the camera's value in pixels, got none; add `{name} = ...`")
    try:
        calibration.T_color_depth()
    except IdRgbdoError as error:
        raise IdRgbdoError(str(error).replace("camera:", f"{path}:", 1)) from error
    depth = calibration.depth
    if depth != DepthCamera() and None in (depth.fx, depth.fy, depth.cx, depth.cy):
        raise IdRgbdoError(f"{path}: [depth]: expected fx, fy, cx and cy of the depth camera; add what is missing")
    return calibration
