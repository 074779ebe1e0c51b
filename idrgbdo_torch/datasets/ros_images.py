"""Images of ROS messages, raw and compressed, as OpenCV has them."""

from __future__ import annotations

import struct
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import IdRgbdoError
from .images import decode_color, decode_depth, refuse_size

# encoding: element type, channels, OpenCV's conversion to blue green red (None: it is that already)
COLOR_ENCODINGS: dict[str, tuple[type[np.uint8], int, int | None]] = {
    "bgr8": (np.uint8, 3, None),
    "8UC3": (np.uint8, 3, None),
    "rgb8": (np.uint8, 3, cv2.COLOR_RGB2BGR),
    "bgra8": (np.uint8, 4, cv2.COLOR_BGRA2BGR),
    "rgba8": (np.uint8, 4, cv2.COLOR_RGBA2BGR),
    "mono8": (np.uint8, 1, cv2.COLOR_GRAY2BGR),
    "8UC1": (np.uint8, 1, cv2.COLOR_GRAY2BGR),
    "yuv422_yuy2": (np.uint8, 2, cv2.COLOR_YUV2BGR_YUY2),
    "yuyv": (np.uint8, 2, cv2.COLOR_YUV2BGR_YUY2),
    "yuv422": (np.uint8, 2, cv2.COLOR_YUV2BGR_UYVY),
    "uyvy": (np.uint8, 2, cv2.COLOR_YUV2BGR_UYVY),
}
DEPTH_ENCODINGS: dict[str, type[np.uint16] | type[np.float32]] = {
    "16UC1": np.uint16,
    "mono16": np.uint16,
    "32FC1": np.float32,
}
DEPTH_HEADER = struct.Struct("<iff")  # of compressedDepth: format, and a, b in depth = a / (value - b)


def is_deep(message: Any) -> bool:
    """Whether an image, raw or compressed, says that it is depth."""
    return "compressedDepth" in message.format if hasattr(message, "format") else message.encoding in DEPTH_ENCODINGS


def color_image(message: Any, where: str) -> NDArray[np.uint8]:
    """(H, W, 3) blue, green, red of an Image or CompressedImage. Raises IdRgbdoError for one that is none."""
    if not hasattr(message, "encoding"):
        return decode_color(message.data.tobytes(), where)
    if message.encoding not in COLOR_ENCODINGS:
        raise IdRgbdoError(
            f"{where}: expected colour as one of {', '.join(COLOR_ENCODINGS)}, got '{message.encoding}'; "
            "record another topic, or name it with --color-topic"
        )
    dtype, channels, conversion = COLOR_ENCODINGS[message.encoding]
    image = _pixels(message, np.dtype(dtype), channels, where)
    if conversion is None:
        return image
    try:
        return np.asarray(cv2.cvtColor(image, conversion), dtype=np.uint8)
    except cv2.error as error:
        raise IdRgbdoError(
            f"{where}: expected '{message.encoding}' of an even width, got {message.width}x{message.height}; "
            "record it as rgb8"
        ) from error


def depth_image(message: Any, where: str) -> NDArray[Any]:
    """(H, W) raw depth of an Image or CompressedImage: uint16 (millimetres by REP 118), or float32 metres.

    Raises IdRgbdoError for anything else.
    """
    if not hasattr(message, "encoding"):
        return _compressed_depth(message, where)
    if message.encoding not in DEPTH_ENCODINGS:
        raise IdRgbdoError(
            f"{where}: expected depth as one of {', '.join(DEPTH_ENCODINGS)}, got '{message.encoding}'; "
            "record another topic, or name it with --depth-topic"
        )
    return _pixels(message, np.dtype(DEPTH_ENCODINGS[message.encoding]), 1, where)


def _pixels(message: Any, dtype: np.dtype[Any], channels: int, where: str) -> NDArray[Any]:
    """The rows of a raw image without their padding, in this machine's byte order."""
    refuse_size((message.width, message.height), where)
    row = message.width * channels * dtype.itemsize
    if message.step < row or len(message.data) < message.step * message.height:
        raise IdRgbdoError(
            f"{where}: expected {message.height} rows of {max(message.step, row)} bytes, got {len(message.data)} bytes "
            "in all; the recording is damaged here"
        )
    rows = message.data[: message.step * message.height].reshape(message.height, message.step)[:, :row]
    stored = dtype.newbyteorder(">" if message.is_bigendian else "<")
    pixels = np.ascontiguousarray(rows).view(stored).astype(dtype)
    return pixels.reshape(message.height, message.width, channels) if channels > 1 else pixels


def _compressed_depth(message: Any, where: str) -> NDArray[Any]:
    """What compressed_depth_image_transport writes: a header, then a PNG of depth or of quantised inverse depth."""
    data = message.data.tobytes()
    if "compressedDepth" not in message.format:
        return decode_depth(data, where)
    if message.format.endswith("rvl"):
        raise IdRgbdoError(f"{where}: expected depth compressed as PNG, got RVL; record it with the PNG format")
    if len(data) <= DEPTH_HEADER.size:
        raise IdRgbdoError(
            f"{where}: expected a compressed depth image, got {len(data)} bytes; the recording is damaged"
        )
    _, a, b = DEPTH_HEADER.unpack_from(data)
    raw = decode_depth(data[DEPTH_HEADER.size :], where)
    if not message.format.startswith("32FC1"):
        return raw
    known = raw > 0
    with np.errstate(all="ignore"):  # what is not finite is unknown depth
        inverse = np.where(known, raw - np.float32(b), np.float32(1))
        return np.where(known, np.float32(a) / inverse, np.float32(0)).astype(np.float32)
