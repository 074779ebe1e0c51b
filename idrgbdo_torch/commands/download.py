"""What `idrgbdo download` asks for and does."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from ..errors import IdRgbdoError
from .output import Output, answer

if TYPE_CHECKING:
    from ..download import Progress


@dataclass(frozen=True)
class DownloadCommand:
    """Fetch the 18 TUM sequences of the paper's Table 1, or some. An interrupted call goes on where it was."""

    dataset: Positional[Literal["tum"]]
    names: Positional[tuple[str, ...]] = ()  # such as freiburg1_desk
    all: bool = False  # all 18, some 20 GB
    out: Path = Path("data")  # folder for the sequences
    url: str = ""  # where else the archives lie, in folders freiburg1 to freiburg3
    keep_archives: bool = False  # else they are removed once unpacked
    output: Annotated[Output, arg(name="")] = field(default_factory=Output)


def download(command: DownloadCommand) -> int:
    """Fetch and unpack what is not there yet."""
    from ..download import BASE_URL, TUM_SEQUENCES, download_tum
    from ..report.terminal import show_table

    names = TUM_SEQUENCES if command.all else command.names
    if not names:
        raise IdRgbdoError(f"names: expected sequences or --all, got none; known are {', '.join(TUM_SEQUENCES)}")
    with _progress_bar() as on_progress:
        folders = download_tum(
            names,
            command.out,
            url=command.url or BASE_URL,
            keep_archives=command.keep_archives,
            on_progress=on_progress,
        )
    show_table("sequences", [(folder.name, str(folder)) for folder in folders])
    answer(folders=list(folders))
    return 0


@contextmanager
def _progress_bar() -> Iterator[Callable[[Progress], None]]:
    """A bar over the bytes of the archive at hand; on a terminal only."""
    if not sys.stdout.isatty():
        yield lambda progress: None
        return
    from rich.progress import BarColumn, DownloadColumn, TextColumn, TimeRemainingColumn, TransferSpeedColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    with Bar(*columns, TimeRemainingColumn()) as bar:
        task = bar.add_task("")

        def show(progress: Progress) -> None:
            title = f"{progress.job}/{progress.jobs} {progress.name}"
            bar.update(task, description=title, completed=progress.done, total=progress.total)

        yield show
