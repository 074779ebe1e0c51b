"""Pieces of kilobytes that unpack to gigabytes, whatever they say of it, for every place where something unpacks."""

from __future__ import annotations

import base64
import io
import struct
import zipfile
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path

import lz4.frame
import mcap_writer
import numpy as np
from numpy.random import Generator
from png_writer import GRAY, RGB, SIGNATURE, header
from png_writer import chunk as png_chunk

GIGABYTES = 3 << 30
GIGABYTE_IN_BZ2 = (
    "c-nJ{%CIzaj8qGb<l}sFpE17Af#CoH1BU{GL4&WG(*o6%Tn*Dl<wxa*zPv|G{7Htcpc5c@7O;vlteVRvDmf>*bn=TAxmpBF_}1}+2>|5%?Ck"
)
BAG_MAGIC, CHUNK = 13, 5  # bytes before the first record of a bag of ROS 1; the kind of its chunks
BLOCK = 128 << 10  # bytes of a block of zstd at most


@cache
def zstd_bomb(size: int = GIGABYTES) -> bytes:
    """A frame of blocks that each repeat one byte, without its size."""
    block = struct.pack("<I", BLOCK << 3 | 1 << 1)[:3] + b"\0"
    last = struct.pack("<I", 1 | 1 << 3 | 1 << 1)[:3] + b"\0"
    return b"\x28\xb5\x2f\xfd\x00" + b"\x58" + block * (size // BLOCK) + last


@cache
def lz4_bomb(size: int = GIGABYTES) -> bytes:
    """A frame of blocks of 4 MB of zeros."""
    one = lz4.frame.compress(bytes(4 << 20), block_size=lz4.frame.BLOCKSIZE_MAX4MB, store_size=False)
    begin, end = one[:7], one[-4:]
    return begin + one[7:-4] * (size >> 22) + end


@cache
def bz2_bomb() -> bytes:
    """1 GB of zeros in one stream, which takes 14 s to make."""
    return zlib.decompress(base64.b85decode(GIGABYTE_IN_BZ2))


@cache
def zlib_bomb(size: int = GIGABYTES, bare: bool = False) -> bytes:
    """One stream of zeros; bare: as in zip archives."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    one, again = (packer.compress(bytes(1 << 24)) + packer.flush(zlib.Z_FULL_FLUSH) for _ in range(2))
    rows = one + again * ((size >> 24) - 1) + packer.flush()  # behind a full flush all is as before
    return rows if bare else b"\x78\xda" + rows + struct.pack(">I", size % 65521 << 16 | 1)


def png_bomb(declared: tuple[int, int], color: bool, size: int = 1 << 30) -> bytes:
    """An image whose stored rows are more than it says."""
    kind = header(*declared, 8 if color else 16, RGB if color else GRAY)
    return SIGNATURE + kind + png_chunk(b"IDAT", zlib_bomb(size)) + png_chunk(b"IEND")


def npz_bomb(method: int, lies: bool) -> bytes:
    """An archive of one array; lies: it says to have 100 bytes."""
    data = zlib_bomb(1 << 30, bare=True) if method == zipfile.ZIP_DEFLATED else bz2_bomb()
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("depth.npy", data)
    return said_to_be(stream.getvalue(), b"depth.npy", method, 100 if lies else 1 << 30)


def archive_of(parts: dict[str, bytes], path: Path, bomb: str = "", lies: bool = False) -> Path:
    """An archive at `path`, of whose members one is a bomb; lies: it says to have 100 bytes."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, data in parts.items():
            archive.writestr(name, zlib_bomb(1 << 30, bare=True) if name == bomb else data)
    data, size = stream.getvalue(), 100 if lies else 1 << 30
    path.write_bytes(said_to_be(data, bomb.encode(), zipfile.ZIP_DEFLATED, size) if bomb else data)
    return path


def said_to_be(archive: bytes, name: bytes, method: int, size: int) -> bytes:
    """An archive that says of a member that is stored in it that it is packed, and how large it is."""
    content = bytearray(archive)
    local, central = archive.index(name) - 30, archive.rindex(name) - 46
    for at in (local + 8, central + 10):
        struct.pack_into("<H", content, at, method)
    for at in (local + 22, central + 24):
        struct.pack_into("<I", content, at, size)
    return bytes(content)


@cache
def lzfse_bomb(lies: bool, count: int = 60) -> bytes:
    """Blocks of 23 MB of zeros; lies: each says to have 100 bytes."""
    import lzfse

    packed = lzfse.compress(bytes(64 << 20))
    first = packed.index(b"bvx2", 4)
    block = bytearray(packed[first : packed.index(b"bvx2", first + 4)])
    if lies:
        struct.pack_into("<I", block, 4, 100)
    return packed[:first] + bytes(block) * count + b"bvx$"


def tiff_bomb(side: int = 16384) -> bytes:
    """A small image in one tile that is none."""
    packed = zlib_bomb(side * side * 2)
    begin = 8 + 2 + 12 * 10 + 4
    tags = ((256, 64), (257, 48), (258, 16), (259, 8), (262, 1), (277, 1), (322, side), (323, side))
    tags += ((324, begin), (325, len(packed)))
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags)
    return b"II*\0" + struct.pack("<IH", 8, len(tags)) + entries + bytes(4) + packed


