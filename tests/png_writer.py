"""PNG files of any kind, made byte by byte: every filter, bit depth and oddity that an encoder may choose."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

SIGNATURE = b"\x89PNG\r\n\x1a\n"
GRAY, RGB, PALETTE, GRAY_ALPHA, RGBA = 0, 2, 3, 4, 6
CHANNELS = {GRAY: 1, RGB: 3, PALETTE: 1, GRAY_ALPHA: 2, RGBA: 4}


def chunk(name: bytes, content: bytes = b"") -> bytes:
    """Length, name, content, checksum."""
    return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))


def header(width: int, height: int, bits: int, kind: int, interlaced: int = 0) -> bytes:
    """The first chunk."""
    return chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, kind, 0, 0, interlaced))


def image_bytes(image: NDArray[np.generic], bits: int) -> tuple[NDArray[np.uint8], int]:
    """(H, B) bytes of the rows of (H, W) or (H, W, C) values, and the bytes that filters look to the left."""
    rows = image.reshape(len(image), -1)
    channels = 1 if image.ndim == 2 else image.shape[2]
    if bits == 16:
        rows = np.ascontiguousarray(rows.astype(">u2")).view(np.uint8)
    elif bits < 8:
        planes = (rows[..., None] >> np.arange(bits - 1, -1, -1)) & 1
        rows = np.packbits(planes.reshape(len(rows), -1).astype(np.uint8), axis=1)
    return rows.astype(np.uint8), max(channels * bits // 8, 1)


def predictions(row: NDArray[np.uint8], above: NDArray[np.uint8], left: int) -> list[NDArray[np.int64]]:
    """What each of the five filters subtracts from a row, as the standard writes it."""
    a = np.concatenate([np.zeros(left, np.int64), row[:-left].astype(np.int64)])
    b = above.astype(np.int64)
    c = np.concatenate([np.zeros(left, np.int64), b[:-left]])
    p = a + b - c
    pa, pb, pc = abs(p - a), abs(p - b), abs(p - c)
    paeth = np.where((pa <= pb) & (pa <= pc), a, np.where(pb <= pc, b, c))
    return [np.zeros_like(a), a, b, (a + b) // 2, paeth]


def filtered(image: NDArray[np.generic], bits: int, filters: Sequence[int]) -> bytes:
    """The rows as stored before compression, filtered with `filters` in turn."""
    rows, left = image_bytes(image, bits)
    stored = bytearray()
    above = np.zeros_like(rows[0])
    for number, row in enumerate(rows):
        kind = filters[number % len(filters)]
        stored.append(kind)
        stored += ((row - predictions(row, above, left)[kind]) & 255).astype(np.uint8).tobytes()
        above = row
    return bytes(stored)


def png(
    image: NDArray[np.generic],
    bits: int,
    kind: int,
    filters: Sequence[int] = (0,),
    before: bytes = b"",
    parts: int = 1,
) -> bytes:
    """A whole file. before: chunks between the header and the pixels. parts: IDAT chunks."""
    height, width = image.shape[:2]
    pixels = zlib.compress(filtered(image, bits, filters))
    size = -(-len(pixels) // parts)
    data = b"".join(chunk(b"IDAT", pixels[at : at + size]) for at in range(0, len(pixels), size))
    return SIGNATURE + header(width, height, bits, kind) + before + data + chunk(b"IEND")
