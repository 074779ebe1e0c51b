"""Image files, decoded only when they are whole: OpenCV fills the missing part of a truncated file with gray."""

from __future__ import annotations

import io
import struct
import warnings
import zipfile
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import IdRgbdoError
from ..text.files import DAMAGE, plain_bytes
from ..text.plain import shown
from .exr import read_exr
from .image_size import declared_size
from .jpeg import decode_jpeg
from .packed import member_bytes
from .png import MOST_INFLATED, decode_png
from .png import SIGNATURE as PNG_SIGNATURE

# what OpenCV reads, numpy's arrays, and EXR
IMAGE_SUFFIXES = frozenset(
    (".png", ".jpg", ".jpeg", ".jpe", ".jp2", ".bmp", ".dib", ".tif", ".tiff", ".webp", ".avif", ".gif", ".pbm", ".pgm")
    + (".ppm", ".pnm", ".pxm", ".pam", ".pfm", ".sr", ".ras", ".hdr", ".pic", ".npy", ".npz", ".exr")
)
MOST_PIXELS = 1 << 24  # of an image: 4096x4096, more than any depth camera has; memory is made for them
MOST_BYTES = 32 * MOST_PIXELS  # of its file: four channels of 64 bits
MOST_ARRAY = 8 * MOST_PIXELS + (64 << 10)  # of an array in an archive: 64 bits, and its head
TOO_MANY = 64 << 20  # bytes that the rows of a PNG may have besides those that it declares
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
        return as_depth(read_exr(path, MOST_PIXELS), str(path))
    return decode_depth(_bytes(path), str(path))


def decode_color(data: bytes, where: str) -> NDArray[np.uint8]:
    """An encoded colour image as in `read_color`; `where` leads the messages."""
    image = _decode(data, where, cv2.IMREAD_COLOR_BGR | cv2.IMREAD_IGNORE_ORIENTATION)
    return image.astype(np.uint8, copy=False)


def decode_depth(data: bytes, where: str) -> NDArray[Any]:
    """An encoded depth image as in `read_depth`; `where` leads the messages."""
    return as_depth(_decode(data, where, cv2.IMREAD_UNCHANGED), where)


def read_labels(path: Path) -> NDArray[Any] | None:
    """(H, W) whole numbers of an image, such as confidences; None where it cannot be read."""
    try:
        return _decode(_bytes(path), str(path), cv2.IMREAD_UNCHANGED)
    except IdRgbdoError:
        return None


def as_depth(image: NDArray[Any], where: str) -> NDArray[Any]:
    """An array as raw depth: (H, W) of native integers of 16 bits or more, or float32.

    Axes of length 1 are dropped, and so are channels that repeat the first one (and an alpha channel beside them).
    Raises IdRgbdoError for eight bits, which hold no depth, for colours, and for anything that is no image.
    """
    plain = _one_channel(image)
    refuse_size(plain.shape[::-1][:2] if plain.ndim == 2 else (plain.size, 1), where)
    channels = plain.shape[-1] if plain.ndim > 2 else 1
    if plain.ndim == 2 and plain.dtype.kind == "f":
        with np.errstate(over="ignore"):  # infinity is unknown depth
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
    data = _bytes(path)
    try:
        if not zipfile.is_zipfile(io.BytesIO(data)):
            return _array(data)
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = [name.removesuffix(".npy") for name in archive.namelist()]
            names = [k for k, name in enumerate(members) if len(members) == 1 or "depth" in name.lower()]
            if len(names) == 1:
                return _array(member_bytes(archive, archive.infolist()[names[0]], MOST_ARRAY))
            there = shown(", ".join(members), quoted=False) or "nothing"
    except (*DAMAGE, RuntimeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise IdRgbdoError(f"{path}: cannot read the depth ({shown(error, quoted=False)}); {again}") from error
    raise IdRgbdoError(f"{path}: expected one array called depth, found {there}; {again}")


def _array(data: bytes) -> NDArray[Any]:
    """The array of .npy text. Whatever numpy raises for others comes out."""
    with warnings.catch_warnings():  # of shapes that overflow
        warnings.simplefilter("ignore")
        return np.asarray(np.lib.format.read_array(io.BytesIO(data), allow_pickle=False))


def _bytes(path: Path) -> bytes:
    try:
        return plain_bytes(path, MOST_BYTES)
    except OSError as error:
        raise IdRgbdoError(f"{path}: cannot read the image ({error.strerror}); check the list that names it") from error


def refuse_size(size: tuple[int, ...], where: str) -> None:
    """Raises IdRgbdoError for images of (width, height) px that no camera has, or none at all."""
    width, height = size
    if width * height > MOST_PIXELS:
        raise IdRgbdoError(
            f"{where}: expected an image of at most {MOST_PIXELS >> 20} million pixels, got {width}x{height}; "
            "replace it, or resize the images"
        )
    if width * height == 0:
        raise IdRgbdoError(f"{where}: expected an image, got one of {width}x{height} pixels; replace it")


def _decode(data: bytes, where: str, flags: int) -> NDArray[Any]:
    color = flags != cv2.IMREAD_UNCHANGED
    size = declared_size(data)
    if size is not None:
        refuse_size(size, where)
    image = decode_png(data, color=color)  # looks for damage itself
    if image is not None:
        return image
    damage = _damage(data)
    if damage:
        raise IdRgbdoError(f"{where}: {damage}; copy or download it again")
    image = decode_jpeg(data) if color else None
    if image is None:
        try:
            image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
        except cv2.error as error:
            why = shown(str(error).strip().splitlines()[-1].strip(), quoted=False)
            raise IdRgbdoError(f"{where}: OpenCV cannot decode the image ({why}); replace it") from error
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
    rows: list[bytes] = []
    while position + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, position)
        end = position + 8 + length
        if end + 4 > len(data):
            break
        if struct.unpack_from(">I", data, end)[0] != zlib.crc32(data[position + 4 : end]):
            return f"damaged PNG (wrong checksum near byte {position})"
        kind = data[position + 4 : position + 8]
        if kind == b"IEND":
            return _too_many_rows(b"".join(rows), data)
        rows += [data[position + 8 : end]] if kind == b"IDAT" else []
        position = end + 4
    return f"truncated PNG ({len(data)} bytes without an end chunk)"


def _too_many_rows(packed: bytes, data: bytes) -> str:
    """Whether the rows of a PNG unpack to far more than it declares, all of which OpenCV would unpack."""
    width, height, bits, kind = struct.unpack_from(">IIBB", data, 16)
    most = height * (1 + width * bits * (4 if kind == 6 else 3) // 8) + TOO_MANY
    if len(packed) * MOST_INFLATED <= most:
        return ""
    try:
        unpacked = zlib.decompressobj().decompress(packed, most)
    except zlib.error:
        return ""  # for OpenCV to tell
    return "damaged PNG (its rows are far more than it says)" if len(unpacked) >= most else ""
