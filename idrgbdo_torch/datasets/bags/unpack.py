"""Unpacks pieces of recordings in steps, so that one that was made to fill the memory is noticed before it does."""

from __future__ import annotations

from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from ...text.files import open_plain
from ..bag_files import damage

MOST_UNPACKED = 256 << 20  # bytes of a chunk or a message; the largest image of a camera is 50 MB, usual chunks 1 to 4
STEP = 1 << 20  # bytes that are unpacked at a time
SMALL_STEP = 16 << 10  # packed bytes, of which all are lost where one is damaged
MOST_RATIO, SLACK = 100, 256 << 20  # times the stored bytes, plus bytes, that a whole recording may unpack to
ZSTD_START = b"\x28\xb5\x2f\xfd"
COMPRESSIONS = ("", "none", "lz4", "zstd", "bz2")


def unpacked(data: bytes, compression: str, most: int = MOST_UNPACKED) -> bytes | bytearray:
    """What is packed in `data` by one of COMPRESSIONS, which are mcap's and those of ROS 1.

    Raises ValueError where that is more than `most` bytes, having made at most STEP more of it, and what the library of
    the compression raises for damage.
    """
    if compression in ("", "none"):
        if len(data) > most:
            raise ValueError(too_large(len(data), most))
        return data
    content = bytearray()
    decompressor = _decompressor(compression)
    for begin in range(0, len(data), STEP):
        _feed(decompressor, data[begin : begin + STEP], content, most)
        if decompressor.eof:
            return content
    raise ValueError("its packed bytes end too early")


def _feed(decompressor: Any, packed: bytes, content: bytearray, most: int) -> None:
    """Unpack all of `packed` into `content`."""
    while packed or not (decompressor.eof or decompressor.needs_input):
        part = decompressor.decompress(packed, max_length=STEP)
        if not part and not packed:
            return
        packed = b""
        content += part
        if len(content) > most:
            raise ValueError(f"it unpacks to more than {in_bytes(most)}, which it may have at most")


def unpacked_file(packed: Path, target: Path) -> str:
    """Unpack a file of zstd as far as it is whole, and say what is wrong with the rest; empty where nothing is.

    Raises ValueError where it grows many times, and OSError for a full disk.
    """
    most = MOST_RATIO * packed.stat().st_size + SLACK
    decompressor = _decompressor("zstd")
    with open_plain(packed) as source, target.open("xb") as file:
        while not decompressor.eof:
            data = source.read(SMALL_STEP) if decompressor.needs_input else b""
            if decompressor.needs_input and not data:
                return "its packed bytes end too early"
            try:
                part = decompressor.decompress(data, max_length=STEP)
            except damage() as error:
                return str(error)
            if file.write(part) and file.tell() > most:
                raise ValueError(f"'{packed.name}' unpacks to more than {in_bytes(most)}, which no recording does")
    return ""


def refuse_total(total: int, stored: int) -> None:
    """Raises ValueError where all chunks of a file of `stored` bytes together unpack to more than any recording's."""
    if total > MOST_RATIO * stored + SLACK:
        raise ValueError(f"its {in_bytes(stored)} unpack to {in_bytes(total)}, which no recording does")


def too_large(size: int, most: int = MOST_UNPACKED) -> str:
    """The reason to refuse so many bytes."""
    return f"a piece of {in_bytes(size)}, more than {in_bytes(most)}, which no camera's recording has"


def in_bytes(size: int) -> str:
    """As people write it."""
    return f"{size >> 20} MB" if size >= 1 << 20 else f"{size} bytes"


def _decompressor(compression: str) -> Any:
    if compression == "bz2":
        return import_module("bz2").BZ2Decompressor()
    if compression == "lz4":
        return import_module("lz4.frame").LZ4FrameDecompressor()
    for module in ("compression.zstd", "backports.zstd"):
        with suppress(ImportError):
            return import_module(module).ZstdDecompressor()
    raise ValueError("it is packed with zstd, which needs the package backports.zstd")
