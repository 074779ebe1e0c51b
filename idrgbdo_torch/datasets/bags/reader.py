"""A recording of ROS as a whole: its files, its topics, its messages."""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from ...errors import IdRgbdoError
from ...text.files import is_named, open_plain, read_text
from ..bag_files import MOST_METADATA, damage
from .guess import complete, unite
from .mcap import McapStorage
from .ros1 import Ros1Storage
from .sqlite import SqliteStorage
from .storage import Storage
from .unpack import ZSTD_START, unpacked, unpacked_file

STORAGES: Mapping[str, Callable[[Path], Storage]] = {
    ".bag": Ros1Storage,
    ".mcap": McapStorage,
    ".db3": SqliteStorage,
}
FILES = re.compile(r"^ *relative_file_paths: *((?:\n *- [^\n]*)+|\[[^\]\n]*\])", re.MULTILINE)
PACKED = ".zstd"  # behind the name of a file that is packed as a whole


class Connection(NamedTuple):
    """A topic of a recording."""

    topic: str
    msgtype: str


class Reader:
    """An open recording: a file, or a folder with metadata.yaml and one file or several."""

    def __init__(self, path: Path) -> None:
        """Raises IdRgbdoError, or what `damage()` names, where nothing in it can be read."""
        from rosbags.typesys import Stores, get_typestore

        self.is2 = path.suffix != ".bag"
        # the types of the messages that are read are the same in all recordings: what a recording says of them may be
        # damaged, or something else
        store = get_typestore(Stores.ROS2_HUMBLE if self.is2 else Stores.ROS1_NOETIC)
        self._deserialize: Callable[[bytes, str], Any] = store.deserialize_cdr if self.is2 else store.deserialize_ros1
        self._types: Container[str] = store.types
        self.notes: list[str] = []
        self._unpacked = TemporaryDirectory() if path.is_dir() else None
        self._storages: list[Storage] = []
        self._lost: list[str] = []  # files that cannot be opened, and why
        self._channels: dict[Connection, list[tuple[Storage, list[int]]]] = {}
        with ExitStack() as stack:
            stack.callback(self.close)
            self._open(path)
            stack.pop_all()

    def _open(self, path: Path) -> None:
        files = self._files(path)
        for file in files:
            try:
                self._storages.append(self._opened(file))
            except damage() as error:
                if len(files) == 1:
                    raise
                self._lost.append(f"'{file.name}': {error}")
        if not self._storages:
            raise ValueError("; ".join(self._lost) or "there is no .mcap or .db3 file in it")
        for storage in self._storages:
            note = complete(storage, self.deserialize, self._types)
            self.notes += [note] if note else []
        self.notes += unite(self._storages)
        for storage in self._storages:
            channels: dict[Connection, list[int]] = {}
            named = {*((number, *about) for number, about in storage.topics.items()), *storage.other_names}
            for number, *about in sorted(named):
                channels.setdefault(Connection(*about), []).append(number)
            for connection, numbers in channels.items():
                self._channels.setdefault(connection, []).append((storage, numbers))

    def _files(self, path: Path) -> list[Path]:
        """The files of a recording in their order, whatever its metadata.yaml is."""
        if not path.is_dir():
            return [path]
        there = sorted((file for file in path.iterdir() if _kind(file) in STORAGES and is_named(file)), key=_number)
        try:
            said = FILES.search(read_text(path / "metadata.yaml", "sequence", "copy it again", most=MOST_METADATA))
        except IdRgbdoError as error:
            if not there:
                raise
            self.notes.append(str(error))
            return there
        names = re.findall(r"[^\s,\[\]'\"][^\n,\[\]'\"]*", re.sub(r"^ *- ", "", said[1], flags=re.M)) if said else []
        listed = [path / name.strip().rpartition("/")[2] for name in names]
        if not listed or not all(_kind(file) in STORAGES for file in listed):
            if there:
                self.notes.append(f"{path / 'metadata.yaml'} does not tell the files of the recording: all are read")
            return there
        missing = [file.name for file in listed if not file.exists()]
        if missing and not there:
            raise ValueError(f"{', '.join(missing)} of metadata.yaml is not there")
        if missing:
            self.notes.append(f"{path / 'metadata.yaml'} names {', '.join(missing)}, which is not there")
            return there if len(missing) == len(listed) else [file for file in listed if file.exists()]
        return listed

    def _opened(self, file: Path) -> Storage:
        if file.suffix == PACKED and self._unpacked is not None:
            target = Path(self._unpacked.name) / file.stem
            damaged = unpacked_file(file, target)
            self._lost += [f"'{file.name}' can be unpacked in part: {damaged}"] if damaged else []
            file = target
        open_plain(file).close()  # SQLite would wait for a pipe
        return STORAGES[file.suffix](file)

    @property
    def connections(self) -> list[Connection]:
        """The topics."""
        return list(self._channels)

    def damaged(self) -> list[str]:
        """What could not be read until now, each a phrase."""
        return [*self._lost, *(reason for storage in self._storages for reason in storage.damaged.values())]

    def revised(self) -> int:
        """How often something was found that the index of its file does not know."""
        return sum(storage.revised for storage in self._storages)

    def said(self) -> list[str]:
        """What else is to be said of the files."""
        return [*self.notes, *(note for storage in self._storages for note in storage.notes)]

    def messages(
        self, connection: Connection, start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[int, bytes]]:
        """As Storage.messages; those that are packed each are unpacked."""
        for storage, numbers in self._channels[connection]:
            for time, data in storage.messages(numbers, start, stop):
                if self.is2 and data.startswith(ZSTD_START):
                    try:
                        yield time, bytes(unpacked(data, "zstd"))
                    except damage() as error:
                        storage.note_damage(time, f"a message that cannot be unpacked: {error}")
                else:
                    yield time, data

    def deserialize(self, data: bytes, msgtype: str) -> Any:
        """The message in these bytes. Raises what `damage()` names."""
        return self._deserialize(data, msgtype)

    def close(self) -> None:
        """Let the files go."""
        for storage in self._storages:
            storage.close()
        if self._unpacked is not None:
            self._unpacked.cleanup()


def _kind(file: Path) -> str:
    return Path(file.stem).suffix if file.suffix == PACKED else file.suffix


def _number(file: Path) -> tuple[int, str]:
    """What sorts `run_10.mcap` behind `run_9.mcap`."""
    digits = re.search(r"(\d{1,9})\D*$", file.name.partition(".")[0])
    return int(digits[1]) if digits else -1, file.name
