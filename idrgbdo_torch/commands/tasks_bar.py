"""A bar over the tasks of a sweep."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..experiments.sweep import Progress

SAY_EVERY_S = 60.0  # where there is no terminal for a bar


@contextmanager
def tasks_bar(title: str) -> Iterator[Callable[[Progress], None]]:
    """A bar over the tasks with the time that remains; without a terminal a line a minute on stderr."""
    if not sys.stdout.isatty():
        said = time.monotonic()

        def say(progress: Progress) -> None:
            nonlocal said
            if time.monotonic() - said > SAY_EVERY_S:
                said = time.monotonic()
                sys.stderr.write(f"{title}: {_words(progress)}\n")
                sys.stderr.flush()

        yield say
        return
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
    from rich.progress import Progress as Bar

    with Bar(TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), transient=True) as bar:
        task = bar.add_task(title)
        yield lambda progress: bar.update(
            task, description=f"{title} {_words(progress)}", completed=progress.done, total=progress.total
        )


def _words(progress: Progress) -> str:
    failed = f", {progress.failed} failed" if progress.failed else ""
    left = "" if progress.remaining_s is None else f", about {progress.remaining_s / 60:.0f} min left"
    return f"{progress.done} of {progress.total} tasks{failed}{left}"
