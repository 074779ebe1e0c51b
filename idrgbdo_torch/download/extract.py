"""Unpacks a gzipped tar archive that nobody vouches for."""

from __future__ import annotations

import gzip
import shutil
import tarfile
import zlib
from pathlib import Path, PurePosixPath

from ..errors import IdRgbdoError

MOST_BYTES = 16 << 30  # unpacked; the largest sequence of the benchmark has about 5 GB
MOST_FILES = 200_000
MOST_AT_ONCE = 1 << 20  # bytes of a header or of one piece of a file


class _Guarded:
    """A decompressed stream that gives up where an archive wants more than it may."""

    def __init__(self, file: gzip.GzipFile, most: int) -> None:
        self._file = file
        self._most = most

    def read(self, size: int = -1) -> bytes:
        if size < 0 or size > MOST_AT_ONCE:
            raise IdRgbdoError(f"archive: asks for {size} bytes at once, which no recording does; do not use it")
        data = self._file.read(size)
        self._check()
        return data

    def seek(self, position: int, whence: int = 0) -> int:
        if position > self._most:
            raise IdRgbdoError(f"archive: holds more than {self._most} bytes; do not use it")
        return self._file.seek(position, whence)

    def tell(self) -> int:
        return self._file.tell()

    def _check(self) -> None:
        if self._file.tell() > self._most:
            raise IdRgbdoError(f"archive: unpacks to more than {self._most} bytes; do not use it")


def extract(archive: Path, folder: Path, *, most_bytes: int = MOST_BYTES, most_files: int = MOST_FILES) -> None:
    """Unpack the archive's one top folder as `folder`, complete or not at all.

    Only plain files and folders inside that top folder are taken. Raises IdRgbdoError for a damaged archive and for one
    with anything else: absolute names, `..`, links, devices, more than most_bytes or most_files.
    """
    unfinished = folder.with_name(folder.name + ".unpacking")
    shutil.rmtree(unfinished, ignore_errors=True)
    try:
        with gzip.open(archive, "rb") as stream:
            guarded = _Guarded(stream, most_bytes + MOST_AT_ONCE)
            with tarfile.open(fileobj=guarded, mode="r:") as tar:  # type: ignore[call-overload]
                top = _unpack(tar, unfinished, most_bytes, most_files)
        (unfinished / top).replace(folder)
    except (tarfile.TarError, EOFError, zlib.error, gzip.BadGzipFile, ValueError) as error:
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
    if wrong or "\0" in member.name:
        raise IdRgbdoError(f"archive: '{member.name}' would lie outside its folder; do not use it")
    if not member.isdir() and len(path.parts) < 2:
        raise IdRgbdoError(f"archive: expected one folder, got the file '{member.name}' beside it; do not use it")
    return path
