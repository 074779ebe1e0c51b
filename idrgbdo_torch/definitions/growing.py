"""Lists of equal arrays or numbers that may get millions of entries: in chunks, of which full ones never change."""

from __future__ import annotations

from collections.abc import Iterator
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

CHUNK_BYTES = 1 << 17
FIRST_ROWS = 16


class Column:
    """Entries of one type and shape, in the order in which they came.

    An entry costs its bytes, where a list of small arrays takes some hundred more for each. What has been appended can
    be replaced; the full chunks are read-only, so whoever knows one knows it for good: a replacement makes another.
    """

    def __init__(self, dtype: str, shape: tuple[int, ...] = ()) -> None:
        self.dtype = dtype
        self.shape = shape
        self.rows = max(FIRST_ROWS, CHUNK_BYTES // (np.dtype(dtype).itemsize * max(prod(shape), 1)))  # of a chunk
        self.full: list[Array] = []
        self.last: Array = np.zeros((FIRST_ROWS, *shape), dtype)
        self.count = 0  # entries of the last chunk

    def __len__(self) -> int:
        return len(self.full) * self.rows + self.count

    def append(self, value: Any) -> None:
        """One more."""
        if self.count == len(self.last):
            self._grow()
        self.last[self.count] = value
        self.count += 1

    def extend(self, values: Array) -> None:
        """Some more (N, *shape)."""
        while len(values):
            if self.count == len(self.last):
                self._grow()
            some = values[: len(self.last) - self.count]
            self.last[self.count : self.count + len(some)] = some
            self.count += len(some)
            values = values[len(some) :]

    def _grow(self) -> None:
        if self.count == self.rows:
            self.last.flags.writeable = False
            self.full.append(self.last)
            self.last, self.count = np.zeros((FIRST_ROWS, *self.shape), self.dtype), 0
        else:
            larger = np.zeros((min(2 * len(self.last), self.rows), *self.shape), self.dtype)
            larger[: self.count] = self.last
            self.last = larger

    def __getitem__(self, number: int) -> Any:
        """An entry of its own: a number, or a new array."""
        chunk, row = self._place(number)
        entry = chunk[row]
        return entry.copy() if self.shape else entry.item()

    def __setitem__(self, number: int, value: Any) -> None:
        chunk, row = self._place(number)
        if chunk is not self.last:
            chunk = chunk.copy()
            chunk[row] = value
            chunk.flags.writeable = False
            self.full[self._number(number) // self.rows] = chunk
        else:
            chunk[row] = value

    def _number(self, number: int) -> int:
        inside = number + len(self) if number < 0 else number
        if not 0 <= inside < len(self):
            raise IndexError(f"entry {number} of {len(self)}")
        return inside

    def _place(self, number: int) -> tuple[Array, int]:
        chunk, row = divmod(self._number(number), self.rows)
        return (self.full[chunk] if chunk < len(self.full) else self.last), row

    def __iter__(self) -> Iterator[Any]:
        for chunk in (*self.full, self.last[: self.count]):
            yield from (chunk.copy() if self.shape else chunk.tolist())

    def array(self, begin: int = 0, end: int | None = None) -> Array:
        """Entries as one array (N, *shape) of its own."""
        begin, end, _ = slice(begin, end).indices(len(self))
        first, after = begin // self.rows, -(-end // self.rows)
        chunks = [*self.full, self.last[: self.count]][first:after]
        start = first * self.rows
        together = np.concatenate(chunks) if chunks else np.zeros((0, *self.shape), self.dtype)
        return together[begin - start : end - start].copy() if len(together) != end - begin else together

    def copied(self) -> Column:
        """Another that begins with the same entries; the full chunks are shared."""
        out = Column(self.dtype, self.shape)
        out.full, out.last, out.count = list(self.full), self.last.copy(), self.count
        return out
