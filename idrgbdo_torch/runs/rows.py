"""The part of a checkpoint that never changes: full chunks of columns, appended to a file beside it as they come.

So what a checkpoint takes to write does not grow with the run. Where a chunk lies and its SHA-256 stand in the
checkpoint; whatever a killed process has appended besides is not referred to.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

PATTERN = "checkpoint_rows_*.bin"


class RowsFile:
    """Appends chunks to a file of its own, each once."""

    def __init__(self, folder: Path) -> None:
        """The file gets the first free number: the checkpoint before refers to another until it is replaced."""
        numbers = {path.name for path in folder.glob(PATTERN)}
        number = next(n for n in range(len(numbers) + 1) if self._name(n) not in numbers)
        self.path = folder / self._name(number)
        self._places: dict[int, tuple[np.ndarray[Any, Any], list[Any]]] = {}  # by identity; held, so that it is theirs
        self._end = 0

    @staticmethod
    def _name(number: int) -> str:
        return PATTERN.replace("*", str(number))

    def keep(self, chunk: np.ndarray[Any, Any]) -> list[Any]:
        """Where a chunk lies: its beginning, its length and its digest. Raises OSError where it does not fit."""
        if (known := self._places.get(id(chunk))) is not None:
            return known[1]
        data = np.ascontiguousarray(chunk).reshape(-1).view(np.uint8).data
        with self.path.open("r+b" if self._end else "wb") as file:
            file.seek(self._end)
            file.truncate()  # what a full disk has left of the last one
            file.write(data)
        place = [self._end, len(data), hashlib.sha256(data).hexdigest()]
        self._end += len(data)
        self._places[id(chunk)] = chunk, place
        return place

    def forget_others(self) -> None:
        """Remove the files of earlier processes, which the checkpoint does not refer to any more."""
        for path in self.path.parent.glob(PATTERN):
            if path != self.path:
                path.unlink(missing_ok=True)


def read_chunk(folder: Path, name: str, place: Any) -> bytes:
    """The bytes of a chunk. Raises ValueError or TypeError where they are not there, or are others."""
    begin, length, digest = place
    path = folder / Path(name).name
    if not path.is_file():  # nor a pipe, which would never end
        raise ValueError(f"'{path.name}' is missing")
    try:
        with path.open("rb") as file:
            file.seek(begin)
            data = file.read(max(0, min(length, path.stat().st_size)))
    except OSError as error:
        raise ValueError(f"'{path.name}': {error.strerror}") from error
    if hashlib.sha256(data).hexdigest() != digest:
        raise ValueError(f"'{path.name}' is damaged, its checksum is wrong")
    return data
