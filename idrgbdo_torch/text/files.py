"""Files from outside: plain ones of a bounded size, their text in any encoding, JSON, TOML and tables in it.

Whatever can be wrong with a file becomes an IdRgbdoError that names it, and the line where there is one. This is the
only place that reads such files, so that a folder, a pipe or a device under a file's name is refused everywhere alike.
"""

from __future__ import annotations

import codecs
import csv
import errno
import io
import json
import os
import stat
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..errors import IdRgbdoError
from .plain import shown

MOST_TEXT = 256 << 20  # bytes of a list or a trajectory: a day at 30 frames a second
MOST_SETTINGS = 1 << 20  # bytes of settings and calibrations, whose parsers are slow
MOST_JSON = 64 << 20
MOST_DOTS = 50  # in a key of TOML, whose parser takes the square of their number
# what reading and taking apart somebody else's text raises; UnicodeError is a ValueError
DAMAGE = (OSError, ValueError, ArithmeticError, LookupError, TypeError, AttributeError, RecursionError, MemoryError)


def read_bytes(path: Path, most: int, topic: str = "file", advice: str = "replace it") -> bytes:
    """All of a plain file of at most `most` bytes.

    topic, advice: begin and end of the sentence where that is not possible: `topic: cannot read 'path': ...; advice`.
    Raises IdRgbdoError for a file that is missing, larger, or a folder, a pipe, a device.
    """
    try:
        return plain_bytes(path, most)
    except OSError as error:
        raise unreadable(path, error, topic, advice) from error


def plain_bytes(path: Path, most: int) -> bytes:
    """As read_bytes, but raises OSError, whose strerror is the reason."""
    file = plain_descriptor(path)
    try:
        size = os.fstat(file).st_size
        if size > most:
            raise OSError(errno.EFBIG, f"it has {size / (1 << 20):.1f} MB, more than {most >> 20} MB")
        parts = [os.read(file, size)]  # one call for nearly all: each gives up Python's lock
        while parts[-1] and sum(map(len, parts)) < size:
            parts.append(os.read(file, size - sum(map(len, parts))))
    finally:
        os.close(file)
    return parts[0] if len(parts) == 1 else b"".join(parts)


def open_plain(path: Path) -> io.BufferedReader:
    """A plain file, open for reading. Raises OSError, whose strerror is the reason, and never waits for a pipe."""
    return os.fdopen(plain_descriptor(path), "rb")


def plain_descriptor(path: Path, flags: int = os.O_RDONLY) -> int:
    """The number of a plain file, opened with `flags`. Raises OSError as open_plain, also for a pipe to write into."""
    try:
        file = os.open(path, flags | getattr(os, "O_BINARY", 0) | getattr(os, "O_NONBLOCK", 0), 0o666)
    except ValueError as error:
        raise OSError(errno.EINVAL, "no file can have that name") from error  # of a NUL in it
    mode = os.fstat(file).st_mode
    if not stat.S_ISREG(mode):
        os.close(file)
        raise OSError(errno.EINVAL, f"it is {_kind(mode)}, no file", str(path))
    return file


def is_plain_file(path: Path) -> bool:
    """Whether there is a file that can be read to its end; False for folders, pipes, and names that cannot be."""
    return os.path.isfile(path)  # Path.is_file raises OSError for a name that is too long


def is_named(path: Path) -> bool:
    """Whether something has that name that should be a file, so that what it is can be said: also a link to nothing."""
    return os.path.lexists(path) and not os.path.isdir(path)


def unreadable(path: Path, error: object, topic: str, advice: str) -> IdRgbdoError:
    """The error to raise for a file that cannot be read."""
    reason = error.strerror or str(error) if isinstance(error, OSError) else str(error) or type(error).__name__
    return IdRgbdoError(f"{topic}: cannot read '{path}': {reason}; {advice}")


@contextmanager
def damage_named(where: str, expected: str, advice: str = "correct it") -> Iterator[None]:
    """Raises IdRgbdoError, `where: expected ..., got ...`, for whatever taking a text apart raises inside."""
    try:
        yield
    except IdRgbdoError:
        raise
    except DAMAGE as error:
        raise IdRgbdoError(f"{where}: expected {expected} ({_reason(error)}); {advice}") from error