CHUNKS: dict[str, Callable[[], bytes]] = {"zstd": zstd_bomb, "lz4": lz4_bomb}


def mcap_with(compression: str, declared: int, whole: bytes, replace: bool = True) -> bytes:
    """A file of mcap whose third chunk is a bomb that says to have `declared` bytes, or that has one before it."""
    chunks = [(begin, end) for kind, begin, end in mcap_writer.places(whole) if kind == mcap_writer.CHUNK]
    begin, end = chunks[2]
    start, stop = struct.unpack_from("<QQ", whole, begin + 9)
    bomb = mcap_writer.chunk(start, stop, declared, 0, compression, CHUNKS[compression]())
    return whole[:begin] + bomb + whole[end if replace else begin :]


def bag_with(compression: str, declared: int, whole: bytes) -> bytes:
    """A bag of ROS 1 whose last chunk is a bomb."""
    _, begin, end = [place for place in bag_places(whole) if place[0] == CHUNK][-1]
    bomb = {"bz2": bz2_bomb, "lz4": lz4_bomb}[compression]()
    parts = (b"op=\x05", b"compression=" + compression.encode(), b"size=" + struct.pack("<Q", declared)[:4])
    head = b"".join(struct.pack("<I", len(part)) + part for part in parts)
    chunk = struct.pack("<I", len(head)) + head + struct.pack("<I", len(bomb)) + bomb
    at = whole.index(b"index_pos=") + len(b"index_pos=")
    (position,) = struct.unpack_from("<Q", whole, at)
    moved = struct.pack("<Q", position + len(chunk) - (end - begin))
    return whole[:at] + moved + whole[at + 8 : begin] + chunk + whole[end:]


def bag_places(data: bytes) -> list[tuple[int, int, int]]:
    """Kind, beginning and end of each record of a whole bag of ROS 1."""
    found, at = [], BAG_MAGIC
    while at < len(data):
        (head,) = struct.unpack_from("<I", data, at)
        (content,) = struct.unpack_from("<I", data, at + 4 + head)
        end = at + 8 + head + content
        found.append((data[data.index(b"\x04\0\0\0op=", at) + 7], at, end))
        at = end
    return found


def declared(rng: Generator) -> int:
    """What a bomb says of its size."""
    return int((0, 100, 1 << 20, 200 << 20, GIGABYTES, (1 << 63) - 1)[rng.integers(6)])


def exr_bomb(path: Path, layers: int = 40, side: int = 1536) -> None:
    """Write an image of many layers of nothing."""
    import OpenEXR

    nothing = np.zeros((side, side), np.float32)
    head = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(head, {f"{k}.Z": nothing for k in range(layers)}).write(str(path))
