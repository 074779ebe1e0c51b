"""Writes files of mcap as recorders do: packed chunks with checksums, an index behind each, and a summary."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Sequence
from typing import NamedTuple

import lz4.frame
from backports import zstd
from bag_writer import IMAGE, INFO, START, Messages, metres, rgb8
from rendered import Film

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX, STATISTICS, DATA_END = (
    *range(1, 9),
    0x0B,
    0x0F,
)
TOPICS = ("/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw", "/camera/color/camera_info")
PACK: dict[str, Callable[[bytes], bytes]] = {"": bytes, "lz4": lz4.frame.compress, "zstd": zstd.compress}


class Said(NamedTuple):
    """A message: number of its topic, ns, content."""

    channel: int
    time: int
    data: bytes


def text(value: str) -> bytes:
    return struct.pack("<I", len(value.encode())) + value.encode()


def record(kind: int, content: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(content)) + content


def chunk(start: int, end: int, size: int, crc: int, compression: str, packed: bytes) -> bytes:
    """A chunk that says whatever it is told to say."""
    head = struct.pack("<QQQI", start, end, size, crc) + text(compression)
    return record(CHUNK, head + struct.pack("<Q", len(packed)) + packed)


def messages(film: Film) -> list[Said]:
    """Colour, depth and camera of each frame."""
    made, said = Messages(2), []
    for frame in film.frames:
        assert frame.color is not None
        at = START * 10**9 + round(frame.timestamp * 1e6) * 1000
        images = rgb8(made, at, frame.color.numpy()), metres(made, at, frame.depth.numpy()), made.info(at, film)
        said += [Said(1 + k, at + k, bytes(made.bytes(*image))) for k, image in enumerate(images)]
    return said


def write_mcap(said: Sequence[Said], compression: str = "", per_chunk: int = 3, summary: bool = True) -> bytes:
    """The bytes of a file; per_chunk: messages in a chunk, 0 for messages in the file itself."""
    kinds = (IMAGE, IMAGE, INFO)
    store = Messages(2).store
    about = b"".join(
        record(SCHEMA, struct.pack("<H", 1 + k) + text(kind) + text("ros2msg") + text(store.generate_msgdef(kind)[0]))
        for k, kind in enumerate(kinds)
    ) + b"".join(
        record(CHANNEL, struct.pack("<HH", 1 + k, 1 + k) + text(topic) + text("cdr") + struct.pack("<I", 0))
        for k, topic in enumerate(TOPICS)
    )
    out = MAGIC + record(HEADER, text("ros2") + text("test"))
    indexes = b""
    if not per_chunk:
        out += about + b"".join(map(_message, said))
    for first in range(0, len(said), per_chunk or len(said) + 1) if per_chunk else ():
        part = said[first : first + per_chunk]
        content = (about if first == 0 else b"") + b"".join(map(_message, part))
        begin, times = len(out), [message.time for message in part]
        out += chunk(min(times), max(times), len(content), zlib.crc32(content), compression, PACK[compression](content))
        index = b"".join(
            record(MESSAGE_INDEX, struct.pack("<HIQQ", message.channel, 16, message.time, 0)) for message in part
        )
        indexes += record(
            CHUNK_INDEX,
            struct.pack("<QQQQ", min(times), max(times), begin, len(out) - begin)
            + struct.pack("<I", 10 * len(part))
            + b"".join(struct.pack("<HQ", message.channel, len(out) + 31 * k) for k, message in enumerate(part))
            + struct.pack("<Q", len(index))
            + text(compression)
            + struct.pack("<QQ", len(PACK[compression](content)), len(content)),
        )
        out += index
    out += record(DATA_END, bytes(4))
    start = len(out) if summary else 0
    if summary:
        times = [message.time for message in said]
        counts = struct.pack("<QHIIIIQQ", len(said), 3, 3, 0, 0, len(indexes) > 0, min(times), max(times))
        channels = b"".join(struct.pack("<HQ", 1 + k, len(said) // 3) for k in range(3))
        out += about + indexes + record(STATISTICS, counts + struct.pack("<I", len(channels)) + channels)
    return out + record(FOOTER, struct.pack("<QQI", start, 0, 0)) + MAGIC


def places(data: bytes) -> list[tuple[int, int, int]]:
    """Kind, beginning and end of each record of a whole file."""
    found, at = [], len(MAGIC)
    while at < len(data) - len(MAGIC):
        kind, length = struct.unpack_from("<BQ", data, at)
        found.append((kind, at, at + 9 + length))
        at += 9 + length
    return found


def _message(message: Said) -> bytes:
    return record(MESSAGE, struct.pack("<HIQQ", message.channel, 0, message.time, message.time) + message.data)
