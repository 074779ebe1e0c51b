"""Attacks on what leads to the messages of a recording: pages, records, lengths, offsets, counts, and what is packed.

One place that is damaged costs the messages that stand there, and nothing takes gigabytes.
"""

from __future__ import annotations

import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import bag_writer
import mcap_writer
import numpy as np
from numpy.random import Generator
from phone_writers import record3d_parts

from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.frame import RgbdFrame

from . import bombs, recorded
from .promise import limits, refused

PAGE = 4096  # bytes, of SQLite
LOST = 3  # frames of six that one place may cost: two that share a page or a chunk, and their neighbour in the pairing
WIDE = ("mcap", "mcap compressed images", "mcap messages")  # all is in one chunk
NUMBERS = (0, 1, 8, 1 << 15, 1 << 31, (1 << 32) - 1, 1 << 40, (1 << 63) - 1, (1 << 64) - 1)
KINDS = tuple(kind for kind in recorded.BAGS if kind != "mcap file")  # of which one page may be all there is


def inner(rng: Generator, folder: Path) -> None:
    """One page, or the head or content of one record, is anything: the frames elsewhere are there, and it is said."""
    kind = KINDS[rng.integers(len(KINDS))]
    files = recorded.bag_of(kind)
    name = next(name for name in files if not name.endswith(".yaml"))
    if kind == "sqlite3":
        damaged = page_spoiled(rng, files[name])
    else:
        places = bombs.bag_places(files[name]) if kind.startswith("ros1") else mcap_writer.places(files[name])
        damaged = record_spoiled(rng, files[name], places)
    path = recorded.write({**files, name: damaged}, folder)
    if kind in WIDE:
        refused(lambda: list(open_sequence(path)))
        return
    sequence = open_sequence(path)
    sound = sum(isinstance(frame, RgbdFrame) for frame in sequence)
    assert sound >= recorded.FRAMES - LOST, f"{kind}: {sound} frames are left"
    assert len(sequence) == recorded.FRAMES or sequence.warnings


def page_spoiled(rng: Generator, data: bytes) -> bytes:
    """A database of which a page is another, more often one of those that lead to others."""
    pages = len(data) // PAGE
    leading = [page for page in range(pages) if page == 0 or data[page * PAGE] in (2, 5, 10, 13)]
    page = int(rng.choice(leading)) if rng.random() < 0.8 else int(rng.integers(pages))
    content = bytearray(data[page * PAGE : (page + 1) * PAGE])
    how = rng.integers(5)
    if how == 0:
        content[:] = (bytes(PAGE), b"\xff" * PAGE, rng.bytes(PAGE))[rng.integers(3)]
    elif how == 1:  # another page, which may lead in circles
        other = int(rng.integers(pages))
        content[:] = data[other * PAGE : (other + 1) * PAGE]
    elif how == 2:  # numbers of cells, places of cells, numbers of pages
        at = int(rng.integers(0, 120 if page == 0 else 40))
        content[at : at + 2] = rng.bytes(2)
    elif how == 3:
        at = int(rng.integers(PAGE - 4))
        content[at : at + 4] = struct.pack(">I", int(rng.integers(2 * pages)))
    else:
        for at in rng.integers(PAGE, size=8):
            content[at] = int(rng.integers(256))
    return data[: page * PAGE] + bytes(content) + data[(page + 1) * PAGE :]


def record_spoiled(rng: Generator, data: bytes, places: list[tuple[int, int, int]]) -> bytes:
    """A file of records of which one is another, the rare kinds as often as the usual ones, or misses."""
    kinds = sorted({kind for kind, _, _ in places})
    chosen = kinds[rng.integers(len(kinds))]
    of_kind = [place for place in places if place[0] == chosen]
    _, begin, end = of_kind[rng.integers(len(of_kind))]
    record = bytearray(data[begin:end])
    how = rng.integers(6)
    if how == 0:
        record[:] = (bytes(len(record)), b"\xff" * len(record), rng.bytes(len(record)))[rng.integers(3)]
    elif how == 1:
        del record[:]
    elif how == 2:  # lengths, offsets, times, counts
        at = int(rng.integers(min(len(record), 80)))
        number = struct.pack("<Q", NUMBERS[rng.integers(len(NUMBERS))])[: 1 << int(rng.integers(4))]
        record[at : at + len(number)] = number[: len(record) - at]
    elif how == 3:
        at = int(rng.integers(min(len(record), 80)))
        record[at] ^= 1 << int(rng.integers(8))
    elif how == 4:
        del record[int(rng.integers(len(record))) :]
    else:
        record[:0] = rng.bytes(int(rng.integers(1, 64)))
    return data[:begin] + bytes(record) + data[end:]


