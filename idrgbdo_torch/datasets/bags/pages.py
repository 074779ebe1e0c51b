"""Rows of a damaged SQLite database, from the pages that hold rows; the pages that lead to them are not needed.

The format: https://sqlite.org/fileformat2.html. A leaf page of a table begins with 13; its cells hold a row each, of
which what does not fit goes on in a chain of further pages.
"""

from __future__ import annotations

import re
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .storage import LAST
from .unpack import MOST_UNPACKED
from .walk import FileSource

USUAL_PAGE = 4096
PAGES = tuple(1 << k for k in range(9, 17))  # bytes that a page can have
HEADER = 100  # bytes of the first page that are no page
LEAF = 13
WINDOW = 1024  # pages that are read at a time
MOST_HEAD = 512  # bytes that tell the types of a row's columns
LOOK_AT = 50  # rows of several pages, most of which must be whole, so that the size of a page is believed
MOST_ROWS = 20_000_000
TYPE = re.compile(r"[\w/]+/msg/\w+")
INTEGERS = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8}  # bytes by their type
Value = int | bytes | None


class Row(NamedTuple):
    """Where the data of a message stand."""

    topic: int
    time: int  # ns
    page: int  # from 0
    payload: int  # byte in the page at which the row begins
    local: int  # bytes of it there
    length: int  # of the whole row
    data: int  # byte of the row at which its data begin


class Pages:
    """All rows of `topics` and `messages` that can be found."""

    def __init__(self, path: Path) -> None:
        self._source = FileSource(path)
        found = []
        for sizes in _sizes(self._source.read(0, HEADER)):
            self._find(*sizes)
            long = list(islice((number for number, row in self.rows.items() if row.local < row.length), LOOK_AT))
            whole = sum(self.data(number) is not None for number in long)
            found.append((whole, len(self.rows), sizes))
            if 2 * whole > len(long) or (self.rows and not long):
                return
        self._find(*max(found)[-1])

    def _find(self, page: int, usable: int) -> None:
        """Find all rows by the size of a page, and how much of it is used."""
        self._page, self._usable = page, usable
        self.topics: dict[int, tuple[str, str]] = {}
        self.rows: dict[int, Row] = {}
        for first in range(0, self._source.size, WINDOW * self._page):
            window = np.frombuffer(self._source.read(first, WINDOW * self._page), np.uint8)
            kinds = window[:: self._page]
            for number in np.flatnonzero(kinds == LEAF).tolist():
                begin = number * self._page
                self._leaf(window[begin : begin + self._page].tobytes(), first // self._page + number, 0)
            if first == 0 and len(window) > HEADER and window[HEADER] == LEAF:
                self._leaf(window[: self._page].tobytes(), 0, HEADER)

    def _leaf(self, page: bytes, number: int, begin: int) -> None:
        """Take the rows of a page, those that are none left out."""
        cells, topics = int.from_bytes(page[begin + 3 : begin + 5]), len(self.topics)
        for place in range(begin + 8, min(begin + 8 + 2 * cells, len(page) - 1), 2):
            at = int.from_bytes(page[place : place + 2])
            if place < at < self._usable and len(self.rows) < MOST_ROWS:
                self._cell(page, number, at)
        if len(self.topics) > topics:  # others may stand beside it though nothing leads to them
            for at in range(begin + 8, self._usable):
                self._cell(page, number, at)

    def _cell(self, page: bytes, number: int, at: int) -> None:
        length, at = _varint(page, at)
        key, at = _varint(page, at)
        key -= (key >> 63) << 64
        local = self._local(length)
        if length > MOST_UNPACKED or local < 5 or at + local > self._usable:
            return
        head = page[at : at + local]
        found = _columns(head)
        if found is None:
            return
        values, ends = found
        if len(values) == 4 and length == ends[-1]:
            own, topic, time, _ = values
            if own in (None, key) and isinstance(topic, int) and isinstance(time, int) and 0 <= time <= LAST:
                self.rows.setdefault(key, Row(topic, time, number, at, local, length, ends[2]))
                return
        if len(values) >= 4 and length == ends[-1] and isinstance(values[1], bytes) and isinstance(values[2], bytes):
            name, kind = (text.decode("utf-8", "replace") for text in values[1:3] if isinstance(text, bytes))
            if TYPE.fullmatch(kind) and name:
                self.topics.setdefault(key, (name, kind))

    def _local(self, length: int) -> int:
        """Bytes of a row that stand in its page."""
        most = self._usable - 35
        if length <= most:
            return length
        least = (self._usable - 12) * 32 // 255 - 23
        local = least + (length - least) % (self._usable - 4)
        return local if local <= most else least

    def data(self, number: int) -> bytes | None:
        """The message in a row; None where its chain of pages is broken."""
        row = self.rows.get(number)
        if row is None:
            return None
        page = self._source.read(row.page * self._page, self._page)
        content = bytearray(page[row.payload : row.payload + row.local])
        behind = row.payload + row.local
        following = int.from_bytes(page[behind : behind + 4]) if row.local < row.length else 0
        while len(content) < row.length:
            if not 1 < following <= self._source.size // self._page:
                return None
            page = self._source.read((following - 1) * self._page, self._page)
            following = int.from_bytes(page[:4])
            content += page[4 : min(self._usable, 4 + row.length - len(content))]
        return bytes(memoryview(content)[row.data :]) if following == 0 or row.local == row.length else None

    def close(self) -> None:
        """Let the file go."""
        self._source.close()


def _sizes(head: bytes) -> list[tuple[int, int]]:
    """Bytes of a page, and those of them that are used, by the head of the file, and others, as it may be damaged."""
    size = int.from_bytes(head[16:18])
    size = 1 << 16 if size == 1 else size
    reserved = head[20] if len(head) > 20 else 0
    others = [(page, page) for page in (size, USUAL_PAGE, *PAGES)]
    sizes = [(page, used) for page, used in [(size, size - reserved), *others] if page in PAGES and used >= 480]
    return list(dict.fromkeys(sizes))


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """A number of one to nine bytes, of which the first bit of each but the ninth says whether it goes on."""
    value = 0
    for count, byte in enumerate(data[at : at + 9], start=1):
        if count == 9:
            return value << 8 | byte, at + 9
        value = value << 7 | byte & 127
        if byte < 128:
            return value, at + count
    return 0, len(data)


def _columns(row: bytes) -> tuple[list[Value], list[int]] | None:
    """The columns of a row and where each ends; of those that do not stand in `row`, nothing. None for no row."""
    size, at = _varint(row, 0)
    if not 2 <= size <= min(MOST_HEAD, len(row)):
        return None
    place, values, ends = size, [], []
    while at < size:
        kind, at = _varint(row, at)
        if kind in (10, 11):
            return None
        length = INTEGERS.get(kind, 8 if kind == 7 else max(0, kind - 12) // 2)
        value: Value = None
        if kind in (8, 9):
            value = kind - 8
        elif kind in INTEGERS:
            value = int.from_bytes(row[place : place + length], signed=True)
        elif kind >= 12 and place + length <= len(row):
            value = row[place : place + length]
        place += length
        values.append(value)
        ends.append(place)
    return values, ends
