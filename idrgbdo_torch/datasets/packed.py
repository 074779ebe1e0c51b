"""Raw float images compressed by lzfse, Apple's compression, as Record3D writes them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import IdRgbdoError

MAGIC = b"bvx"  # how every block of lzfse begins
SIZES = ((192, 256), (480, 640), (144, 192), (240, 320))  # LiDAR, TrueDepth and smaller ones; rows, columns


def unpacked(data: bytes, where: str) -> bytes:
    """The content, which may be compressed or not. Raises IdRgbdoError without a package for it, or for damage."""
    if not data.startswith(MAGIC):
        return data
    decompress, damage = _decompressor(where)
    try:
        content = decompress(data)
    except (damage, MemoryError, ValueError) as error:
        raise IdRgbdoError(
            f"{where}: cannot unpack the {len(data)} bytes ({str(error) or 'they are damaged'}); copy or download it "
            "again"
        ) from error
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
