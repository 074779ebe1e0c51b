"""Files that are there whole or not at all, and lists that grow by whole lines, whatever the disk does."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from ..errors import IdRgbdoError
from ..text.files import plain_descriptor


def cannot_write(path: Path, error: OSError) -> IdRgbdoError:
    """The sentence for a file that could not be written."""
    why = error.strerror or str(error)
    return IdRgbdoError(f"out: cannot write '{path}': {why}; make room there, or pass another --out")


def is_file_name(name: str) -> bool:
    """Whether a name from outside may be that of a file: it leads nowhere else and can be shown."""
    return name.isprintable() and name not in ("", ".", "..") and not any(sign in name for sign in '/\\:*?"<>|')


def write_whole(path: Path, content: str | bytes, make_folder: bool = False) -> None:
    """Replace a file in one step; a link is replaced, not followed. Raises IdRgbdoError where that fails.

    Names that are not UTF-8 occur in texts as lone surrogates, which are written as \\udcff.
    """
    data = content if isinstance(content, bytes) else content.encode("utf-8", errors="backslashreplace")
    part = path.with_name(path.name + ".part")
    try:
        if make_folder:
            path.parent.mkdir(parents=True, exist_ok=True)
        part.unlink(missing_ok=True)  # what has that name may be a pipe
        part.write_bytes(data)
        part.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise cannot_write(path, error) from error


class Lines:
    """A text file that grows; each piece goes to the system at once, and what did not fit is taken back."""

    def __init__(self, path: Path) -> None:
        """Begin the file anew. Raises OSError where that fails."""
        self.path = path
        begin_anew = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
        self._file = os.fdopen(plain_descriptor(path, begin_anew), "wb", buffering=0)
        self.size = 0  # bytes that are there whole

    def append(self, text: str) -> None:
        """Write a piece. Raises IdRgbdoError where it does not fit; nothing of it is there then."""
        left = memoryview(text.encode("utf-8", errors="backslashreplace"))
        size = self.size + len(left)
        try:
            while left:
                left = left[self._file.write(left) :]
        except OSError as error:
            self.cut(self.size)
            raise cannot_write(self.path, error) from error
        self.size = size

    def cut(self, size: int) -> None:
        """Drop what lies behind so many bytes."""
        with contextlib.suppress(OSError):
            self._file.truncate(size)
            self._file.seek(size)
        self.size = size

    def close(self) -> None:
        """Give the file back."""
        self._file.close()


def lock(folder: Path) -> int | None:
    """Keep other runs out of a folder until the number is closed, or this process ends in whatever way.

    None where the system cannot lock a folder. Raises IdRgbdoError where another run holds it.
    """
    try:
        import fcntl
    except ImportError:  # Windows
        return None
    descriptor = None
    try:
        descriptor = os.open(folder, os.O_RDONLY)
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        if descriptor is not None:
            os.close(descriptor)
        raise IdRgbdoError(f"out: another run is writing to '{folder}'; wait for it or pass another --out") from error
    except OSError:  # a network file system without locks
        if descriptor is not None:
            os.close(descriptor)
        return None
    return descriptor
