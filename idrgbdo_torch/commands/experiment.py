"""What `idrgbdo experiment` asks for and does."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from ..errors import IdRgbdoError
from ..text.configfile import Count

if TYPE_CHECKING:
    from ..experiments.lab import Lab, Report
    from ..experiments.sweep import Progress
    from ..experiments.task import Clip

SAY_EVERY_S = 60.0  # where there is no terminal for a bar
Name = Literal["fig1", "fig3", "fig4", "fig5", "fig6", "fig7", "fig8", "table1", "ablation", "all"]


@dataclass(frozen=True)
class ExperimentCommand:
    """Rerun the paper's experiments: numbers as CSV, figures as the paper draws them. A second call goes on."""

    name: Positional[Name]
    data: Path | None = None  # folder of recordings in TUM's layout, see `idrgbdo download`
    rendered: bool = False  # instead: rendered relatives of the 18 sequences of Table 1, made on first use
    trajectories: Path | None = None  # folder of TUM trajectories to film along; else built-in hand-held paths
    sequences: str = ""  # some of them, commas between; else all
    quick: bool = False  # fewer sequences, frames, seeds and steps
    frames: Count | None = None  # of each sequence
    seeds: Count | None = None  # runs of each setting, each begins a frame later
    jobs: Count | None = None  # processes side by side; else as many as there are cores
    cluster: str = ""  # address of a Dask scheduler instead, whose workers see the same files
    paper: Path | None = None  # TOML of the paper's method; else configs/paper.toml
    cache: Path | None = None  # folder for rendered sequences; else the user's cache
    out: Path = Path("experiments")  # folder for the results


def experiment(command: ExperimentCommand) -> int:
    """Run the experiment, or all of them; write and show what came out."""
    from ..experiments import NAMES, run_experiment
    from ..experiments.lab import write_index, write_report

    names = NAMES if command.name == "all" else (command.name,)
    lab = _lab(command, all(name in ("fig7", "fig8") for name in names))
    lab.out.mkdir(parents=True, exist_ok=True)
    for name in names:
        begin = time.monotonic()
        report = run_experiment(name, lab)
        written = write_report(report, name, lab.out)
        index = write_index(lab.out, NAMES, _command_line(command))
        _show(report, [index, *written], time.monotonic() - begin)
    return 0


def _lab(command: ExperimentCommand, only_cost: bool) -> Lab:
    from ..experiments import setup
    from ..experiments.lab import Lab
    from ..experiments.sweep import Workers

    workers = Workers(command.jobs or _cores(), command.cluster)
    clips: tuple[Clip, ...] = ()
    if only_cost:
        pass  # these render what they time
    elif command.rendered and command.data is None:
        frames = command.frames or (setup.QUICK_FRAMES if command.quick else setup.FRAMES)
        cache = command.cache or setup.default_cache()
        with _progress("rendering") as on_progress:
            clips = setup.rendered_clips(
                command.sequences, frames, command.quick, cache, command.trajectories, workers, on_progress
            )
    elif command.data is not None and not command.rendered:
        most = command.frames or (setup.QUICK_FRAMES if command.quick else None)
        clips = setup.recorded_clips(command.data, command.sequences, most)
    else:
        raise IdRgbdoError("experiment: expected either --rendered or --data FOLDER; see `idrgbdo download tum`")
    paper = setup.paper_config(command.paper)
    if paper is None:
        sys.stderr.write(
            "warning: no configs/paper.toml here; without --paper FILE the rows of its settings are left out\n"
        )
    return Lab(
        clips,
        command.out,
        workers,
        rendered=command.rendered,
        quick=command.quick,
        seeds=command.seeds or (setup.QUICK_SEEDS if command.quick else setup.SEEDS),
        paper=paper,
        progress=_progress,
    )


def _command_line(command: ExperimentCommand) -> str:
    """The command with the flags that shape its numbers."""
    words = ["idrgbdo experiment", command.name]
    for name in ("rendered", "quick"):
        words += [f"--{name}"] if getattr(command, name) else []
    for name in ("sequences", "frames", "seeds"):
        words += [f"--{name} {value}"] if (value := getattr(command, name)) else []
    words += ["--data FOLDER"] if command.data else []
    return " ".join(words + (["--trajectories FOLDER"] if command.trajectories else []))


def _cores() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _show(report: Report, written: list[Path], seconds: float) -> None:
    """The findings and the main table; all of it is in the files."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from ..experiments.lab import markdown, shown

    table = next(iter(report.tables.values()))
    if sys.stdout.isatty():
        grid = Table(title=report.title, title_justify="left")
        for number, title in enumerate(table.columns):
            grid.add_column(title, justify="left" if number == 0 else "right", overflow="fold")
        for row in table.rows:
            grid.add_row(*(escape(shown(cell)) for cell in row))
        Console().print(grid)
    else:
        sys.stdout.write("\n".join([report.title, "", *markdown(table), ""]) + "\n")
    for finding in report.findings:
        sys.stdout.write(f"- {finding}\n")
    sys.stdout.write(f"{seconds:.0f} s; written: {', '.join(str(path) for path in written)}\n\n")
    sys.stdout.flush()


@contextmanager
def _progress(title: str) -> Iterator[Callable[[Progress], None]]:
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
