"""The files of a ROS recording before rosbags opens them: whole, plain, and of a size that its reader can take."""

from __future__ import annotations

import struct
from contextlib import suppress
from functools import cache
from importlib import import_module
from pathlib import Path

from ..errors import IdRgbdoError
from ..text.files import DAMAGE, is_named, is_plain_file, read_bytes, unreadable

INDEX_POSITION = b"index_pos="  # in the header of a ROS 1 bag: where its topics are listed, 0 until it is closed
# below rosbags, of different versions of it: their errors
LIBRARIES = {"apsw": "Error", "sqlite3": "Error", "compression.zstd": "ZstdError", "backports.zstd": "ZstdError"}
MOST_METADATA = 256 << 10  # bytes of metadata.yaml: those of a thousand topics, parsed in seconds
DEEPEST = 50  # lists in lists there
HEAD = 4096  # bytes in which that header stands
INDEX = 16 << 20  # bytes of the index that are looked at; the topics stand at its beginning


@cache
def damage() -> tuple[type[Exception], ...]:
    """What rosbags, and the libraries below it, raise for damaged content."""
    from rosbags.highlevel import AnyReaderError
    from rosbags.rosbag1 import ReaderError as Error1
    from rosbags.rosbag2 import ReaderError as Error2
    from rosbags.serde import SerdeError
    from rosbags.typesys import TypesysError

    kinds: list[type[Exception]] = [AnyReaderError, Error1, Error2, SerdeError, TypesysError]
    kinds += [AssertionError, EOFError, RuntimeError, struct.error, *DAMAGE]
    for module, name in LIBRARIES.items():
        with suppress(ImportError):
            kinds.append(getattr(import_module(module), name))
    return tuple(kinds)


def check_files(path: Path) -> None:
    """Raises IdRgbdoError for what rosbags would wait for, read whole, or call damaged without saying what to do."""
    if path.is_dir():
        _check_metadata(path / "metadata.yaml")
        files = [file for file in path.iterdir() if file.suffix in (".mcap", ".db3", ".zstd")]
    else:
        files = [path]
    for file in files:
        if is_named(file) and not is_plain_file(file):
            raise IdRgbdoError(f"sequence: expected a recording at '{file}', found a pipe or a device; check the path")
    if path.suffix == ".bag" and index_position(path) == 0:
        raise IdRgbdoError(
            f"{path}: the recording was interrupted before its index was written; write it with "
            f"`rosbag reindex {path.name}`, which keeps the original as .orig.bag"
        )


def _check_metadata(path: Path) -> None:
    """Raises IdRgbdoError where the time of its parser, which grows with the square of the depth, would be long."""
    advice = "replace it, or name the .mcap or .db3 file"
    depth = 0
    for line in read_bytes(path, MOST_METADATA, "sequence", advice).splitlines():
        for letter in line:
            depth += (letter in b"[{") - (letter in b"]}")
            if depth > DEEPEST:
                raise unreadable(path, "nested too deep", "sequence", advice)
        if line.count(b"- ") > DEEPEST:
            raise unreadable(path, "nested too deep", "sequence", advice)


def repair(path: Path) -> str:
    """What may make a recording readable again that cannot be opened."""
    suffixes = {file.suffix for file in path.iterdir()} if path.is_dir() else {path.suffix}
    tools = {".bag": "rosbag reindex", ".mcap": "mcap recover", ".db3": "sqlite3 FILE .recover"}
    named = [f"`{tool}`" for suffix, tool in tools.items() if suffix in suffixes]
    return f"repair it with {named[0]}, or record it again" if named else "repair or record it again"


def index_position(path: Path) -> int | None:
    """Where the index of a ROS 1 bag begins; 0 where it was not closed, None for another file."""
    if not is_plain_file(path):
        return None
    try:
        with path.open("rb") as file:
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
        with path.open("rb") as file:
            file.seek(min(position, 1 << 62))
            return file.read(INDEX)
    except OSError:
        return b""
