"""Whether images are in the units that everything here takes, gray levels 0 to 255 and metres, and fit each other."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..errors import IdRgbdoError
from .camera import Pinhole
from .points import HostPoints

GRAY_ROOM = 512  # gray levels beyond 0..255 that noise, interpolation or a change of exposure may make
DARK_LEVELS = 32  # different values up to 1 in an image that is merely dark
SATURATED = (2**16 - 1, 2**32 - 1)  # the largest unsigned integers, which some cameras write for "no depth"
FARTHEST_M = 100.0  # median depth
LEAST_VIEW = 0.3  # share of the points that the target must see
LARGEST_RMS = 2.0  # median whitened residual: 0.5 to 1.6 between real images of one place, mostly above 2.2 of others
LEAST_CONTRAST = 0.3  # of the host's points that the target's image must have
LARGEST_GAIN = 1.0  # of the logarithm; both since with no contrast left, a black or a white image explains everything


def check_gray(gray: Tensor) -> float:
    """The brightest of gray levels (..., H, W); NaN passes.

    Raises IdRgbdoError where they are not 0..255, but numbers in 0..1 or of 16 bits.
    """
    low, high = extremes(gray)
    if low != low:  # what is there besides NaN
        low, high = extremes(torch.where(gray.isnan(), 0.0, gray))
    if low < -GRAY_ROOM or high > 255 + GRAY_ROOM:
        raise IdRgbdoError(f"gray: expected gray levels 0..255, got {low:g} to {high:g}; scale the image")
    # a dark image has few levels below 1, a bright one divided by 255 has many
    if low >= 0 and 0 < high <= 1 and len(set(gray.detach()[..., ::4, ::4].flatten().tolist())) > DARK_LEVELS:
        raise IdRgbdoError(f"gray: expected gray levels 0..255, got at most {high:g}; multiply the image by 255")
    return high


def extremes(image: Tensor) -> tuple[float, float]:
    """The least and the largest value; NaN where there is one.

    By numpy on the CPU: torch shares so little work out to threads, and on a busy machine waits 10 ms for them.
    """
    image = image.detach()
    if image.device.type == "cpu" and image.dtype in (torch.float32, torch.float64):
        return float(image.numpy().min()), float(image.numpy().max())
    low, high = torch.stack(image.aminmax()).tolist()  # a GPU is waited for once
    return low, high


def unknown_depth(depth: NDArray[Any]) -> int:
    """The raw depth that stands for "not measured" besides 0, of integers of 16 bits or more.

    It is the largest of their type, or of a narrower one where that is the image's largest: depth may come in a wider
    type than the camera gave it in.
    """
    largest = int(depth.max(initial=0))
    return largest if largest in SATURATED else int(np.iinfo(depth.dtype).max)


def check_metres(depth: Tensor) -> None:
    """Raises IdRgbdoError where most of the depth (..., H, W), 0 for none, is further than any depth camera sees."""
    z = depth.detach()[..., ::4, ::4]
    median = float(torch.where((z > 0) & z.isfinite(), z, torch.nan).nanmedian())  # NaN where there is none
    if median > FARTHEST_M:
        raise IdRgbdoError(
            f"depth: expected metres, got a median of {median:.4g}; divide by 1000 if these are millimetres"
        )


def checked_targets(
    points: HostPoints, gray: Tensor, depth: Tensor | None, camera: Pinhole
) -> tuple[Tensor, Tensor | None]:
    """Images (B, H, W) as align_pairs takes them: floats, of the camera's size. Raises IdRgbdoError as it says.

    Nothing here looks at a value, so no device is waited for.
    """
    size = (camera.height, camera.width)
    for name, image in (("gray", gray), ("depth", depth)):
        if image is not None and tuple(image.shape) != (len(points.uv), *size):
            raise IdRgbdoError(
                f"{name}: expected ({len(points.uv)}, {size[0]}, {size[1]}), pairs and the camera's height and width, "
                f"got {tuple(image.shape)}; pass the camera of these images (camera.at_level(1) for half the size)"
            )
    gray = gray if gray.is_floating_point() else gray.float()
    if depth is not None:
        depth = depth if depth.is_floating_point() else depth.float()
    return gray, depth


def check_points(points: HostPoints, gray: Tensor, depth: Tensor | None) -> None:
    """Raises IdRgbdoError where points or images (B, H, W) are in other units than gray levels 0..255 and metres."""
    check_levels(points, check_gray(gray))
    if depth is not None:
        check_metres(depth)


def check_levels(points: HostPoints, brightest: float) -> None:
    """Raises IdRgbdoError where the points have other units than images up to so many gray levels, or than metres."""
    if float(points.patch[0].detach().amax()) <= 1 < brightest:
        raise IdRgbdoError("points: expected patches of gray levels 0..255, got 0..1; multiply the images by 255")
    known = points.inverse_depth.detach()
    check_metres(torch.where(known > 0, 1 / known.clamp(min=1e-9), 0.0)[..., None, None].expand(*known.shape, 1, 1))


def believable(points: HostPoints, contrast: Tensor, rms: Tensor, affine: Tensor) -> Tensor:
    """(B,) bool: whether the images show the same: points in view, residuals within the noise, contrast left.

    contrast: (B,) standard deviation of the targets' gray levels.
    """
    there, seen = (points.inverse_depth > 0).sum(-1), rms >= 0
    typical = torch.where(seen, rms, torch.nan).nanmedian(-1).values
    in_view = seen.sum(-1) >= LEAST_VIEW * there
    hosts = points.patch[0].flatten(1).std(-1)
    clear = (affine[:, 0].abs() <= LARGEST_GAIN) & (contrast >= LEAST_CONTRAST * hosts)
    return in_view & (typical <= LARGEST_RMS) & clear
