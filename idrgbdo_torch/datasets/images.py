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
    return decode_color(_bytes(path), str(path))


def read_depth(path: Path) -> NDArray[Any]:
    """(H, W) raw depth: uint16 of an image, float32 metres of an image of floats or a .npy file.

    Raises IdRgbdoError for a file that is damaged or something else.
    """
    return _read_npy(path) if path.suffix == ".npy" else decode_depth(_bytes(path), str(path))


def decode_color(data: bytes, where: str) -> NDArray[np.uint8]:
    """An encoded colour image as in `read_color`; `where` leads the messages."""
    image = _decode(data, where, cv2.IMREAD_COLOR_BGR | cv2.IMREAD_IGNORE_ORIENTATION)
    return image.astype(np.uint8, copy=False)


def decode_depth(data: bytes, where: str) -> NDArray[Any]:
    """An encoded depth image as in `read_depth`; `where` leads the messages."""
    return _depth(_decode(data, where, cv2.IMREAD_UNCHANGED), where)


def _read_npy(path: Path) -> NDArray[Any]:
    try:
        array = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise IdRgbdoError(f"{path}: cannot read the depth ({error}); write it again with numpy.save") from error
    return _depth(array, str(path))


def _depth(image: NDArray[Any], where: str) -> NDArray[Any]:
    if image.ndim == 2 and image.dtype == np.uint16:
        return image
    if image.ndim == 2 and image.dtype in (np.float32, np.float64):
        return image.astype(np.float32, copy=False)
    channels = 1 if image.ndim == 2 else image.shape[-1]
    raise IdRgbdoError(
        f"{where}: expected a 16-bit depth image of one channel, got {image.dtype} with {channels}; "
        "check that colour and depth are not mixed up"
    )


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise IdRgbdoError(f"{path}: cannot read the image ({error.strerror}); check the list that names it") from error


def _decode(data: bytes, where: str, flags: int) -> NDArray[Any]:
    damage = _damage(data)
    if damage:
        raise IdRgbdoError(f"{where}: {damage}; copy or download it again")
    image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    if image is None:
        raise IdRgbdoError(f"{where}: expected an image that OpenCV can decode, got {len(data)} bytes; replace it")
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
