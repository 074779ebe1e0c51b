"""Image files, decoded only when they are whole: OpenCV fills the missing part of a truncated file with gray."""

from __future__ import annotations

import os
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import IdRgbdoError
from .exr import read_exr
from .jpeg import decode_jpeg
from .png import SIGNATURE as PNG_SIGNATURE
from .png import decode_png

# what OpenCV reads, numpy's arrays, and EXR
IMAGE_SUFFIXES = frozenset(
    (".png", ".jpg", ".jpeg", ".jpe", ".jp2", ".bmp", ".dib", ".tif", ".tiff", ".webp", ".avif", ".gif", ".pbm", ".pgm")
    + (".ppm", ".pnm", ".pxm", ".pam", ".pfm", ".sr", ".ras", ".hdr", ".pic", ".npy", ".npz", ".exr")
)
JPEG_START, JPEG_END = b"\xff\xd8", b"\xff\xd9"
JPEG_TAIL = 1024  # bytes in which the end marker must stand; some cameras pad


def read_color(path: Path) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 in OpenCV's order blue, green, red. Raises IdRgbdoError for a file that is not a whole image."""
    return decode_color(_bytes(path), str(path))


def read_depth(path: Path) -> NDArray[Any]:
    """(H, W) raw depth: integers of an image or an array (.npy, .npz), or float32 of either or of an EXR file.

    Raises IdRgbdoError for a file that is damaged or something else.
    """
    suffix = path.suffix.lower()
    if suffix in (".npy", ".npz"):
        return as_depth(_read_array(path), str(path))
    if suffix == ".exr":
        return as_depth(read_exr(path), str(path))
    return decode_depth(_bytes(path), str(path))


def decode_color(data: bytes, where: str) -> NDArray[np.uint8]:
    """An encoded colour image as in `read_color`; `where` leads the messages."""
    image = _decode(data, where, cv2.IMREAD_COLOR_BGR | cv2.IMREAD_IGNORE_ORIENTATION)
    return image.astype(np.uint8, copy=False)


def decode_depth(data: bytes, where: str) -> NDArray[Any]:
    """An encoded depth image as in `read_depth`; `where` leads the messages."""
    return as_depth(_decode(data, where, cv2.IMREAD_UNCHANGED), where)


def as_depth(image: NDArray[Any], where: str) -> NDArray[Any]:
    """An array as raw depth: (H, W) of native integers of 16 bits or more, or float32.

    Axes of length 1 are dropped, and so are channels that repeat the first one (and an alpha channel beside them).
    Raises IdRgbdoError for eight bits, which hold no depth, for colours, and for anything that is no image.
    """
    plain = _one_channel(image)
    channels = 1 if plain.ndim == 2 else plain.shape[-1]
    if plain.ndim == 2 and plain.dtype.kind == "f":
        return plain.astype(np.float32)
    if plain.ndim == 2 and plain.dtype.kind in "iu" and plain.dtype.itemsize > 1:
        return plain.astype(plain.dtype.newbyteorder("="), copy=False)
    if plain.ndim == 2 and plain.dtype.itemsize == 1:
        raise IdRgbdoError(
            f"{where}: expected depth of 16 bits, got an 8-bit depth image ({image.dtype}), whose steps are too coarse "
            "and whose scale nothing tells; save it as 16-bit PNG or as floats, or check that it is no gray picture"
        )
    raise IdRgbdoError(
        f"{where}: expected a 16-bit depth image of one channel, got {image.dtype} with {channels}; "
        "check that colour and depth are not mixed up"
    )


def _one_channel(image: NDArray[Any]) -> NDArray[Any]:
    if image.ndim == 3 and image.shape[-1] in (2, 3, 4) and min(image.shape[:2]) > 1:
        gray = image[..., : 1 if image.shape[-1] == 2 else 3]
        return image[..., 0] if np.array_equal(gray, np.broadcast_to(gray[..., :1], gray.shape)) else image
    if image.ndim == 3 and 1 in (image.shape[0], image.shape[-1]):
        return image[..., 0] if image.shape[-1] == 1 else image[0]
    return image


def _read_array(path: Path) -> NDArray[Any]:
    """The array of a .npy file, or the one of a .npz file, the one called depth where there are several."""
    again = "write it again with numpy.save"
    try:
        content = np.load(path, allow_pickle=False)
        if not isinstance(content, np.lib.npyio.NpzFile):
            return np.asarray(content)
        with content:
            names = [name for name in content.files if len(content.files) == 1 or "depth" in name.lower()]
            if len(names) == 1:
                return np.asarray(content[names[0]])
            there = ", ".join(content.files) or "nothing"
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise IdRgbdoError(f"{path}: cannot read the depth ({error}); {again}") from error
    raise IdRgbdoError(f"{path}: expected one array called depth, found {there}; {again}")


def _bytes(path: Path) -> bytes:
    try:
        return _content(path)
    except OSError as error:
        raise IdRgbdoError(f"{path}: cannot read the image ({error.strerror}); check the list that names it") from error


def _content(path: Path) -> bytes:
    """As Path.read_bytes with half its system calls, each of which gives up Python's lock and then waits for it."""
    file = os.open(path, os.O_RDONLY | getattr(os, "O_BINARY", 0))
    try:
        size = os.fstat(file).st_size
        data = os.read(file, size)
        return data if 0 < len(data) == size else path.read_bytes()  # in parts, or no plain file
    finally:
        os.close(file)


def _decode(data: bytes, where: str, flags: int) -> NDArray[Any]:
    color = flags != cv2.IMREAD_UNCHANGED
    image = decode_png(data, color=color)  # looks for damage itself
    if image is not None:
        return image
    damage = _damage(data)
    if damage:
        raise IdRgbdoError(f"{where}: {damage}; copy or download it again")
    image = decode_jpeg(data) if color else None
    if image is None:
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
