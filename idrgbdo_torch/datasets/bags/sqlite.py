"""Files of SQLite (.db3), the first storage of ROS 2: by SQLite itself, and page by page where that fails."""

from __future__ import annotations

import re
import sqlite3
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import ExitStack
from pathlib import Path
from urllib.parse import quote

import numpy as np

from ..bag_files import damage
from .pages import Pages
from .storage import LAST, Storage
from .unpack import MOST_UNPACKED

STRANGE = re.compile(r"\b(virtual|generated|as)\b", re.IGNORECASE)  # in the definition of a table that computes
TABLES = ("topics", "messages")
MOST_TOPICS = 100_000
LEAST_ROW = 8  # bytes that a row takes in the file
STEPS = 100_000  # of SQLite's machine, after which it is asked whether it goes on
STEPS_A_BYTE, SLACK = 2, 10_000_000  # steps that reading all rows takes at most; damaged pages can lead in circles


class SqliteStorage(Storage):
    """A database with the tables `topics` and `messages`."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path
        self._pages: Pages | None = None
        self._database: sqlite3.Connection | None = None
        with ExitStack() as stack:
            stack.callback(self.close)
            try:
                self._open()
            except damage() as error:  # sqlite3.Error, or that its message is no text
                self._salvage(str(error))
            stack.pop_all()

    def _open(self) -> None:
        """Ask SQLite for all rows but their data. Raises sqlite3.Error where that is damaged."""
        place = f"file:{quote(str(self._path.absolute()))}?mode=ro&immutable=1"
        self._database = database = sqlite3.connect(place, uri=True, check_same_thread=False)
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_UNPACKED)
        left = (STEPS_A_BYTE * self._path.stat().st_size + SLACK) // STEPS

        def tired() -> bool:
            nonlocal left
            left -= 1
            return left < 0

        database.set_progress_handler(tired, STEPS)
        database.execute("PRAGMA trusted_schema = OFF")
        query = "SELECT name, sql FROM sqlite_master WHERE type = 'table'"
        made = dict(database.execute(query).fetchmany(MOST_TOPICS))
        if not all(isinstance(made.get(name), str) and not STRANGE.search(made[name]) for name in TABLES):
            raise sqlite3.DatabaseError("it has no plain tables topics and messages")
        topics = database.execute("SELECT id, name, type FROM topics").fetchmany(MOST_TOPICS)
        most = self._path.stat().st_size // LEAST_ROW
        rows = database.execute(
            "SELECT id, topic_id, timestamp FROM messages NOT INDEXED WHERE typeof(topic_id) = 'integer' AND "
            "typeof(timestamp) = 'integer'"
        ).fetchmany(most + 1)
        if len(rows) > most:
            raise sqlite3.DatabaseError("it has more rows than its bytes can hold")
        (count,) = database.execute("SELECT count(*) FROM messages").fetchone()
        database.set_progress_handler(None, 0)
        if count != len(rows):  # as where a page has become another one, or rows are none
            raise sqlite3.DatabaseError(f"{len(rows)} of its {count} rows are messages")
        numbers = np.array([number for number, *_ in rows], np.int64)
        if (numbers[1:] <= numbers[:-1]).any():  # as where a page is there twice, once instead of another
            raise sqlite3.DatabaseError("the numbers of its rows are in disorder")
        numbered = Counter(number for number, *_ in topics if isinstance(number, int))
        twice = {number for number, count in numbered.items() if count > 1}  # as where a number is another
        once = set(numbered) - twice
        self.topics = {number: (str(name), str(kind)) for number, name, kind in topics if number in once}
        self._take(rows)
        missing = self.nameless()
        if missing:
            again = {key: about for key, about in self._found().topics.items() if key in missing - twice}
            self.topics |= again
            self.note_damage(0, f"{len(missing)} rows of topics, {len(again)} of which were found again")
        strange = sum(topic not in self.topics for _, topic, _ in rows)
        if strange:
            self.note_damage(0, f"{strange} rows of messages of no topic")

    def _take(self, rows: list[tuple[int, int, int]]) -> None:
        found = np.array(rows, np.int64).reshape(-1, 3)  # number, topic, ns
        self._rows = found[np.argsort(found[:, 2], kind="stable")]

    def _salvage(self, reason: str) -> None:
        """Find the rows without SQLite; topics have empty names where none is left. Raises ValueError without rows."""
        if self._database is not None:
            self._database.close()
            self._database = None
        pages = self._found()
        if not pages.rows:
            raise ValueError(f"{reason}, and no message is left in it")
        self.topics = pages.topics or {row.topic: ("", "") for row in pages.rows.values()}
        self._take([(number, row.topic, row.time) for number, row in pages.rows.items()])
        numbers = self._rows[:, 0]
        gone = int(np.ptp(numbers)) + 1 - len(numbers) if len(numbers) else 0
        self.note_damage(0, f"{reason}; {len(numbers)} rows are left, {max(gone, 0)} between them are gone")

    def nameless(self) -> set[int]:
        """See Storage."""
        return set(np.unique(self._rows[:, 1]).tolist()) - set(self.topics)

    def _found(self) -> Pages:
        if self._pages is None:
            self._pages = Pages(self._path)
        return self._pages

    def messages(
        self, channels: Collection[int], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[int, bytes]]:
        """See Storage: in the order of their times."""
        first, last = -LAST if start is None else start, LAST - 1 if stop is None else stop - 1
        begin, end = np.searchsorted(self._rows[:, 2], [first, last + 1])
        for place in (begin + np.flatnonzero(np.isin(self._rows[begin:end, 1], list(channels)))).tolist():
            number, _, time = self._rows[place].tolist()
            data = self._data(number)
            if data is not None:
                yield time, data

    def _data(self, number: int) -> bytes | None:
        """The message in a row; None where it is damaged."""
        reason = "a row whose data cannot be read"
        if self._database is not None:
            try:
                found = self._database.execute("SELECT data FROM messages WHERE id = ?", (number,)).fetchone()
                if found and isinstance(found[0], bytes):
                    return found[0]
            except damage() as error:  # sqlite3.Error, or that its message is no text
                reason = f"{reason} ({error})"
        data = self._found().data(number)
        if data is None:
            self.note_damage(number, reason)
        return data

    def close(self) -> None:
        """See Storage."""
        if self._database is not None:
            self._database.close()
        if self._pages is not None:
            self._pages.close()
        self._database = self._pages = None
