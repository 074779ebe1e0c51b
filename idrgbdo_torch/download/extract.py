"""Unpacks a gzipped tar archive that nobody vouches for."""

from __future__ import annotations

import gzip
import shutil
import tarfile
import zlib
from pathlib import Path, PurePosixPath

from ..errors import IdRgbdoError

MOST_BYTES = 16 << 30  # unpacked, where nothing better is known
MOST_FILES = 200_000
MOST_AT_ONCE = 1 << 20  # bytes of a header or of one piece of a file
MOST_RATIO, MOST_SMALL = 8, 64 << 20  # times the archive, plus bytes: images do not shrink any more, lists do
DEEPEST = 16  # folders


class _Guarded:
    """A decompressed stream that only goes forward and gives up where an archive wants more than it may."""

    def __init__(self, file: gzip.GzipFile, most: int) -> None:
        self._file = file
        self._most = most
        self._position = 0
        self._last = b""  # byte: tarfile steps back by one to see whether the stream goes on

    def read(self, size: int = -1) -> bytes:
        if size < 0 or size > MOST_AT_ONCE:
            raise IdRgbdoError(f"archive: asks for {size} bytes at once, which no recording does; do not use it")
        back = self._file.tell() - self._position
        data = self._last[:size] if back else b""
        data += self._file.read(size - len(data))
        self._position += len(data)
        self._last = data[-1:] or self._last
        if self._position > self._most:
            raise IdRgbdoError(f"archive: unpacks to more than {self._most} bytes; do not use it")
        return data

    def seek(self, position: int, whence: int = 0) -> int:
        if position > self._most or whence:
            raise IdRgbdoError(f"archive: holds more than {self._most} bytes; do not use it")
        if position < self._file.tell() - 1:  # a decompressor would begin anew each time
            raise IdRgbdoError("archive: goes backwards, which no recording does; do not use it")
        while self._position < position and self.read(min(position - self._position, MOST_AT_ONCE)):
            pass
        self._position = min(self._position, position)
        return self._position

    def tell(self) -> int:
        return self._position


def extract(archive: Path, folder: Path, *, most_bytes: int = MOST_BYTES, most_files: int = MOST_FILES) -> None:
    """Unpack the archive's one top folder as `folder`, complete or not at all.

    Only plain files and folders inside that top folder are taken. Raises IdRgbdoError for a damaged archive and for one
    with anything else: absolute names, `..`, links, devices, holes, more than most_bytes or most_files, folders more
    than 16 deep, contents that are many times the archive's size.
    """
    unfinished = folder.with_name(folder.name + ".unpacking")
    try:
        shutil.rmtree(unfinished, ignore_errors=True)
        most_bytes = min(most_bytes, MOST_RATIO * archive.stat().st_size + MOST_SMALL)
        with gzip.open(archive, "rb") as stream:
            guarded = _Guarded(stream, most_bytes + MOST_AT_ONCE)
            with tarfile.open(fileobj=guarded, mode="r:") as tar:  # type: ignore[call-overload]
                top = _unpack(tar, unfinished, most_bytes, most_files)
        (unfinished / top).replace(folder)
    except RecursionError as error:
        raise IdRgbdoError(f"archive: '{archive}' has headers upon headers; do not use it") from error
    except IdRgbdoError:
        raise
    except (tarfile.TarError, EOFError, zlib.error, gzip.BadGzipFile, ValueError, OverflowError) as error:
        raise IdRgbdoError(f"archive: '{archive}' is damaged ({error}); remove it and call again") from error
    except OSError as error:
        raise IdRgbdoError(f"archive: cannot unpack '{archive}' to '{folder}': {error}; free some space") from error
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _unpack(tar: tarfile.TarFile, folder: Path, most_bytes: int, most_files: int) -> str:
    """Write the members into `folder`; the name of their common top folder."""
    tops, size = set(), 0
    for number, member in enumerate(tar, start=1):
        path = _safe_path(member)
        tops.add(path.parts[0])
        size += member.size
        if size > most_bytes or number > most_files:
            raise IdRgbdoError(f"archive: unpacks to more than {most_bytes} bytes or {most_files} files; do not use it")
        if len(tops) > 1:
            raise IdRgbdoError(f"archive: expected one folder, got {' and '.join(sorted(tops))}; do not use it")
        target = folder.joinpath(*path.parts)
        if member.isdir():
            target.mkdir(parents=True, exist_ok=True)
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        source = tar.extractfile(member)
        if source is None:
            raise IdRgbdoError(f"archive: '{member.name}' has no contents; do not use it")
        with target.open("xb") as file:  # never over a file that is there
            shutil.copyfileobj(source, file)
    if not tops:
        raise IdRgbdoError("archive: is empty; remove it and call again")
    return str(tops.pop())


def _safe_path(member: tarfile.TarInfo) -> PurePosixPath:
    """The member's path. Raises IdRgbdoError for what must not be unpacked."""
    path = PurePosixPath(member.name)
    kind = "a link" if member.issym() or member.islnk() else "a device or a pipe"
    if not (member.isreg() or member.isdir()):
        raise IdRgbdoError(f"archive: '{member.name}' is {kind}, expected files and folders; do not use it")
    wrong = path.is_absolute() or ".." in path.parts or "\\" in member.name or ":" in member.name or not path.parts
    if member.issparse() or member.size < 0:
        raise IdRgbdoError(f"archive: '{member.name}' has holes, which no recording has; do not use it")
    if len(path.parts) > DEEPEST or not member.name.isprintable():
        raise IdRgbdoError(f"archive: '{member.name[:80]}' is no name of a recording's file; do not use it")
    if wrong:
        raise IdRgbdoError(f"archive: '{member.name}' would lie outside its folder; do not use it")
    if not member.isdir() and len(path.parts) < 2:
        raise IdRgbdoError(f"archive: expected one folder, got the file '{member.name}' beside it; do not use it")
    return path
