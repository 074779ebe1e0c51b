"""What an experiment is given: recordings, a way to measure on them, and how much of everything."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from statistics import fmean, stdev
from typing import TYPE_CHECKING

from .. import __version__
from ..config import Config
from ..datasets import open_sequence
from ..errors import IdRgbdoError
from ..runs.machine import machine_name
from ..text.latex import booktabs
from .drawing import FIGURES, save_figure
from .sweep import Progress, Workers, sweep
from .task import Clip, Measured, Task, content_digest, measure, measured

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .rendering import RenderTask

RESULTS = "results.jsonl"
Cell = str | int | float | None


@dataclass(frozen=True)
class Table:
    """Titles with units, and rows; None is an empty cell."""

    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


@dataclass(frozen=True)
class Report:
    """What came out of an experiment."""

    title: str
    tables: Mapping[str, Table]  # by the stem of the CSV file, the first is the main one
    findings: tuple[str, ...] = ()  # sentences, each decided by the numbers
    figure: Callable[[], Figure] | None = None


@contextmanager
def _silent(title: str) -> Iterator[Callable[[Progress], None]]:
    yield lambda progress: None


@dataclass(frozen=True)
class Lab:
    """Clips of the recordings, in Table 1's order, and the sizes of the experiments."""

    clips: tuple[Clip, ...]
    out: Path
    workers: Workers
    films: tuple[RenderTask, ...] = ()  # how the clips were rendered, one each; none for recordings
    rendered: bool = True
    quick: bool = False
    seeds: int = 10
    paper: Config | None = None  # the paper's method as printed
    alone: bool = False  # of this package's methods alone, beside what is published for the recordings
    progress: Callable[[str], AbstractContextManager[Callable[[Progress], None]]] = _silent

    @property
    def source(self) -> str:
        """Where the numbers are from, for titles."""
        return "rendered sequences" if self.rendered else "recorded sequences"

    def measure(self, tasks: Sequence[Task]) -> list[Measured]:
        """The numbers of every task, in their order; what is known from an earlier call is not run again."""
        ordered = sorted(tasks, key=lambda task: [clip.name for clip in self.clips].index(task.clip.name))
        keys = {task: task.key for task in ordered}
        by_key = {keys[task]: task for task in ordered}
        with self.progress("runs") as on_progress:
            results = sweep(measure, by_key, self.out / RESULTS, self.workers, on_progress)
        return [measured(results[keys[task]], task) for task in tasks]


def find_clips(folders: Sequence[Path], frames: int | None) -> tuple[Clip, ...]:
    """A clip of each recording, named after its folder as Table 1 would."""
    clips = []
    for folder in folders:
        length = len(open_sequence(folder))
        clips.append(Clip(short_name(folder), folder, content_digest(folder), length, 0, frames))
    return tuple(clips)


def short_name(folder: Path) -> str:
    """fr1_desk for rgbd_dataset_freiburg1_desk, and for the rendered fr1_desk_<digest>."""
    name = folder.resolve().name.removeprefix("rgbd_dataset_").replace("freiburg", "fr").removesuffix("_withloop")
    stem, _, digest = name.rpartition("_")
    return stem if len(digest) == 10 and all(c in "0123456789abcdef" for c in digest) else name


def choose(clips: Sequence[Clip], names: str) -> tuple[Clip, ...]:
    """The clips of these names (commas between), or all. Raises IdRgbdoError for an unknown one."""
    wanted = [name.strip() for name in names.split(",") if name.strip()]
    known = {clip.name: clip for clip in clips}
    for name in wanted:
        if name not in known:
            raise IdRgbdoError(f"sequences: no sequence '{name}' here; expected some of {', '.join(known)}")
    return tuple(clip for clip in clips if not wanted or clip.name in wanted)


def interval(values: Sequence[float]) -> tuple[float, float]:
    """Mean, and half of its 95 % confidence interval (Student's t); a single value has none."""
    if len(values) < 2:
        return fmean(values), math.nan
    from scipy.stats import t

    return fmean(values), float(t.ppf(0.975, len(values) - 1)) * stdev(values) / math.sqrt(len(values))


def write_report(report: Report, name: str, out: Path) -> list[Path]:
    """CSV files, LaTeX, the figure as PNG, SVG and PDF, and a Markdown page; what was written, the page first."""
    written, latex = list[Path](), list[str]()
    lines = [f"# {report.title}", ""]
    if report.figure is not None:
        drawn = report.figure()
        for suffix in FIGURES:
            written.append(out / f"{name}.{suffix}")
            save_figure(drawn, written[-1])
        lines += [f"![{report.title}]({name}.png)", ""]
    lines += [f"- {finding}" for finding in report.findings]
    for stem, table in report.tables.items():
        path = out / f"{stem}.csv"
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(table.columns)
            writer.writerows([_csv_cell(cell) for cell in row] for row in table.rows)
        written.append(path)
        lines += ["", f"[{path.name}]({path.name})", "", *markdown(table)]
        rows = [[shown(cell) for cell in row] for row in table.rows]
        latex.append(booktabs(table.columns, rows, f"{report.title} ({stem})", stem))
    written.append(out / f"{name}.tex")
    written[-1].write_text("\n".join(latex), encoding="utf-8")
    page = out / f"{name}.md"
    page.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return [page, *written]


def write_index(out: Path, names: Sequence[str], command: str) -> Path:
    """OUT/results.md: the pages of all experiments that are there, and what made the last of them."""
    pages = [out / f"{name}.md" for name in names if (out / f"{name}.md").exists()]
    date = datetime.now(UTC).strftime("%Y-%m-%d")
    head = f"# Results\n\nLast made by `{command}` on {date}, version {__version__}, {machine_name()}.\n"
    bodies = ["#" + page.read_text(encoding="utf-8") for page in pages]
    index = out / "results.md"
    index.write_text("\n".join([head, *bodies]), encoding="utf-8")
    return index


def markdown(table: Table) -> list[str]:
    """The table as lines of Markdown."""
    rows = [" | ".join(shown(cell) for cell in row) for row in table.rows]
    return ["| " + " | ".join(table.columns) + " |", "|---" * len(table.columns) + "|", *(f"| {row} |" for row in rows)]


def shown(cell: Cell) -> str:
    """A cell for people: four digits are enough."""
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return ""
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)


def _csv_cell(cell: Cell) -> Cell:
    return f"{cell:.6g}" if isinstance(cell, float) else cell
