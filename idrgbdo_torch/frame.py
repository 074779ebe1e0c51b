"""What a sensor gives (RgbdFrame, BrokenFrame), what tracking reads (Frame), what it refers to (Keyframe)."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, partial
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .definitions.camera import Pinhole
from .definitions.checks import check_gray, check_metres, extremes, unknown_depth
from .definitions.given import number, plain_tensor
from .errors import IdRgbdoError
from .kernels.pyramid import halve, smooth
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
    is_owned: bool = field(default=False, init=False, repr=False, compare=False)  # see owned()

    def __post_init__(self) -> None:
        """Raises IdRgbdoError for images of another type or size than said, and for gray levels and times that are
        none. Depth that is NaN, infinite or negative becomes 0; numpy arrays become tensors, which share their memory.
        """
        if not isinstance(self.camera, Pinhole):
            raise IdRgbdoError(
                f"camera: expected a Pinhole of these images, got {type(self.camera).__name__}; make one of the "
                "image's size and the intrinsics"
            )
        for name in ("gray", "depth", "color"):
            if name != "color" or self.color is not None:
                object.__setattr__(self, name, plain_tensor(name, getattr(self, name)))
        object.__setattr__(self, "timestamp", _seconds(self.timestamp))
        self.check_images()
        check_gray(self.gray)
        nearest, farthest = extremes(self.depth)
        if not (nearest >= 0 and farthest < float("inf")):  # nor NaN
            there = self.depth.isfinite() & (self.depth > 0)
            object.__setattr__(self, "depth", torch.where(there, self.depth, 0.0))

    def check_images(self) -> None:
        """Raises IdRgbdoError for images that are no dense tensors of the types and sizes said."""
        size = (self.camera.height, self.camera.width)
        for name, image in (("gray", self.gray), ("depth", self.depth)):
            if not _is_plain(image, torch.float32, size):
                raise IdRgbdoError(
                    f"{name}: expected a float32 tensor of shape {size} (the camera's height, width), "
                    f"got {_described(image)}; convert it (RgbdFrame.from_images takes colour and depth "
                    "as cameras give them) or pass the matching camera"
                )
        if self.color is not None and not _is_plain(self.color, torch.uint8, (*size, 3)):
            raise IdRgbdoError(
                f"color: expected a uint8 tensor of shape {(*size, 3)}, red green blue, got {_described(self.color)}; "
                "convert it, or leave it out"
            )

    def owned(self) -> RgbdFrame:
        """This frame, whose images nobody else will write to: they are not copied when it is tracked."""
        object.__setattr__(self, "is_owned", True)
        return self

    def copied(self) -> RgbdFrame:
        """The same frame with images of its own, for who keeps it while the camera's buffers are filled again."""
        if self.is_owned:
            return self
        out = copy(self)
        for name in ("gray", "depth", "color"):
            if (image := getattr(self, name)) is not None:
                object.__setattr__(out, name, image.detach().clone())
        return out

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
        1000 where they are millimetres, 5000 in TUM's files. Of integers of 16 bits or more 0 and the largest value are
        unknown, as in files. Raises IdRgbdoError for anything else.
        """
        color, z = plain_tensor("rgb", rgb), plain_tensor("depth", depth)
        if not isinstance(camera, Pinhole):
            raise IdRgbdoError(f"camera: expected a Pinhole, got {type(camera).__name__}; make one of the intrinsics")
        size = (camera.height, camera.width)
        if color.dim() == 3 and tuple(color.shape) == (3, *size):
            color = color.permute(1, 2, 0)
        if color.dtype != torch.uint8 or tuple(color.shape) not in ((*size, 3), size):
            raise IdRgbdoError(
                f"rgb: expected uint8 of shape {(*size, 3)} or {size} (the camera's height, width), got {color.dtype} "
                f"{tuple(color.shape)}; convert it (a float image in 0..1: times 255) or pass the matching camera"
            )
        if depth_scale is not None and not number("depth_scale", depth_scale, "depth values per metre") > 0:
            raise IdRgbdoError(f"depth_scale: expected depth values per metre, above 0, got {depth_scale}; change it")
        if depth_scale is None and not z.dtype.is_floating_point:
            raise IdRgbdoError(
                f"depth_scale: expected the values per metre of {z.dtype} depth, got none; pass 1000 for millimetres"
            )
        metres = z.to(torch.float32) / float(depth_scale or 1.0)
        if not z.dtype.is_floating_point and z.element_size() > 1:
            metres.numpy()[z.numpy() == unknown_depth(z.numpy())] = 0
        color = color.contiguous()
        if color.dim() == 2:
            return cls(timestamp, color.float(), metres, camera, color[..., None].expand(*size, 3).contiguous()).owned()
        gray = cv2.cvtColor(color.numpy().astype(np.float32), cv2.COLOR_RGB2GRAY)  # ITU-R BT.601
        return cls(timestamp, torch.from_numpy(gray), metres, camera, color.clone()).owned()


def _is_plain(image: object, dtype: torch.dtype, shape: tuple[int, ...]) -> bool:
    if not isinstance(image, Tensor) or image.is_nested or image.layout != torch.strided:
        return False
    return image.device.type == "cpu" and image.dtype == dtype and tuple(image.shape) == shape


def _described(image: object) -> str:
    if not isinstance(image, Tensor) or image.is_nested or image.layout != torch.strided or image.is_meta:
        return f"{type(image).__name__} that is no dense tensor"
    return f"{image.dtype} {tuple(image.shape)}"


def _seconds(timestamp: object) -> float:
    """Raises IdRgbdoError for a time that is no number of seconds."""
    seconds = number("timestamp", timestamp, "seconds")
    if not abs(seconds) <= NO_SECONDS:
        raise IdRgbdoError(
            f"timestamp: expected seconds, got {seconds:g}; divide milliseconds by 1e3, nanoseconds by 1e9"
        )
    return seconds


def check_next(rgbd: RgbdFrame, before: Pinhole | None) -> None:
    """What an odometry can't take from its caller: depth in no metres at the start, images of another size than before.

    before: the camera of the frames before, None where there is no keyframe yet. Raises IdRgbdoError; a bad image, on
    the other hand, is a lost frame, and a clock that stands still or goes back says nothing of the motion.
    """
    if not isinstance(rgbd, RgbdFrame):
        hint = "run() takes those that could not be read" if isinstance(rgbd, BrokenFrame) else "make one of the images"
        raise IdRgbdoError(f"frame: expected an RgbdFrame, got {type(rgbd).__name__}; {hint}")
    rgbd.check_images()  # whoever goes round the constructor would spoil frames to come
    _seconds(rgbd.timestamp)
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

    def __post_init__(self) -> None:
        """Raises IdRgbdoError for a time that is none."""
        object.__setattr__(self, "timestamp", _seconds(self.timestamp))


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
        return intrinsics_of_levels(self.camera, len(self.images))

    @cached_property
    def view(self) -> View:
        """What an alignment reads of it."""
        return View(self.images, self.depth, self.intrinsics)


@lru_cache(maxsize=16)  # a sequence has one camera
def intrinsics_of_levels(camera: Pinhole, levels: int) -> Image:
    """(L, 4) float64, read-only: fx fy cx cy of every level."""
    cameras = [camera.at_level(level) for level in range(levels)]
    intrinsics = np.array([[c.fx, c.fy, c.cx, c.cy] for c in cameras])
    intrinsics.flags.writeable = False
    return intrinsics


def prepare(rgbd: RgbdFrame, blur: float = 0.0) -> Frame:
    """Gray pyramid by 2x2 means, which is what Pinhole.at_level assumes; the coarse levels are blurred.

    Without that blur, texture aliases on the coarse levels and Gauss-Newton crawls there. blur: px, standard deviation
    of one of the finest level, from which the others do not take it. The input is not changed, and nothing of its
    memory is kept unless it is owned: cameras fill their buffers again.
    Raises IdRgbdoError for images that have no coarsest level.
    """
    least = 2 ** (LEVELS - 1)
    if min(rgbd.camera.width, rgbd.camera.height) < least:
        raise IdRgbdoError(
            f"frame: expected images of at least {least}x{least} pixels, got {rgbd.camera.width}x{rgbd.camera.height}; "
            "record larger ones"
        )
    own = np.ascontiguousarray if rgbd.is_owned else partial(np.array, order="C")
    images = gray_pyramid(of_numbers(own(rgbd.gray.detach().numpy())), LEVELS)
    sharp = images[0]
    if blur > 0.0:
        images[0] = smoothed(sharp, blur)
    depth = own(rgbd.depth.detach().numpy())
    color = rgbd.color if rgbd.color is None or rgbd.is_owned else rgbd.color.clone()
    return Frame(rgbd.timestamp, rgbd.camera, tuple(images), depth, color, sharp)


def of_numbers(image: Image) -> Image:
    """The image (H, W), black where a pixel is no number: it would spread over the coarse levels, and from a keyframe
    into all that a window knows.
    """
    values = image.ravel()
    if np.isfinite(np.dot(values, values)):
        return image
    return np.nan_to_num(image, nan=0.0)


def gray_pyramid(image: Image, levels: int) -> list[Image]:
    """The image (H, W) float32 itself and its levels - 1 halvings, blurred."""
    images = [image]
    while len(images) < levels:
        height, width = image.shape
        half = np.empty((max(height // 2, 1), max(width // 2, 1)), np.float32)
        halve(image, half)
        images.append(smoothed(half, COARSE_BLUR))
        image = half
    return images


def smoothed(image: Image, sigma: float) -> Image:
    """An image (H, W) float32 blurred by a Gaussian of so many px, over 5x5 pixels."""
    out = np.empty_like(image)
    smooth(image, blur_taps(sigma), out)
    return out


@lru_cache(maxsize=16)
def blur_taps(sigma: float) -> Image:
    """(3,) float32, read-only: the weights of a pixel and of those 1 and 2 px away."""
    weights = np.exp(-0.5 * (np.arange(3.0) / sigma) ** 2)
    return np.asarray(weights / (weights[0] + 2.0 * weights[1:].sum()), np.float32)


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
    sharp: float = 1.0  # its sharpness over that of the last keyframe that was not blurred
