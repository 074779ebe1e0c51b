"""From a colour and a depth image to an RgbdFrame: sizes, undistortion, registration, metres, gray levels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from ..definitions.camera import Pinhole
from ..definitions.checks import unknown_depth
from ..errors import IdRgbdoError
from ..frame import BrokenFrame, RgbdFrame
from ..text.plain import shown
from .calibration import Calibration
from .depth_scale import SATURATED
from .pixels import gray_and_rgb, metres_of_16_bits
from .rectify import Registration, Undistortion

RawPair = tuple[NDArray[np.uint8], NDArray[Any]]  # (H, W, 3) blue green red, (h, w) raw depth, integers or float32
# what reading an image of somebody else's raises; mistakes of our own (TypeError and its kin) are not hidden
UNREADABLE = (OSError, ValueError, ArithmeticError, MemoryError, EOFError, cv2.error)


class FrameBuilder:
    """Turns raw images of one camera into frames."""

    def __init__(
        self,
        calibration: Calibration,
        color: NDArray[np.uint8],
        depth_scale: float,
        unknown: float | None = None,
        floats: bool | None = None,
    ) -> None:
        """color: an image that has the size of all. depth_scale: depth values per metre. unknown: raw depth that
        stands for "not measured", besides 0. floats: whether depth is floats, rather than whole numbers; None allows
        both.

        Raises IdRgbdoError for a calibration of another size.
        """
        self.camera: Pinhole = calibration.pinhole(color.shape[1], color.shape[0])
        self._floats = floats
        self.depth_scale, self._unknown = depth_scale, unknown
        self._growth = np.float32(calibration.depth_growth)
        self._undistortion = Undistortion(calibration, self.camera) if any(calibration.distortion) else None
        self._registration = Registration(calibration, self.camera) if calibration.depth.fx is not None else None

    def frame(self, timestamp: float, color: NDArray[np.uint8], depth: NDArray[Any]) -> RgbdFrame:
        """The frame of (H, W, 3) blue, green, red and (h, w) raw depth, integers or float32.

        Raises IdRgbdoError for images of another size than most, or of depth in other numbers.
        """
        size = (self.camera.height, self.camera.width)
        if color.shape[:2] != size:
            raise IdRgbdoError(f"image of shape {color.shape[:2]}, where most have {size}; give all the same size")
        if self._floats is not None and (depth.dtype.kind == "f") != self._floats:
            kinds = ("floats", "whole numbers") if self._floats else ("whole numbers", "floats")
            raise IdRgbdoError(f"depth: expected {kinds[0]} as in most images, got {kinds[1]}; write all alike")
        if self._registration is None and depth.shape != size:
            raise IdRgbdoError(
                f"depth: expected depth of the colour image's size {size[1]}x{size[0]}, "
                f"got {depth.shape[1]}x{depth.shape[0]}; "
                "register the depth to the colour camera, or describe the depth camera in the camera file under [depth]"
            )
        depth_m = metres(depth, self.depth_scale)
        if self._unknown is not None:
            depth_m[depth == self._unknown] = 0
        if self._growth:
            depth_m *= 1 + self._growth * depth_m
        if self._registration is not None:
            depth_m = self._registration.depth(depth_m)
        if self._undistortion is not None:
            color = self._undistortion.color(color)
            if self._registration is None:  # registered to the distorted colour image
                depth_m = self._undistortion.depth(depth_m)
        gray, rgb = gray_and_rgb(color)
        return RgbdFrame(
            timestamp=timestamp,
            gray=torch.from_numpy(gray),  # (H, W)
            depth=torch.from_numpy(depth_m),  # (H, W) m
            camera=self.camera,
            color=torch.from_numpy(rgb),  # (H, W, 3)
        ).owned()

    def frame_or_reason(self, timestamp: float, read: Callable[[], RawPair]) -> RgbdFrame | BrokenFrame:
        """The frame of what `read` gives; where that or its size is wrong, a BrokenFrame that says why."""
        try:
            return self.frame(timestamp, *read())
        except UNREADABLE as error:
            return BrokenFrame(timestamp, _said(error))


def unreadable_named(read: Callable[[int], RawPair]) -> Callable[[int], RawPair]:
    """The function, raising IdRgbdoError for whatever reading an image raises."""

    def named(number: int) -> RawPair:
        try:
            return read(number)
        except IdRgbdoError:
            raise
        except UNREADABLE as error:
            raise IdRgbdoError(_said(error)) from error

    return named


def _said(error: Exception) -> str:
    if isinstance(error, IdRgbdoError):
        return str(error)
    said = shown(" ".join(str(error).split()), quoted=False)
    return f"image: cannot be read ({type(error).__name__}{': ' if said else ''}{said}); replace it"


def metres(depth: NDArray[Any], depth_scale: float) -> NDArray[np.float32]:
    """(H, W) float32 metres, 0 where the raw depth is 0, saturated, negative or not finite."""
    if depth.dtype == np.uint16:
        return metres_of_16_bits(depth, depth_scale, SATURATED)
    if depth.dtype.kind in "iu":
        depth_m = np.asarray(depth / np.float32(depth_scale), dtype=np.float32)
        depth_m[(depth <= 0) | (depth == unknown_depth(depth))] = 0
        return depth_m
    with np.errstate(all="ignore"):  # what becomes infinite is unknown
        scaled = depth.astype(np.float32) / np.float32(depth_scale)
    return np.where(np.isfinite(scaled) & (scaled > 0), scaled, np.float32(0))


def with_swapped_bytes(depth: NDArray[Any]) -> str:
    """A sentence where raw 16-bit depth is smooth only with its two bytes exchanged; else empty."""
    if depth.dtype != np.uint16:
        return ""
    known = (depth[:, 1:] > 0) & (depth[:, :-1] > 0)
    steps = [np.abs(np.diff(image.astype(np.int32), axis=1))[known] for image in (depth, depth.byteswap())]
    if known.any() and steps[0].mean() > 20 * max(steps[1].mean(), 10.0):
        return (
            "depth: the two bytes of the 16-bit values are swapped: neighbouring pixels differ by "
            f"{steps[0].mean():.0f} on the average, with the bytes exchanged by {steps[1].mean():.0f}; "
            "write the images again in the other byte order"
        )
    return ""
