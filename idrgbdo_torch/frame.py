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
from .definitions.checks import check_gray, check_metres, extremes
from .errors import IdRgbdoError
from .measurement import COARSE_BLUR, LEVELS, Points, View
from .text.clock import NO_SECONDS

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
        """Raises IdRgbdoError for images of another type or size than said, and for gray levels and times that are
        none. Depth that is NaN, infinite or negative becomes 0; numpy arrays become tensors.
        """
        size = (self.camera.height, self.camera.width)
        for name in ("gray", "depth", "color"):
            if isinstance(getattr(self, name), np.ndarray):
                object.__setattr__(self, name, torch.from_numpy(np.ascontiguousarray(getattr(self, name))))
        for name, image in (("gray", self.gray), ("depth", self.depth)):
            if image.dtype != torch.float32 or tuple(image.shape) != size:
                raise IdRgbdoError(
                    f"{name}: expected a float32 tensor of shape {size} (the camera's height, width), "
                    f"got {image.dtype} {tuple(image.shape)}; convert it (RgbdFrame.from_images takes colour and depth "
                    "as cameras give them) or pass the matching camera"
                )
        if self.color is not None and (self.color.dtype != torch.uint8 or tuple(self.color.shape) != (*size, 3)):
            raise IdRgbdoError(
                f"color: expected a uint8 tensor of shape {(*size, 3)}, red green blue, got {self.color.dtype} "
                f"{tuple(self.color.shape)}; convert it, or leave it out"
            )
        if not abs(self.timestamp) <= NO_SECONDS:
            raise IdRgbdoError(
                f"timestamp: expected seconds, got {self.timestamp:g}; divide milliseconds by 1e3, nanoseconds by 1e9"
            )
        check_gray(self.gray)
        nearest, farthest = extremes(self.depth)
        if not (nearest >= 0 and farthest < float("inf")):  # nor NaN
            there = self.depth.isfinite() & (self.depth > 0)
            object.__setattr__(self, "depth", torch.where(there, self.depth, 0.0))

    @classmethod
    def from_images(
        cls,
        timestamp: float,
        rgb: Tensor | Image,
        depth: Tensor | Image,
        camera: Pinhole,
        depth_scale: float | None = None,
    ) -> RgbdFrame:
        """A frame of the images that a camera's driver gives, tensors or numpy arrays.

        rgb: (H, W, 3) or (3, H, W) uint8, red green blue, or (H, W) uint8 gray. depth: (H, W), registered to rgb,
        float (metres unless depth_scale says otherwise) or integer, for which depth_scale says how many make a metre:
        1000 where they are millimetres, 5000 in TUM's files. Raises IdRgbdoError for anything else.
        """
        color, z = (torch.as_tensor(_native(image)) for image in (rgb, depth))
        size = (camera.height, camera.width)
        if color.dim() == 3 and tuple(color.shape) == (3, *size):
            color = color.permute(1, 2, 0)
        if color.dtype != torch.uint8 or tuple(color.shape) not in ((*size, 3), size):
            raise IdRgbdoError(
                f"rgb: expected uint8 of shape {(*size, 3)} or {size} (the camera's height, width), got {color.dtype} "
                f"{tuple(color.shape)}; convert it (a float image in 0..1: times 255) or pass the matching camera"
            )
        if depth_scale is not None and not 0 < depth_scale < float("inf"):
            raise IdRgbdoError(f"depth_scale: expected depth values per metre, above 0, got {depth_scale}; change it")
        if depth_scale is None and not z.dtype.is_floating_point:
            raise IdRgbdoError(
                f"depth_scale: expected the values per metre of {z.dtype} depth, got none; pass 1000 for millimetres"
            )
        metres = z.to(torch.float32) / (depth_scale or 1.0)
        color = color.contiguous()
        if color.dim() == 2:
            return cls(timestamp, color.float(), metres, camera, color[..., None].expand(*size, 3).contiguous())
        gray = cv2.cvtColor(color.numpy().astype(np.float32), cv2.COLOR_RGB2GRAY)  # ITU-R BT.601
        return cls(timestamp, torch.from_numpy(gray), metres, camera, color)


def _native(image: Tensor | Image) -> Any:
    """The image for torch.as_tensor, contiguous; uint16 as int32, with which torch can calculate."""
    if isinstance(image, np.ndarray):
        return np.ascontiguousarray(image.astype(np.int32) if image.dtype == np.uint16 else image)
    return image.to(torch.int32) if image.dtype == torch.uint16 else image


def check_next(rgbd: RgbdFrame, before: Pinhole | None) -> None:
    """What an odometry can't take from its caller: depth in no metres at the start, images of another size than before.

    before: the camera of the frames before, None where there is no keyframe yet. Raises IdRgbdoError; a bad image, on
    the other hand, is a lost frame, and a clock that stands still or goes back says nothing of the motion.
    """
    if before is None:
        check_metres(rgbd.depth)
    elif (before.width, before.height) != (rgbd.camera.width, rgbd.camera.height):
        raise IdRgbdoError(
            f"camera: expected images of {before.width}x{before.height} as before, got "
            f"{rgbd.camera.width}x{rgbd.camera.height}; call reset() for another camera"
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
    intruded: bool = False  # something moved in front of it, whose points are left out and whose depth is negative
