"""The size that an encoded image declares, before anybody makes room for its pixels."""

from __future__ import annotations

import re
import struct

PNG, JPEG, TIFF = b"\x89PNG\r\n\x1a\n", b"\xff\xd8", (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
NO_SIZE = {0xC4, 0xC8, 0xCC}  # JPEG's markers among those of frames that begin none
WIDTH, HEIGHT, TILE_WIDTH, TILE_HEIGHT = 256, 257, 322, 323  # TIFF's tags
LARGE_TILE = 1 << 22  # px; tiles of usual files have 256x256, and memory is made for a whole one
MOST_ENTRIES = 4096  # of a TIFF's first directory
LOOK_AT = 1 << 16  # bytes in which text and boxes that tell the size stand


def declared_size(data: bytes) -> tuple[int, int] | None:
    """(width, height) in px by the header of an image of any kind that OpenCV reads; None where it tells none.

    The size may be nonsense, of a file that is damaged.
    """
    try:
        return _size(data)
    except (struct.error, ValueError, IndexError):  # the header ends before
        return None


def _size(data: bytes) -> tuple[int, int] | None:
    if data.startswith(PNG):
        return _unpack(">II", data, 16)
    if data.startswith(JPEG):
        return _jpeg(data)
    if data.startswith(TIFF):
        return _tiff(data)
    if data.startswith(b"BM"):
        (header,) = struct.unpack_from("<I", data, 14)
        width, height = struct.unpack_from("<hh" if header == 12 else "<ii", data, 18)
        return abs(width), abs(height)
    if data.startswith(b"GIF8"):
        return _unpack("<HH", data, 6)
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return _webp(data)
    if data.startswith(b"\x59\xa6\x6a\x95"):  # Sun raster
        return _unpack(">II", data, 4)
    if data.startswith((b"#?", b"P7")) or re.match(rb"P[1-6Ff]\s", data):
        return _text(data[:LOOK_AT])
    return _boxes(data[:LOOK_AT])


def _unpack(layout: str, data: bytes, at: int) -> tuple[int, int]:
    width, height = struct.unpack_from(layout, data, at)
    return width, height


def _jpeg(data: bytes) -> tuple[int, int] | None:
    """Walk the segments (marker, length, content) up to the one that begins the frame."""
    at = 2
    while at + 9 <= len(data):
        if data[at] != 0xFF:
            at = data.find(b"\xff", at)  # as decoders do, past what belongs to no segment
            if at < 0:
                return None
            continue
        marker = data[at + 1]
        if marker == 0xFF:  # filling
            at += 1
        elif 0xC0 <= marker <= 0xCF and marker not in NO_SIZE:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        elif marker in (0x00, 0x01) or 0xD0 <= marker <= 0xD8:  # alone
            at += 2
        else:
            at += 2 + max(2, struct.unpack_from(">H", data, at + 2)[0])
    return None


def _tiff(data: bytes) -> tuple[int, int] | None:
    """The tags of the first directory, of the usual TIFF or of BigTIFF."""
    end = "<" if data.startswith(b"II") else ">"
    big = data[2:4] in (b"+\0", b"\0+")
    (at,) = struct.unpack_from(end + ("Q" if big else "I"), data, 8 if big else 4)
    (entries,) = struct.unpack_from(end + ("Q" if big else "H"), data, at)
    found: dict[int, int] = {}
    for k in range(min(entries, MOST_ENTRIES)):
        place = at + (8 + 20 * k if big else 2 + 12 * k)
        tag, kind = struct.unpack_from(end + "HH", data, place)
        if tag in (WIDTH, HEIGHT, TILE_WIDTH, TILE_HEIGHT):
            layout = {3: "H", 16: "Q"}.get(kind, "I")
            found[tag] = struct.unpack_from(end + layout, data, place + (12 if big else 8))[0]
    tile = found.get(TILE_WIDTH, 0), found.get(TILE_HEIGHT, 0)
    if tile[0] * tile[1] > LARGE_TILE:
        return tile
    return (found[WIDTH], found[HEIGHT]) if {WIDTH, HEIGHT} <= set(found) else None


def _webp(data: bytes) -> tuple[int, int] | None:
    if len(data) < 30:
        return None
    if data[12:16] == b"VP8X":
        return 1 + int.from_bytes(data[24:27], "little"), 1 + int.from_bytes(data[27:30], "little")
    if data[12:16] == b"VP8L":
        bits = int.from_bytes(data[21:25], "little")
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    width, height = struct.unpack_from("<HH", data, 26)
    return width & 0x3FFF, height & 0x3FFF


def _text(head: bytes) -> tuple[int, int] | None:
    """Of PBM to PPM and PFM (`P6 width height`), PAM (`WIDTH w`, `HEIGHT h`) and Radiance (`-Y h +X w`)."""
    if head.startswith(b"#?"):
        found = re.search(rb"[-+]Y\s+(\d{1,20})\s+[-+]X\s+(\d{1,20})", head)
        return (int(found[2]), int(found[1])) if found else None
    if head.startswith(b"P7"):
        wide, high = (re.search(rb"^" + name + rb"\s+(\d{1,20})", head, re.MULTILINE) for name in (b"WIDTH", b"HEIGHT"))
        return (int(wide[1]), int(high[1])) if wide and high else None
    plain = re.match(rb"P.(?:\s|#[^\n]*\n)+(\d{1,20})(?:\s|#[^\n]*\n)+(\d{1,20})\s", head)
    return (int(plain[1]), int(plain[2])) if plain else None


def _boxes(head: bytes) -> tuple[int, int] | None:
    """The largest that a box of JPEG 2000 (ihdr: height, width; SIZ of its stream) or of AVIF (ispe) says."""
    sizes = []
    for found in re.finditer(rb"ihdr", head):
        height, width = struct.unpack_from(">II", head, found.end())
        sizes.append((width, height))
    for found in re.finditer(rb"\xff\x4f\xff\x51", head):
        right, bottom, left, top = struct.unpack_from(">IIII", head, found.end() + 4)
        sizes.append((max(right - left, 0), max(bottom - top, 0)))
    for found in re.finditer(rb"ispe", head):
        sizes.append(_unpack(">II", head, found.end() + 4))
    return max(sizes, key=lambda size: size[0] * size[1], default=None)
