"""What a file of a recording answers, whatever its kind; and what files of chunks have in common."""

from __future__ import annotations

import re
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
from .walk import Effort, FileSource, Layout, MemorySource, Record, Source, records

LAST = (1 << 63) - 1  # ns: the latest time
READ = {*(f"sensor_msgs/msg/{name}" for name in ("Image", "CompressedImage", "CameraInfo")), "std_msgs/msg/String"}
NAME = re.compile(r"/?[A-Za-z~{][\w~{}/]*")
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
        self.other_names: set[tuple[int, str, str]] = set()  # channel, name, type: of two places that differ
        self.revised = 0  # chunks that hold more than is said of them
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
    def nameless(self) -> set[int]:
        """Channels with messages of which nothing is known."""

    @abstractmethod
    def close(self) -> None:
        """Let the file go."""

    def note_damage(self, position: int, reason: str) -> None:
        """Remember what cannot be read."""
        if len(self.damaged) < MOST_NOTED:
            self.damaged.setdefault(position, shown(reason, quoted=False))


def _read_as(topic: str, kind: str) -> bool:
    """Whether that can be a topic with messages of a type that is read."""
    return kind in READ and NAME.fullmatch(topic) is not None


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
        self.declared: set[int] = set()  # channels of which a record tells anything, though it be of no use
        self.said = 0  # chunks that there are by the index
        self._source = FileSource(path)
        self._effort = Effort()  # for what is damaged in chunks
        self._around: dict[int, list[Message]] = {}  # the messages of damaged chunks
        self._kept: tuple[Chunk, bytes | bytearray, list[Message]] | None = None  # the chunk that was read last
        with ExitStack() as stack:
            stack.callback(self.close)
            self._open()
            stack.pop_all()
        self._starts = np.array([min(chunk.start, LAST) for chunk in self.chunks], np.int64)
        self._ends = np.array([min(chunk.end, LAST) for chunk in self.chunks], np.int64)

    def _open(self) -> None:
        for record in records(self._source, self.begin, self.layout, self.gap, Effort()):
            self.take(self._source, record)
        refuse_total(sum(chunk.unpacked for chunk in self.chunks if chunk.unpacked <= MOST_UNPACKED), self._source.size)
        if self.said > len(self.chunks):
            self.note_damage(self._source.size, f"{self.said - len(self.chunks)} pieces that its index names")
        self._learn(self.chunks[:1])  # what stands there has a checksum, unlike what an index repeats
        known = {channel for channel, (_, kind) in self.topics.items() if kind}
        if self.damaged or any(chunk.channels is None or not chunk.channels <= known for chunk in self.chunks):
            self._learn(self.chunks)
        if self.topics and (strange := self.nameless() - self.declared):
            self.note_damage(self._source.size, f"messages of {len(strange)} topics that nothing names")
        if not self.topics:  # their names are for the reader to guess
            self.topics = dict.fromkeys(self.nameless(), ("", ""))
        if not self.topics:
            raise ValueError("there are no messages in it")

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

    def name(self, channel: int, topic: str, kind: str) -> None:
        """Remember a topic; where two places differ, the one that can be read goes first, and the other one stays."""
        claim, before = (topic, kind), self.topics.get(channel, ("", ""))
        if before == claim:
            return
        if not _read_as(*before) or channel not in self.topics:
            claim, before = before, claim
            self.topics[channel] = before
        if _read_as(*claim):
            self.other_names.add((channel, *claim))

    def _learn(self, chunks: list[Chunk]) -> None:
        """Look into chunks for the topics, and for what their heads do not tell."""
        for chunk in chunks:
            content = self._content(chunk)
            source = MemorySource(content)
            found = []
            for record in records(source, 0, self.layout, lambda begin, end: None, self._effort):
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
            content, found = self._read(number)
            for channel, time, begin, end in found:
                if channel in channels and first <= time <= last:
                    yield time, bytes(memoryview(content)[begin:end])

    def nameless(self) -> set[int]:
        return {channel for chunk in self.chunks for channel in chunk.channels or ()} - set(self.topics)

    def _read(self, number: int) -> tuple[bytes | bytearray, list[Message]]:
        """The content of a chunk and the messages in it; none where it is damaged."""
        chunk = self.chunks[number]
        if self._kept is None or self._kept[0] is not chunk:
            self._kept = None  # before memory for another one is taken
            content = self._content(chunk)
            found = self._around.get(number)
            self._kept = chunk, content, self._messages(number, content) if found is None else found
        return self._kept[1:]

    def _messages(self, number: int, content: bytes | bytearray) -> list[Message]:
        """The messages in the content of a chunk, which are remembered where finding them took a search."""
        source, position = MemorySource(content), self.chunks[number].position
        found: list[Message] = []

        def gap(begin: int, end: int) -> None:
            self.note_damage(position + begin, f"no messages in {end - begin} bytes of a chunk")
            self._around[number] = found

        for record in records(source, 0, self.layout, gap, self._effort):
            message = self.message(source, record)
            found += [message] if message else []
        self._revise(number, found)
        return found

    def _revise(self, number: int, found: list[Message]) -> None:
        """Compare what a chunk holds with what its head and its index said of it."""
        chunk = self.chunks[number]
        channels, times = {message.channel for message in found}, [message.time for message in found]
        if not found or chunk.channels is None:
            return
        if not channels <= chunk.channels or min(times) < chunk.start or max(times) > chunk.end:
            self.note_damage(chunk.position, "a chunk that holds other messages than its index says")
            chunk.channels |= channels
            chunk.start, chunk.end = min(chunk.start, *times), max(chunk.end, *times)
            self._starts[number], self._ends[number] = min(chunk.start, LAST), min(chunk.end, LAST)
            self.revised += 1

    def _content(self, chunk: Chunk) -> bytes | bytearray:
        """Its bytes; none where they are damaged or too many, and it counts as empty then."""
        try:
            if max(chunk.size, chunk.unpacked) > MOST_UNPACKED:
                raise ValueError(too_large(max(chunk.size, chunk.unpacked)))
            content = unpacked(self._source.read(chunk.position, chunk.size), chunk.compression, chunk.unpacked)
            if len(content) != chunk.unpacked:
                raise ValueError(f"{in_bytes(len(content))} in a chunk that says to have {in_bytes(chunk.unpacked)}")
            if chunk.crc and zlib.crc32(content) != chunk.crc:
                raise ValueError("the checksum of a chunk is another one")
        except damage() as error:
            self.note_damage(chunk.position, str(error) or type(error).__name__)
            chunk.channels = set()
            return b""
        return content

    def close(self) -> None:
        self._kept = None
        self._source.close()
