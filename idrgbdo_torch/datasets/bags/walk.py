"""Goes from record to record, and behind damage to the next one that can be told."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from ...text.files import open_plain

WINDOW = 1 << 20  # bytes that are searched at a time
OVERLAP = 64  # bytes of a pattern at most
MOST_SEARCHED = 512 << 20  # bytes without any record, in all, before the rest counts as none
MOST_TRIES = 200_000  # places that look like a record and are none


class Source(Protocol):
    """Bytes that can be read from anywhere."""

    size: int

    def read(self, position: int, count: int) -> bytes: ...


class Record(NamedTuple):
    """One record."""

    kind: int
    begin: int  # of its content, in bytes
    end: int  # of the record: where the next one begins
    head: Any  # what the layout knows of it already


class Layout(Protocol):
    """How the records of a kind of recording are written."""

    pattern: re.Pattern[bytes]  # some of their first bytes

    def record(self, source: Source, position: int) -> Record | None:
        """The record at a place, where there is one by all that can be told from its head."""

    def beginnings(self, source: Source, match: int) -> Iterable[int]:
        """The places around a match of the pattern where records begin."""

    def may_lie(self, record: Record) -> bool:
        """Whether nothing in the record vouches for its length."""


class FileSource:
    """A file."""

    def __init__(self, path: Path) -> None:
        self._file = open_plain(path)
        self.size = self._file.seek(0, 2)

    def read(self, position: int, count: int) -> bytes:
        if position >= self.size:
            return b""
        self._file.seek(position)
        return self._file.read(min(count, self.size - position))

    def close(self) -> None:
        self._file.close()


class MemorySource:
    """Bytes in memory."""

    def __init__(self, data: bytes | bytearray) -> None:
        self._data = memoryview(data)
        self.size = len(data)

    def read(self, position: int, count: int) -> bytes:
        return bytes(self._data[position : position + count])


class Effort:
    """What searching may still cost."""

    def __init__(self) -> None:
        self.bytes = MOST_SEARCHED
        self.tries = MOST_TRIES


def records(
    source: Source, begin: int, layout: Layout, damaged: Callable[[int, int], object], effort: Effort
) -> Iterator[Record]:
    """All records from `begin` on. damaged: told where nothing can be read, from byte to byte."""
    position = begin
    doubtful: int | None = None  # where the content of the last record begins, if its length may be wrong
    while position < source.size:
        record = layout.record(source, position)
        if record is not None:
            yield record
            position, doubtful = record.end, record.begin if layout.may_lie(record) else None
            continue
        following = _search(source, position + 1 if doubtful is None else doubtful, layout, effort)
        damaged(position, max(position, following))
        position, doubtful = following, None


def _search(source: Source, begin: int, layout: Layout, effort: Effort) -> int:
    """Where the next record begins; the end of the source where none does, or looking for one takes too much."""
    while begin < source.size and effort.bytes > 0 and effort.tries > 0:
        window = source.read(begin, WINDOW + OVERLAP)
        effort.bytes -= WINDOW
        for match in layout.pattern.finditer(window):
            effort.tries -= 1
            if effort.tries < 0:
                return source.size
            for place in layout.beginnings(source, begin + match.start()):
                if place >= begin:
                    return place
        begin += WINDOW
    return source.size
