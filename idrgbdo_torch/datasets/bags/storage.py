"""What a file of a recording answers, whatever its kind; and what files of chunks have in common."""

from __future__ import annotations

import zlib
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...text.plain import shown
from ..bag_files import damage
from .unpack import MOST_UNPACKED, in_bytes, refuse_total, too_large, unpacked
from .walk import FileSource, Layout, MemorySource, Record, Source, records

LAST = (1 << 63) - 1  # ns: the latest time
MOST_NOTED = 10_000  # places that are told apart


class Message(NamedTuple):
    """A message in the bytes of a chunk."""

    channel: int
    time: int  # ns, at which it was recorded
    begin: int
    end: int


class Storage(ABC):
    """An open file of a recording. Opening raises whatever `damage()` names where it is none at all."""

    def __init__(self) -> None:
        self.topics: dict[int, tuple[str, str]] = {}  # name and type of each channel's messages
        self.damaged: dict[int, str] = {}  # what cannot be read, by the byte at which it begins
        self.notes: list[str] = []  # what else is to be said

    @abstractmethod
    def messages(
        self, channels: Collection[int], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[int, bytes]]:
        """Time of recording (ns, from start until before stop) and data of all messages that can be read.

        They come as they are stored, which need not be the order of their times.
        """

    @abstractmethod
    def close(self) -> None:
        """Let the file go."""

    def note_damage(self, position: int, reason: str) -> None:
        """Remember what cannot be read."""
        if len(self.damaged) < MOST_NOTED:
            self.damaged.setdefault(position, shown(reason, quoted=False))


@dataclass(slots=True)
class Chunk:
    """A piece of the file that is read at once: many messages, or one."""

    position: int  # of its stored bytes
    size: int  # of them
    compression: str = ""
    unpacked: int = 0  # bytes that it says to have
    crc: int = 0  # of these; 0 where it is not known
    start: int = 0  # ns: times of its messages
    end: int = LAST
    channels: set[int] | None = None  # that occur in it, where that is known


class ChunkedStorage(Storage):
    """A file of chunks, all of which are found by going through it; indexes and summaries are not asked."""

    layout: Layout
    begin = 0  # byte at which records begin

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.chunks: list[Chunk] = []
        self._source = FileSource(path)
        self._kept: tuple[Chunk, bytes | bytearray, list[Message]] | None = None  # the chunk that was read last
        with ExitStack() as stack:
            stack.callback(self.close)
            self._open()
            stack.pop_all()
        self._starts = np.array([min(chunk.start, LAST) for chunk in self.chunks], np.int64)
        self._ends = np.array([min(chunk.end, LAST) for chunk in self.chunks], np.int64)

    def _open(self) -> None:
        for record in records(self._source, self.begin, self.layout, self.gap):
            self.take(self._source, record)
        refuse_total(sum(chunk.unpacked for chunk in self.chunks), self._source.size)
        known = set(self.topics)
        if self.damaged or any(chunk.channels is None or not chunk.channels <= known for chunk in self.chunks):
            self._learn()
        if not self.topics:
            raise ValueError("there are no topics in it")

    @abstractmethod
    def take(self, source: Source, record: Record) -> None:
        """Remember what a record of the file says: of a chunk, a message, a topic."""

    @abstractmethod
    def learn(self, source: Source, record: Record) -> None:
        """Remember what a record in the file or in a chunk says of a topic, if it does."""

    @abstractmethod
    def message(self, source: Source, record: Record) -> Message | None:
        """The message that a record is, if it is one."""

    def gap(self, begin: int, end: int) -> None:
        """No record can be told in these bytes."""
        self.note_damage(begin, f"no records from byte {begin} to {end}")

    def _learn(self) -> None:
        """Look into all chunks for the topics, and for what their heads do not tell."""
        for chunk in self.chunks:
            content = self._content(chunk)
            source = MemorySource(content)
            found = []
            for record in records(source, 0, self.layout, lambda begin, end: None):
                self.learn(source, record)
                message = self.message(source, record)
                found += [message] if message else []
            if found and chunk.channels is None:
                chunk.channels = {message.channel for message in found}
                chunk.start, chunk.end = (pick(message.time for message in found) for pick in (min, max))

    def messages(
        self, channels: Collection[int], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[int, bytes]]:
        first, last = -LAST if start is None else start, LAST if stop is None else stop - 1
        for number in np.flatnonzero((self._starts <= last) & (self._ends >= first)).tolist():
            chunk = self.chunks[number]
            if chunk.channels is not None and chunk.channels.isdisjoint(channels):
                continue
            content, found = self._read(chunk)
            for channel, time, begin, end in found:
                if channel in channels and first <= time <= last:
                    yield time, bytes(memoryview(content)[begin:end])

    def _read(self, chunk: Chunk) -> tuple[bytes | bytearray, list[Message]]:
        """The content of a chunk and the messages in it; none where it is damaged."""
        if self._kept is None or self._kept[0] is not chunk:
            self._kept = None  # before memory for another one is taken
            source = MemorySource(content := self._content(chunk))

            def gap(begin: int, end: int) -> None:
                self.note_damage(chunk.position + begin, f"no messages in {end - begin} bytes of a chunk")

            found = (self.message(source, record) for record in records(source, 0, self.layout, gap))
            self._kept = chunk, content, [message for message in found if message]
        return self._kept[1:]

    def _content(self, chunk: Chunk) -> bytes | bytearray:
        """Its bytes; none where they are damaged or too many."""
        if max(chunk.size, chunk.unpacked) > MOST_UNPACKED:
            self.note_damage(chunk.position, too_large(max(chunk.size, chunk.unpacked)))
            return b""
        try:
            content = unpacked(self._source.read(chunk.position, chunk.size), chunk.compression, chunk.unpacked)
            if len(content) != chunk.unpacked:
                raise ValueError(f"{in_bytes(len(content))} in a chunk that says to have {in_bytes(chunk.unpacked)}")
            if chunk.crc and zlib.crc32(content) != chunk.crc:
                raise ValueError("the checksum of a chunk is another one")
        except damage() as error:
            self.note_damage(chunk.position, str(error) or type(error).__name__)
            return b""
        return content

    def close(self) -> None:
        self._kept = None
        self._source.close()
