"""The files of a ROS recording before they are opened, and what reading them may raise."""

from __future__ import annotations

import struct
from contextlib import suppress
from functools import cache
from importlib import import_module
from pathlib import Path

from ..errors import IdRgbdoError
from ..text.files import DAMAGE, is_named, is_plain_file, open_plain

INDEX_POSITION = b"index_pos="  # in the header of a ROS 1 bag: where its topics are listed, 0 until it is closed
# below rosbags, of different versions of it: their errors
LIBRARIES = {"sqlite3": "Error", "compression.zstd": "ZstdError", "backports.zstd": "ZstdError"}
MOST_METADATA = 256 << 10  # bytes of metadata.yaml: those of a thousand topics
HEAD = 4096  # bytes in which that header stands
INDEX = 16 << 20  # bytes of the index that are looked at; the topics stand at its beginning


@cache
def damage() -> tuple[type[Exception], ...]:
    """What rosbags, and the libraries below it, raise for damaged content."""
    from rosbags.serde import SerdeError

    kinds: list[type[Exception]] = [SerdeError, AssertionError, EOFError, RuntimeError, struct.error, *DAMAGE]
    for module, name in LIBRARIES.items():
        with suppress(ImportError):
            kinds.append(getattr(import_module(module), name))
    return tuple(kinds)


def check_files(path: Path) -> None:
    """Raises IdRgbdoError where no plain file is there, but something that would be waited for."""
    files = [path]
    if path.is_dir():
        files = [file for file in path.iterdir() if file.suffix in (".bag", ".mcap", ".db3", ".zstd")]
    strange = [file for file in files if is_named(file) and not is_plain_file(file)]
    if strange and len(strange) == len(files):  # of several, the others are read
        raise IdRgbdoError(
            f"sequence: expected a recording at '{strange[0]}', found a pipe or a device; check the path"
        )


def repair(path: Path) -> str:
    """What may make a recording readable again that cannot be opened."""
    suffixes = {file.suffix for file in path.iterdir()} if path.is_dir() else {path.suffix}
    tools = {".bag": "rosbag reindex", ".mcap": "mcap recover", ".db3": "sqlite3 FILE .recover"}
    named = [f"`{tool}`" for suffix, tool in tools.items() if suffix in suffixes]
    return f"repair it with {named[0]}, or record it again" if named else "repair or record it again"


def index_position(path: Path) -> int | None:
    """Where the index of a ROS 1 bag begins; 0 where it was not closed, None for another file."""
    try:
        with open_plain(path) as file:
            head = file.read(HEAD)
    except OSError:
        return None
    at = head.find(INDEX_POSITION) + len(INDEX_POSITION)
    if at < len(INDEX_POSITION) or len(head) < at + 8:
        return None
    return int(struct.unpack_from("<Q", head, at)[0])


def index_head(path: Path) -> bytes:
    """The beginning of the index of a ROS 1 bag, where its topics are; nothing of any other file."""
    position = index_position(path)
    if not position:
        return b""
    try:
        with open_plain(path) as file:
            file.seek(min(position, 1 << 62))
            return file.read(INDEX)
    except OSError:
        return b""
