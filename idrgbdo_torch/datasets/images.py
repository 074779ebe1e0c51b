"""Image files, decoded only when they are whole: OpenCV fills the missing part of a truncated file with gray."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import IdRgbdoError

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
JPEG_START, JPEG_END = b"\xff\xd8", b"\xff\xd9"
JPEG_TAIL = 1024  # bytes in which the end marker must stand; some cameras pad


def read_color(path: Path) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 in OpenCV's order blue, green, red. Raises IdRgbdoError for a file that is not a whole image."""
    image = _decode(path, cv2.IMREAD_COLOR_BGR | cv2.IMREAD_IGNORE_ORIENTATION)
    return image.astype(np.uint8, copy=False)


def read_depth(path: Path) -> NDArray[np.uint16]:
    """(H, W) uint16 raw depth. Raises IdRgbdoError for a file that is not a whole 16-bit image of one channel."""
    image = _decode(path, cv2.IMREAD_UNCHANGED)
    if image.dtype != np.uint16 or image.ndim != 2:
        channels = 1 if image.ndim == 2 else image.shape[2]
        raise IdRgbdoError(
            f"{path}: expected a 16-bit depth image of one channel, got {image.dtype} with {channels}; "
            "check that colour and depth are not mixed up"
        )
    return image.astype(np.uint16, copy=False)


def _decode(path: Path, flags: int) -> NDArray[Any]:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise IdRgbdoError(f"{path}: cannot read the image ({error.strerror}); check the list that names it") from error
    damage = _damage(data)
    if damage:
        raise IdRgbdoError(f"{path}: {damage}; copy or download it again")
    image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    if image is None:
        raise IdRgbdoError(f"{path}: expected an image that OpenCV can decode, got {len(data)} bytes; replace it")
    return np.asarray(image)


def _damage(data: bytes) -> str:
    """What is wrong with an encoded image, as a phrase; empty when it is whole, or of a kind without an end marker."""
    if not data:
        return "empty image file"
    if data.startswith(PNG_SIGNATURE):
        return _png_damage(data)
    if data.startswith(JPEG_START) and JPEG_END not in data[-JPEG_TAIL:]:
        return f"truncated JPEG ({len(data)} bytes without an end marker)"
    return ""


def _png_damage(data: bytes) -> str:
    """Walk the chunks (length, type, data, checksum) up to IEND."""
    position = len(PNG_SIGNATURE)
    while position + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, position)
        end = position + 8 + length
        if end + 4 > len(data):
            break
        if struct.unpack_from(">I", data, end)[0] != zlib.crc32(data[position + 4 : end]):
            return f"damaged PNG (wrong checksum near byte {position})"
        if data[position + 4 : position + 8] == b"IEND":
            return ""
        position = end + 4
    return f"truncated PNG ({len(data)} bytes without an end chunk)"