def bomb(rng: Generator, folder: Path) -> None:
    """Something that unpacks to gigabytes: a sentence, or the frames that have nothing to do with it."""
    door = list(DOORS)[rng.integers(len(DOORS))]
    path = DOORS[door](rng, folder)
    with limits(10, 640 << 20):
        try:
            sequence = open_sequence(path)
            lost = sum(not isinstance(frame, RgbdFrame) for frame in sequence)
        except IdRgbdoError as error:
            assert any(word in str(error) for word in REASONS), f"{door}: {error}"
            return
    assert lost or sequence.warnings or door in MAY_BE_IMAGES, f"{door}: nothing is said"


def mcap_chunk(rng: Generator, folder: Path) -> Path:
    packing = ("zstd", "lz4")[rng.integers(2)]
    whole = recorded.bag_of(f"mcap recorder {packing}")["made.mcap"]
    return recorded.write({"made.mcap": bombs.mcap_with(packing, bombs.declared(rng), whole)}, folder)


def ros1_chunk(rng: Generator, folder: Path) -> Path:
    packing = ("bz2", "lz4")[rng.integers(2)]
    whole = recorded.bag_of(f"ros1 {packing}")["made.bag"]
    return recorded.write({"made.bag": bombs.bag_with(packing, bombs.declared(rng), whole)}, folder)


def mcap_message(rng: Generator, folder: Path) -> Path:
    said = mcap_writer.messages(recorded.film())
    at = 3 * int(rng.integers(recorded.FRAMES)) + int(rng.integers(2))  # colour or depth
    said[at] = said[at]._replace(data=bombs.zstd_bomb())
    return recorded.write({"made.mcap": mcap_writer.write_mcap(said)}, folder)


def packed_file(rng: Generator, folder: Path) -> Path:
    files = recorded.bag_of("mcap file")
    name = next(name for name in files if not name.endswith(".yaml"))
    return recorded.write({**files, name: bombs.zstd_bomb()}, folder)


def array(rng: Generator, folder: Path) -> Path:
    method = (zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2)[rng.integers(2)]
    files = recorded.folder_of("arrays")
    return recorded.write({**files, "made/depth/1.npz": bombs.npz_bomb(method, bool(rng.integers(2)))}, folder)


def image(rng: Generator, folder: Path) -> Path:
    files = recorded.folder_of("arrays")
    if rng.random() < 0.2:
        path = recorded.write(files, folder)
        bombs.exr_bomb(path / "depth" / "2.exr")
        return path
    if rng.random() < 0.5:
        return recorded.write({**files, "made/depth/3.tiff": bombs.tiff_bomb()}, folder)
    return recorded.write({**files, "made/rgb/2.bmp": bombs.png_bomb((64, 48), color=True)}, folder)


def compressed_depth(rng: Generator, folder: Path) -> Path:
    def depth(messages: bag_writer.Messages, stamp: int, image: np.ndarray) -> tuple[str, object]:
        data = bytes(12) + bombs.png_bomb(((64, 48), (16384, 16384))[rng.integers(2)], color=False)
        return messages.compressed(stamp, data, "16UC1; compressedDepth png")

    topics = ("/camera/color/image_raw/compressed", "/camera/depth/image_raw/compressedDepth")
    return bag_writer.write_bag(recorded.film(), folder / "a.bag", color=bag_writer.png, depth=depth, topics=topics)


def phone(rng: Generator, folder: Path) -> Path:
    parts = record3d_parts(recorded.film())
    kind = rng.integers(5)
    path = folder / "a.r3d"
    if kind == 4:
        return bombs.archive_of({**parts, **{f"{k}/" * 30_000 + "a": b"" for k in range(9)}}, path)
    if kind < 2:
        parts["rgbd/1.depth"] = bombs.lzfse_bomb(lies=kind == 0)
        return bombs.archive_of(parts, path)
    chosen = ("rgbd/2.depth", "rgbd/2.jpg", "metadata")[rng.integers(3)]
    return bombs.archive_of(parts, path, chosen, lies=kind == 2)


REASONS = ("more than", "folders in folders", "unpack", "pixels", "cannot read")
MAY_BE_IMAGES = ("an image", "compressed depth")  # whole ones, with more behind their last row
DOORS: dict[str, Callable[[Generator, Path], Path]] = {
    "a chunk of mcap": mcap_chunk,
    "a chunk of a bag": ros1_chunk,
    "a message": mcap_message,
    "a packed file": packed_file,
    "an array": array,
    "an image": image,
    "compressed depth": compressed_depth,
    "a phone's archive": phone,
}
