"""Files that are made to harm: images that declare any size, and what may stand where a file should."""

from __future__ import annotations

import io
import os
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
from numpy.random import Generator
from png_writer import GRAY, RGB, SIGNATURE, chunk, header

from .mutate import spoiled, token

SIDES = (0, 1, 7, 4097, 30_000, 60_000, 65_535, 1 << 20, (1 << 31) - 1)


def image(rng: Generator, suffix: str, whole: bytes) -> bytes:
    """An image of some kind that declares any size, says something else, or is spoiled."""
    width, height = (int(SIDES[k]) for k in rng.integers(len(SIDES), size=2))
    kind = rng.integers(9)
    if suffix in (".npy", ".npz") and kind < 6:
        array = npy(rng, (height, width))
        return array if rng.random() < 0.6 else packed(array)
    if kind == 0:
        rows = zlib.compress(bytes(min(height * (1 + 3 * width), 1 << 20)))
        of = header(width, height, 16 if rng.random() < 0.5 else 8, (GRAY, RGB)[rng.integers(2)])
        return SIGNATURE + of + chunk(b"IDAT", rows) + chunk(b"IEND")
    if kind == 1:
        return b"P5\n%d %d\n65535\n" % (width, height) + bytes(64)
    if kind == 2:
        return b"BM" + struct.pack("<IHHIIiiHH", 1 << 10, 0, 0, 54, 40, width, height, 1, 24) + bytes(64)
    if kind == 3:
        return b"GIF89a" + struct.pack("<HH", width & 0xFFFF, height & 0xFFFF) + bytes(64)
    if kind == 4:
        tags = [(256, 4, width), (257, 4, height), (258, 3, 16), (259, 3, 1), (262, 3, 1), (273, 4, 8), (279, 4, 99)]
        entries = b"".join(struct.pack("<HHII", tag, of, 1, value & 0xFFFFFFFF) for tag, of, value in tags)
        return b"II*\0" + struct.pack("<I", 8) + struct.pack("<H", len(tags)) + entries + bytes(64)
    if kind == 5:
        start = b"\xff\xd8\xff\xc0" + struct.pack(">HBHHB", 17, 8, height & 0xFFFF, width & 0xFFFF, 3)
        return start + bytes(9) + b"\xff\xd9"
    if kind == 6:
        return token(rng).encode("utf-8", "surrogateescape")
    return spoiled(rng, whole)


def npy(rng: Generator, shape: tuple[int, ...]) -> bytes:
    """An array of numpy's that is something else than its header says."""
    kinds = ("<f4", "<u2", ">i8", "|O", "<c16", "|b1", "<M8[s]", "|S5", "<f8")
    shapes = (shape, (), (0, 5), (3, 30, 40), (1 << 62, 1 << 62), (-1, 4), (30, 40), (30, 40, 1))
    described = {"descr": kinds[rng.integers(len(kinds))], "fortran_order": False, "shape": shapes[rng.integers(8)]}
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, described)
    return stream.getvalue() + bytes(int(rng.integers(9700)))


def packed(array: bytes) -> bytes:
    """A .npz of it."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("depth.npy", array)
    return stream.getvalue()


def in_place_of(rng: Generator, path: Path) -> None:
    """Something else than a file under its name: nothing, a folder, a pipe, a link to nothing, to itself, a device."""
    path.unlink(missing_ok=True)
    kind = rng.integers(7)
    if kind == 0:
        path.mkdir()
    elif kind == 1:
        os.mkfifo(path)
    elif kind == 2:
        path.symlink_to("nowhere")
    elif kind == 3:
        path.symlink_to(path.name)
    elif kind == 4:
        path.symlink_to("/dev/zero")
    elif kind == 5:
        path.touch()
