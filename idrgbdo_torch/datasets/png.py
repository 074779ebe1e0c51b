"""The PNG files that depth cameras write, inflated by libdeflate; every other one is left to OpenCV.

Nothing is judged here: a file that is damaged, or holds what this does not know, gives None, and whoever falls back on
OpenCV finds the words for it.
"""

from __future__ import annotations

from struct import Struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .unfilter import unfilter_color, unfilter_gray16

try:
    import deflate
except ImportError:  # there is no wheel for every machine
    deflate = None

SIGNATURE = b"\x89PNG\r\n\x1a\n"
HEADER = Struct(">IIBBBBB")  # width, height, bits, type, compression, filter method, interlacing
CHUNK, CHECKSUM = Struct(">I4s"), Struct(">I")
# what does not change how OpenCV reads a file; transparency, palettes and animations do
IGNORED = frozenset((b"tEXt", b"zTXt", b"iTXt", b"tIME", b"pHYs", b"gAMA", b"cHRM", b"sRGB", b"iCCP", b"sBIT", b"eXIf"))
GRAY, RGB, RGBA = 0, 2, 6
MOST_INFLATED = 1032  # bytes that one stored byte can stand for


class Stored(NamedTuple):
    """A PNG whose checksums are right, before it is inflated."""

    width: int
    height: int
    bits: int  # of a channel
    kind: int
    pixels: bytes

    def inflated(self, pixel_bytes: int) -> NDArray[np.uint8] | None:
        """(H * (1 + pixel_bytes W),) rows as they are stored, or None where there are more or fewer."""
        size = self.height * (1 + pixel_bytes * self.width)
        if not 0 < size <= MOST_INFLATED * len(self.pixels):  # do not allocate what a false header asks for
            return None
        try:
            rows = deflate.zlib_decompress(self.pixels, size)
        except deflate.DeflateError:
            return None
        return np.frombuffer(rows, np.uint8) if len(rows) == size else None


def decode_png(data: bytes, *, color: bool) -> NDArray[Any] | None:
    """(H, W, 3) uint8 blue, green, red of RGB or RGBA of 8 bits where colour is wanted, else (H, W) uint16 of 16 bits.

    None where the file holds something else, is damaged or no PNG, or where libdeflate is not installed.
    """
    stored = _stored(data) if deflate is not None else None
    if stored is None:
        return None
    if color and stored.bits == 8 and stored.kind in (RGB, RGBA):
        step = 3 if stored.kind == RGB else 4
        rows = stored.inflated(step)
        if rows is None:
            return None
        bgr = np.empty((stored.height, stored.width, 3), np.uint8)
        return bgr if unfilter_color(rows, bgr, step) else None
    if not color and stored.bits == 16 and stored.kind == GRAY:
        rows = stored.inflated(2)
        if rows is None:
            return None
        gray = np.empty((stored.height, stored.width), np.uint16)
        return gray if unfilter_gray16(rows, gray) else None
    return None


def _stored(data: bytes) -> Stored | None:
    """Walk the chunks (length, name, content, checksum) from IHDR to IEND."""
    if not data.startswith(SIGNATURE + b"\0\0\0\rIHDR"):
        return None
    view = memoryview(data)  # slices of it are no copies
    pixels: list[memoryview] = []
    position, before = len(SIGNATURE), b""
    while position + 12 <= len(data):
        length, name = CHUNK.unpack_from(data, position)
        end = position + 8 + length
        # this crc32 keeps Python's lock: chunks are of 8 KB, done sooner than the lock is given up and had again
        if end + 4 > len(data) or deflate.crc32(view[position + 4 : end]) != CHECKSUM.unpack_from(data, end)[0]:
            return None
        if name == b"IDAT" and (before == b"IDAT" or not pixels):
            pixels.append(view[position + 8 : end])
        elif name == b"IEND":
            return _with_header(data, b"".join(pixels))
        elif name not in IGNORED and position > len(SIGNATURE):
            return None
        position, before = end + 4, name
    return None


def _with_header(data: bytes, pixels: bytes) -> Stored | None:
    width, height, bits, kind, *methods = HEADER.unpack_from(data, len(SIGNATURE) + 8)
    return None if any(methods) else Stored(width, height, bits, kind, pixels)
