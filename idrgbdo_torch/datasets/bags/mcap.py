"""Files of mcap, the usual storage of ROS 2."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from struct import Struct

from .storage import READ, Chunk, ChunkedStorage, Message
from .unpack import COMPRESSIONS
from .walk import Record, Source

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
STATISTICS, DATA_END = 11, 15
END = 0  # the kind given to the magic bytes at the end of a file
HEAD = Struct("<BQ")  # kind and length of a record
MESSAGE_HEAD = Struct("<HIQQ")  # channel, number, times of recording and of sending
CHUNK_HEAD = Struct("<QQQII")  # first and last time, unpacked size, checksum, letters of the compression's name
INDEX_HEAD = Struct("<HI")  # channel, bytes of its entries
COUNTS = Struct("<Q14xI")  # of messages and of chunks
ENTRY = 16  # bytes of an entry: time and place
MOST_TEXT = 16 << 20  # bytes of a schema
LENGTHS = {FOOTER: (20, 20), DATA_END: (4, 4), HEADER: (8, 1 << 20), SCHEMA: (14, MOST_TEXT), CHANNEL: (16, MOST_TEXT)}
LENGTHS[STATISTICS] = 46, MOST_TEXT
IN_A_ROW = 3  # records behind each other that are looked at to believe that something is one


class McapLayout:
    """A byte that tells the kind, the length of the content, the content."""

    pattern = re.compile(rb"(?=[\x01-\x0f].{5}\0\0\0)", re.DOTALL)

    def record(self, source: Source, position: int) -> Record | None:
        """See Layout; the head is a Chunk where the record is one."""
        head = source.read(position, HEAD.size)
        if len(head) < HEAD.size:
            return Record(END, position, source.size, None) if head == MAGIC else None
        kind, length = HEAD.unpack(head)
        begin, end = position + HEAD.size, position + HEAD.size + length
        least, most = LENGTHS.get(kind, (0, length))
        if not (END < kind <= DATA_END or kind >= 128) or end > source.size or not least <= length <= most:
            return None
        if kind == MESSAGE:
            return Record(kind, begin, end, None) if length >= MESSAGE_HEAD.size else None
        if kind == CHUNK:
            chunk = _chunk(source, begin, length)
            return Record(kind, begin, end, chunk) if chunk else None
        if kind == MESSAGE_INDEX:
            data = source.read(begin, INDEX_HEAD.size)
            counted = INDEX_HEAD.size + INDEX_HEAD.unpack(data)[1] if len(data) == INDEX_HEAD.size else -1
            return Record(kind, begin, end, None) if length == counted and not (counted - 6) % ENTRY else None
        return Record(kind, begin, end, None)

    def beginnings(self, source: Source, match: int) -> Iterator[int]:
        """See Layout: where some records stand behind each other."""
        position = match
        for _ in range(IN_A_ROW):
            record = self.record(source, position)
            if record is None:
                return
            position = record.end
            if position >= source.size or record.kind == CHUNK:  # all of whose sizes are right
                break
        yield match

    def may_lie(self, record: Record) -> bool:
        """See Layout."""
        return record.kind not in (CHUNK, MESSAGE_INDEX)


class McapStorage(ChunkedStorage):
    """A file of mcap."""

    layout = McapLayout()
    begin = len(MAGIC)

    def __init__(self, path: Path) -> None:
        self._types: dict[int, str] = {}  # of messages, by the number of their schema
        self._whole = False  # whether the records behind the last chunk tell all channels that occur in it
        super().__init__(path)

    def take(self, source: Source, record: Record) -> None:
        """See ChunkedStorage."""
        self.learn(source, record)
        if record.kind == CHUNK:
            self.chunks.append(record.head)
            self._whole = True
        elif record.kind == MESSAGE:
            channel, _, time, _ = MESSAGE_HEAD.unpack(source.read(record.begin, MESSAGE_HEAD.size))
            position, size = record.begin - HEAD.size, record.end - record.begin + HEAD.size
            self.chunks.append(Chunk(position, size, "", size, 0, time, time, {channel}))
        elif record.kind == CHUNK_INDEX:
            self.said += 1
        elif record.kind == STATISTICS and not self.said:
            messages, chunks = COUNTS.unpack(source.read(record.begin, COUNTS.size))
            self.said = chunks or messages  # these stand in no chunks
        elif record.kind == MESSAGE_INDEX and self._whole:
            channel, size = INDEX_HEAD.unpack(source.read(record.begin, INDEX_HEAD.size))
            last = self.chunks[-1]
            last.channels = (last.channels or set()) | ({channel} if size else set())

    def gap(self, begin: int, end: int) -> None:
        """See ChunkedStorage: an index that is damaged does not tell all channels."""
        super().gap(begin, end)
        if self._whole:
            self.chunks[-1].channels = None
        self._whole = False

    def learn(self, source: Source, record: Record) -> None:
        """See ChunkedStorage."""
        if record.kind not in (SCHEMA, CHANNEL):
            return
        data = source.read(record.begin, record.end - record.begin)
        try:
            number = int.from_bytes(data[:2], "little")
            if record.kind == SCHEMA:
                kind = _text(data, 2)[0]
                self._types[number] = kind if kind in READ else self._types.get(number, kind)
            else:
                self.declared.add(number)
                topic, encoding_at = _text(data, 4)
                if _text(data, encoding_at)[0] == "cdr":
                    self.name(number, topic, self._types.get(int.from_bytes(data[2:4], "little"), ""))
        except ValueError:
            self.note_damage(record.begin, "a topic that cannot be read")

    def message(self, source: Source, record: Record) -> Message | None:
        """See ChunkedStorage."""
        if record.kind != MESSAGE:
            return None
        channel, _, time, _ = MESSAGE_HEAD.unpack(source.read(record.begin, MESSAGE_HEAD.size))
        return Message(channel, time, record.begin + MESSAGE_HEAD.size, record.end)


def _chunk(source: Source, begin: int, length: int) -> Chunk | None:
    """The head of a chunk, where its sizes agree."""
    head = source.read(begin, CHUNK_HEAD.size + 16)
    if len(head) < CHUNK_HEAD.size + 8:
        return None
    start, end, size, crc, letters = CHUNK_HEAD.unpack_from(head)
    name = head[CHUNK_HEAD.size : CHUNK_HEAD.size + letters] if letters <= 8 else b"?"
    before = CHUNK_HEAD.size + letters + 8
    stored = int.from_bytes(head[before - 8 : before], "little")
    if name.decode("latin-1") not in COMPRESSIONS or len(head) < before or before + stored != length:
        return None
    return Chunk(begin + before, stored, name.decode(), size, crc, start, end)


def _text(data: bytes, at: int) -> tuple[str, int]:
    """A text with its length before it, and the place behind. Raises ValueError where it is longer than the data."""
    end = at + 4 + int.from_bytes(data[at : at + 4], "little")
    if end > len(data):
        raise ValueError("a text that is longer than its record")
    return data[at + 4 : end].decode("utf-8"), end
