"""What a sensor gives (RgbdFrame, BrokenFrame), what tracking reads (Frame), what it refers to (Keyframe)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .definitions.camera import Pinhole
from .errors import IdRgbdoError
from .measurement import COARSE_BLUR, LEVELS, Points, View

Image = NDArray[Any]


@dataclass(frozen=True)
class RgbdFrame:
    """One registered colour and depth image.

    timestamp: seconds. gray: (H, W) float32 gray levels 0..255. depth: (H, W) float32 metres, 0 where invalid.
    camera: the undistorted pinhole of both. color: (H, W, 3) uint8 RGB for maps and pictures, optional.
    """

    timestamp: float
    gray: Tensor
    depth: Tensor
    camera: Pinhole
    color: Tensor | None = None

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        for name, image in (("gray", self.gray), ("depth", self.depth)):
            if image.dtype != torch.float32 or tuple(image.shape) != size:
                raise IdRgbdoError(
                    f"{name}: expected a float32 tensor of shape {size} (the camera's height, width), "
                    f"got {image.dtype} {tuple(image.shape)}; convert it or pass the matching camera"
                )


@dataclass(frozen=True)
class BrokenFrame:
    """A frame that could not be read: it costs that frame, not the run."""

    timestamp: float
    reason: str


@dataclass(frozen=True)
class Frame:
    """A frame ready for tracking: its gray pyramid as numpy views, what the fused kernels read."""

    timestamp: float
    camera: Pinhole
    images: tuple[Image, ...]  # (H >> l, W >> l) float32 gray levels
    depth: Image  # (H, W) float32 m
    color: Tensor | None = None
    sharp: Image | None = None  # the finest level as it came, where images[0] is blurred

    @cached_property
    def intrinsics(self) -> Image:
        """(L, 4) float64: fx fy cx cy of every level."""
        cameras = [self.camera.at_level(level) for level in range(len(self.images))]
        return np.array([[c.fx, c.fy, c.cx, c.cy] for c in cameras])

    @cached_property
    def view(self) -> View:
        """What an alignment reads of it."""
        return View(self.images, self.depth, self.intrinsics)


def prepare(rgbd: RgbdFrame, blur: float = 0.0) -> Frame:
    """Gray pyramid by 2x2 means, which is what Pinhole.at_level assumes; the coarse levels are blurred.

    Without that blur, texture aliases on the coarse levels and Gauss-Newton crawls there. blur: px, standard deviation
    of one of the finest level, from which the others do not take it. The input is not changed.
    Raises IdRgbdoError for images that have no coarsest level.
    """
    least = 2 ** (LEVELS - 1)
    if min(rgbd.camera.width, rgbd.camera.height) < least:
        raise IdRgbdoError(
            f"frame: expected images of at least {least}x{least} pixels, got {rgbd.camera.width}x{rgbd.camera.height}; "
            "record larger ones"
        )
    images = [np.ascontiguousarray(rgbd.gray.numpy())]
    while len(images) < LEVELS:
        height, width = images[-1].shape
        even = images[-1][: max(height // 2, 1) * 2, : max(width // 2, 1) * 2]
        images.append(cv2.resize(even, (max(width // 2, 1), max(height // 2, 1)), interpolation=cv2.INTER_AREA))
    for image in images[1:]:
        cv2.GaussianBlur(image, (5, 5), COARSE_BLUR, dst=image)  # in place: fresh memory costs more than the blur
    sharp = images[0]
    if blur > 0.0:
        images[0] = cv2.GaussianBlur(images[0], (5, 5), blur)
    depth = np.ascontiguousarray(rgbd.depth.numpy())
    return Frame(rgbd.timestamp, rgbd.camera, tuple(images), depth, rgbd.color, sharp)


@dataclass(frozen=True)
class Keyframe:
    """A frame with its candidate points (struct of arrays); its pose lives in the window."""

    frame: Frame
    points: Points  # inverse depths as refined so far; patches of coarse levels only for coarse and witnesses
    measured: Image  # (N,) 1/m, the sensor's own inverse depths
    measured_variance: Image  # (N,) (1/m)^2
    radius: Image  # (N,) distance to the principal point over the largest one
    coarse: Image  # (M,) indices spread over the image, for the coarse levels
    witnesses: Image  # (W,) the same for verification, which takes more than a few
