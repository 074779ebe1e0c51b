"""What is packed in other files: members of zip archives, and lzfse, Apple's compression, as Record3D writes it.

Both can be made to unpack to thousands of times their size, and what they say of it need not be true.
"""

from __future__ import annotations

import struct
import zipfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import IdRgbdoError

STEP = 1 << 18  # bytes of a member that are unpacked at a time
MAGIC, END = b"bvx", b"bvx$"  # how every block of lzfse begins, and the last one
STORED_BLOCK, LZVN_BLOCK, LZFSE_BLOCK = b"bvx-", b"bvxn", b"bvx2"
MOST_FLOATS = 64 << 20  # bytes of a depth image: 4096x4096
AT_ONCE = 8  # blocks that are unpacked before their size is compared: of 24 MB each at most, whatever they say
SIZES = ((192, 256), (480, 640), (144, 192), (240, 320))  # LiDAR, TrueDepth and smaller ones; rows, columns


def unpacked(data: bytes, where: str) -> bytes:
    """The content, which may be compressed or not. Raises IdRgbdoError without a package for it, or for damage."""
    if not data.startswith(MAGIC):
        return data
    decompress, damage = _decompressor(where)
    again = "copy or download it again"
    try:
        ends, sizes = zip(*_blocks(data), strict=True)
        if sum(sizes) > MOST_FLOATS:
            raise ValueError(f"they say to be {sum(sizes) >> 20} MB, more than any depth image")
        content = b""
        for count in (*range(AT_ONCE, len(ends), AT_ONCE), len(ends)):
            content = decompress(data[: ends[count - 1]] + END)
            if len(content) != sum(sizes[:count]):
                raise ValueError("they unpack to another size than they say")
    except (damage, MemoryError, ValueError, struct.error) as error:
        raise IdRgbdoError(
            f"{where}: cannot unpack the {len(data)} bytes ({str(error) or 'they are damaged'}); {again}"
        ) from error
    return bytes(content)


def _blocks(data: bytes) -> list[tuple[int, int]]:
    """Where each block of lzfse ends, and the bytes that it says to unpack to. Raises ValueError for damage."""
    blocks: list[tuple[int, int]] = []
    at = 0
    while data[at : at + 4] != END:
        kind, size = struct.unpack_from("<4sI", data, at)
        if kind == STORED_BLOCK:
            end = at + 8 + size
        elif kind == LZVN_BLOCK:
            end = at + 12 + int.from_bytes(data[at + 8 : at + 12], "little")
        elif kind == LZFSE_BLOCK:  # lengths of its literals, of its matches, and of its head, among other things
            literals, matches, head = struct.unpack_from("<QQQ", data, at + 8)
            end = at + (head & 0xFFFFFFFF) + (literals >> 20 & 0xFFFFF) + (matches >> 40 & 0xFFFFF)
        else:
            raise ValueError("they are damaged")
        if end > len(data) or end <= at:
            raise ValueError("they are damaged")
        blocks.append((end, size))
        at = end
    if not blocks:
        raise ValueError("they are empty")
    return blocks


def member_bytes(archive: zipfile.ZipFile, member: zipfile.ZipInfo, most: int) -> bytes:
    """A member of an archive of at most `most` bytes, unpacked in steps.

    Raises ValueError for more, whatever it says to have, and what zipfile raises for damage.
    """
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):  # others are not unpacked in steps
        raise ValueError("it is packed in an unusual way")
    if member.file_size > most:
        raise ValueError(f"it has {member.file_size >> 20} MB, more than {most >> 20} MB")
    content = bytearray()
    with archive.open(member) as stream:
        while part := stream.read(STEP):
            content += part
            if len(content) > most:
                raise ValueError(f"it unpacks to more than {most >> 20} MB")
    return bytes(content)


def floats(data: bytes, where: str, stated: tuple[Any, Any], color: tuple[int, ...]) -> NDArray[np.float32]:
    """(h, w) float32 metres. stated: rows and columns where the recording says so; color: those of the colour image,
    which tell a portrait from a landscape.

    Raises IdRgbdoError for damage, or for a size that cannot be told.
    """
    content = unpacked(data, where)
    values = np.frombuffer(content, np.float32, count=len(content) // 4)
    known = [tuple(map(int, stated))] if all(isinstance(x, int | float) for x in stated) else []
    shapes = [*known, *(shape if color[0] < color[1] else shape[::-1] for shape in SIZES)]
    for rows, columns in shapes:
        if rows * columns == values.size and values.size:
            return values.reshape(rows, columns).copy()
    raise IdRgbdoError(
        f"{where}: expected depth of {' or '.join(f'{c}x{r}' for r, c in shapes[:3])} pixels, got {len(content)} "
        "bytes; copy or download it again"
    )


def _decompressor(where: str) -> tuple[Any, type[Exception]]:
    """The function, and what it raises: of lzfse, or of pyliblzfse, its older twin."""
    try:
        import lzfse

        return lzfse.decompress, lzfse.error
    except ImportError:
        pass
    try:
        import liblzfse

        return liblzfse.decompress, liblzfse.error
    except ImportError as error:
        raise IdRgbdoError(
            f'{where}: unpacking this needs lzfse ({error}); run `pip install "idrgbdo_torch[phone]"`, or export the '
            "recording from the app as EXR and colour"
        ) from error