def read_text(path: Path, topic: str = "text", advice: str = "expected a text file", *, most: int = MOST_TEXT) -> str:
    """The text of a file in UTF-8 or UTF-16 (as PowerShell's `>` writes), with or without a byte order mark.

    Raises IdRgbdoError as read_bytes, and for bytes that are neither.
    """
    data = read_bytes(path, most, topic, advice)
    try:
        return _decoded(data)
    except UnicodeDecodeError as error:
        raise unreadable(path, error, topic, advice) from error


def _decoded(data: bytes) -> str:
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16")
    for encoding, zeros in (("utf-16-le", data[1:400:2]), ("utf-16-be", data[:400:2])):
        if zeros and zeros.count(0) > 0.5 * len(zeros):  # digits and Latin letters have a byte 0 there
            return data.decode(encoding)
    return data.decode("utf-8-sig")


def read_json(path: Path, topic: str = "text", advice: str = "correct it") -> Any:
    """The content of a JSON file. Raises IdRgbdoError with the line for what is none."""
    return parse_json(read_text(path, topic, advice, most=MOST_JSON), str(path), advice)


def parse_json(text: str, where: str, advice: str = "correct it") -> Any:
    """The content of JSON text. Raises IdRgbdoError with the line for what is none."""
    with damage_named(where, "JSON", advice):
        return json.loads(text)


def read_toml(path: Path, advice: str = "pass an existing TOML file") -> dict[str, Any]:
    """The content of a TOML file. Raises IdRgbdoError with the line for what is none."""
    return parse_toml(read_text(path, "configuration", advice, most=MOST_SETTINGS), str(path))


def parse_toml(text: str, where: str) -> dict[str, Any]:
    """The content of TOML text. Raises IdRgbdoError with the line for what is none."""
    for number, line in enumerate(text.splitlines(), start=1):
        if line.partition("=")[0].count(".") > MOST_DOTS:
            raise IdRgbdoError(f"configuration: '{where}' is not TOML: no key of line {number} is known; correct it")
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # ValueError: integers of too many digits, too
        comma = "; decimals have a point, not a comma" if any(_comma(line) for line in text.splitlines()) else ""
        raise IdRgbdoError(f"configuration: '{where}' is not TOML: {_reason(error)}{comma}; correct it") from error


def _comma(line: str) -> bool:
    _, equals, value = line.partition("=")
    left, comma, right = value.strip().partition(",")
    return bool(equals and comma) and left.strip().isdecimal() and right.strip().isdecimal()


def read_table(
    path: Path, columns: tuple[str, ...], topic: str = "run", advice: str = "pass the folder of a run"
) -> list[dict[str, str]]:
    """The rows of a CSV file with a heading, each with all its cells, those of `columns` among them.

    Raises IdRgbdoError, naming the line, for a file that cannot be read, lacks a column or has rows of other lengths.
    """
    text = read_text(path, topic, advice)
    try:
        reader = csv.DictReader(text.splitlines())
        missing = [name for name in columns if name not in (reader.fieldnames or ())]
        if missing:
            raise unreadable(path, f"it has no column {', '.join(missing)}", topic, advice)
        rows = []
        for row in reader:
            if None in row or None in row.values():
                cells = f"expected {len(reader.fieldnames or ())} cells in line {reader.line_num}, got others"
                raise unreadable(path, cells, topic, advice)
            rows.append(row)
    except csv.Error as error:
        raise unreadable(path, f"line {reader.line_num + 1}: {error}", topic, advice) from error
    return rows


def _kind(mode: int) -> str:
    if stat.S_ISDIR(mode):
        return "a folder"
    return "a pipe" if stat.S_ISFIFO(mode) else "a device or something else"


def _reason(error: BaseException) -> str:
    if isinstance(error, RecursionError):
        return "nested too deep"
    if isinstance(error, KeyError):
        return f"{shown(error.args[0] if error.args else '')} is missing"
    return shown(error, quoted=False) or type(error).__name__
