"""Bags of ROS 1."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from pathlib import Path

from .storage import Chunk, ChunkedStorage, Message
from .unpack import COMPRESSIONS
from .walk import Record, Source

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
NEEDED: dict[int, dict[bytes, int | None]] = {  # the fields of each kind of record, and their bytes; None: any number
    MESSAGE: {b"conn": 4, b"time": 8},
    BAG_HEADER: {b"index_pos": 8},
    INDEX: {b"conn": 4, b"count": 4},
    CHUNK: {b"compression": None, b"size": 4},
    CHUNK_INFO: {b"chunk_pos": 8},
    CONNECTION: {b"conn": 4, b"topic": None},
}
FIRST_READ = 256  # bytes in which most heads stand
MOST_HEAD, MOST_CONNECTION = 1 << 16, 16 << 20  # bytes of fields
ENTRY = struct.Struct("<III")  # of an index: seconds, nanoseconds, place
Fields = dict[bytes, bytes]


class BagLayout:
    """Fields of `name=value` with their lengths before them, then the content with its length."""

    pattern = re.compile(rb"\x04\0\0\0op=[\x02\x05\x07]")

    def record(self, source: Source, position: int) -> Record | None:
        """See Layout; the head is the fields."""
        start = source.read(position, FIRST_READ)
        length = int.from_bytes(start[:4], "little")
        if not 8 <= length <= MOST_HEAD or len(start) < 4:
            return None
        if length + 8 > len(start):
            start = source.read(position, length + 8)
        fields = _fields(start[4 : 4 + length])
        begin = position + length + 8
        end = begin + int.from_bytes(start[4 + length : 8 + length], "little")
        if fields is None or len(start) < length + 8 or end > source.size or len(fields.get(b"op", b"")) != 1:
            return None
        kind = fields[b"op"][0]
        for name, size in NEEDED.get(kind, {b"?": None}).items():
            if name not in fields or (size is not None and len(fields[name]) != size):
                return None
        if kind == CHUNK and fields[b"compression"].decode("latin-1") not in COMPRESSIONS:
            return None
        if kind == INDEX and int.from_bytes(fields[b"count"], "little") * ENTRY.size != end - begin:
            return None
        return Record(kind, begin, end, fields)

    def beginnings(self, source: Source, match: int) -> Iterator[int]:
        """See Layout: `op` need not be the first field, so the length of all may stand before others."""
        back = min(match, FIRST_READ)
        before = source.read(match - back, back)
        for place in range(back - 4, -1, -1):
            length = int.from_bytes(before[place : place + 4], "little")
            if back - place - 4 + 8 <= length <= MOST_HEAD:
                position = match - back + place
                if self.record(source, position) is not None:
                    yield position
                    return

    def may_lie(self, record: Record) -> bool:
        """See Layout."""
        return record.kind != INDEX  # whose entries are counted


class Ros1Storage(ChunkedStorage):
    """A bag of ROS 1."""

    layout = BagLayout()
    begin = len(MAGIC)

    def __init__(self, path: Path) -> None:
        self._whole = False  # whether the index behind the last chunk is complete
        super().__init__(path)

    def take(self, source: Source, record: Record) -> None:
        """See ChunkedStorage."""
        self.learn(source, record)
        fields: Fields = record.head
        if record.kind == CHUNK:
            compression, size = fields[b"compression"].decode(), int.from_bytes(fields[b"size"], "little")
            self.chunks.append(Chunk(record.begin, record.end - record.begin, compression, size))
            self._whole = True
        elif record.kind == MESSAGE:
            position = _beginning(record)
            size = record.end - position
            channel, time, _, _ = _message(record)
            self.chunks.append(Chunk(position, size, "", size, 0, time, time, {channel}))
        elif record.kind == CHUNK_INFO:
            self.said += 1
        elif record.kind == INDEX and self._whole:
            self._add_index(source, record)
        elif record.kind == BAG_HEADER and fields.get(b"encryptor"):
            raise ValueError("it is encrypted")
        elif record.kind == BAG_HEADER and not any(fields[b"index_pos"]):
            self.notes.append(
                "the recording was interrupted before its index was written; what is there is read without one "
                "(`rosbag reindex` writes it)"
            )

    def _add_index(self, source: Source, record: Record) -> None:
        """Let the last chunk know a channel that occurs in it, and when."""
        last, data = self.chunks[-1], source.read(record.begin, record.end - record.begin)
        times = [seconds * 10**9 + rest for seconds, rest, _ in ENTRY.iter_unpack(data)]
        if times:
            first = last.channels is None
            last.start = min(times) if first else min(last.start, *times)
            last.end = max(times) if first else max(last.end, *times)
            last.channels = (last.channels or set()) | {int.from_bytes(record.head[b"conn"], "little")}

    def gap(self, begin: int, end: int) -> None:
        """See ChunkedStorage: an index that is damaged does not tell all channels."""
        super().gap(begin, end)
        if self._whole:
            last = self.chunks[-1]
            self.chunks[-1] = Chunk(last.position, last.size, last.compression, last.unpacked)
        self._whole = False

    def learn(self, source: Source, record: Record) -> None:
        """See ChunkedStorage."""
        if record.kind == CONNECTION and record.end - record.begin <= MOST_CONNECTION:
            told = _fields(source.read(record.begin, record.end - record.begin)) or {}
            name, kind = record.head[b"topic"], told.get(b"type", b"")
            topic = re.sub("/+", "/", name.decode("utf-8", "replace"))
            package, _, message = kind.decode("utf-8", "replace").rpartition("/")
            number = int.from_bytes(record.head[b"conn"], "little")
            self.declared.add(number)
            self.name(number, topic, f"{package.removesuffix('/msg')}/msg/{message}" if kind else "")

    def message(self, source: Source, record: Record) -> Message | None:
        """See ChunkedStorage."""
        return _message(record) if record.kind == MESSAGE else None


def _message(record: Record) -> Message:
    seconds, rest = struct.unpack("<II", record.head[b"time"])
    channel = int.from_bytes(record.head[b"conn"], "little")
    return Message(channel, seconds * 10**9 + rest, record.begin, record.end)


def _beginning(record: Record) -> int:
    """Where a record begins whose content is known."""
    return record.begin - 8 - sum(4 + len(name) + 1 + len(value) for name, value in record.head.items())


def _fields(data: bytes) -> Fields | None:
    """The fields in the head of a record; None where it is none."""
    fields: Fields = {}
    position = 0
    while position < len(data):
        begin = position + 4
        position = begin + int.from_bytes(data[position:begin], "little")
        name, equals, value = data[begin:position].partition(b"=")
        if position > len(data) or not equals or name in fields:
            return None
        fields[name] = value
    return fields
