"""From raw pixels to gray levels and metres, each in one call that does not hold Python's lock."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from ..kernels.compiled import exact_kernel

RED, GREEN, BLUE = np.float32(0.299), np.float32(0.587), np.float32(0.114)  # ITU-R BT.601


def gray_and_rgb(bgr: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """(H, W) gray levels and (H, W, 3) red, green, blue of (H, W, 3) blue, green, red.

    The gray levels are those of OpenCV's cvtColor of the colours as float32, where that multiplies and adds at once.
    """
    source = np.require(bgr, np.uint8, ["C", "W"])
    gray, rgb = np.empty(bgr.shape[:2], np.float32), np.empty(bgr.shape, np.uint8)
    _gray_and_rgb(source.reshape(-1), gray.reshape(-1), rgb.reshape(-1))
    return gray, rgb


def metres_of_16_bits(depth: NDArray[np.uint16], depth_scale: float, unknown: int) -> NDArray[np.float32]:
    """(H, W) float32 metres, 0 where the raw depth is 0 or `unknown`. depth_scale: values per metre."""
    source = np.require(depth, np.uint16, ["C", "W"])
    depth_m = np.empty(depth.shape, np.float32)
    _metres(source.reshape(-1), np.float32(depth_scale), np.uint16(unknown), depth_m.reshape(-1))
    return depth_m


@intrinsic
def fma(context: Any, a: Any, b: Any, c: Any) -> Any:
    """a * b + c of float32, rounded once on every processor."""
    signature = types.float32(types.float32, types.float32, types.float32)
    return signature, lambda context, builder, signature, values: builder.fma(*values)


@exact_kernel
def _gray_and_rgb(bgr: Any, gray: Any, rgb: Any) -> None:
    # two loops, which the compiler turns into vector instructions; of one that does both it does not
    for pixel in range(len(gray)):
        at = np.uint64(3) * np.uint64(pixel)
        b = bgr[at]
        g = bgr[at + np.uint64(1)]
        r = bgr[at + np.uint64(2)]
        gray[pixel] = fma(np.float32(r), RED, fma(np.float32(b), BLUE, np.float32(g) * GREEN))
    for pixel in range(len(gray)):
        at = np.uint64(3) * np.uint64(pixel)
        b = bgr[at]
        g = bgr[at + np.uint64(1)]
        r = bgr[at + np.uint64(2)]
        rgb[at] = r
        rgb[at + np.uint64(1)] = g
        rgb[at + np.uint64(2)] = b


@exact_kernel
def _metres(raw: Any, depth_scale: Any, unknown: Any, depth_m: Any) -> None:
    for pixel in range(len(raw)):
        value = raw[pixel]
        depth_m[pixel] = np.float32(0) if value == unknown else np.float32(value) / depth_scale
