"""What `idrgbdo experiment` asks for and does."""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from ..errors import IdRgbdoError
from ..text.configfile import Count, Index, NonNegative
from .output import Output, answer
from .tasks_bar import tasks_bar

if TYPE_CHECKING:
    from ..experiments.lab import Lab, Report
    from ..experiments.rendering import RenderTask
    from ..experiments.task import Clip

Name = Literal[
    "fig1",
    "fig3",
    "fig4",
    "fig5",
    "fig6",
    "fig7",
    "fig8",
    "table1",
    "ablation",
    "frontier",
    "coverage",
    "faults",
    "events",
    "all",
]


@dataclass(frozen=True)
class ExperimentCommand:
    """Rerun the paper's experiments: numbers as CSV, figures as the paper draws them. A second call goes on."""

    name: Positional[Name]
    data: Path | None = None  # folder of recordings in TUM's layout, see `idrgbdo download`
    tum: Path | None = None  # the same for table1: ours alone, beside the numbers published for these recordings
    rendered: bool = False  # instead: rendered relatives of the 18 sequences of Table 1, made on first use
    trajectories: Path | None = None  # folder of TUM trajectories to film along; else built-in hand-held paths
    later: NonNegative = 0.0  # s by which films begin later along recorded paths: other stretches than those for tuning
    look: Index = 0  # other textures and scenes of the films, and other built-in paths
    sequences: str = ""  # some of them, commas between; else all
    quick: bool = False  # fewer sequences, frames, seeds and steps
    frames: Count | None = None  # of each sequence
    seeds: Count | None = None  # runs of each setting, each begins a frame later
    jobs: Count | None = None  # processes side by side; else as many as there are cores
    cluster: str = ""  # address of a Dask scheduler instead, whose workers see the same files
    paper: Path | None = None  # TOML of the paper's method; else the preset
    cache: Path | None = None  # folder for rendered sequences; else the user's cache
    out: Path = Path("experiments")  # folder for the results
    output: Annotated[Output, arg(name="")] = field(default_factory=Output)


def experiment(command: ExperimentCommand) -> int:
    """Run the experiment, or all of them; write and show what came out."""
    from ..experiments import NAMES, run_experiment
    from ..experiments.lab import write_index, write_report

    everything = NAMES if command.rendered else tuple(name for name in NAMES if name != "faults")  # which are rendered
    names = everything if command.name == "all" else (command.name,)
    lab = _lab(command, all(name in ("fig7", "fig8") for name in names))
    lab.out.mkdir(parents=True, exist_ok=True)
    for name in names:
        begin = time.monotonic()
        report = run_experiment(name, lab)
        written = write_report(report, name, lab.out)
        index = write_index(lab.out, NAMES, _command_line(command))
        _show(report, [index, *written], time.monotonic() - begin)
        answer(**{name: {"findings": list(report.findings), "written": written}})
    return 0


def _lab(command: ExperimentCommand, only_cost: bool) -> Lab:
    from ..experiments import setup
    from ..experiments.lab import Lab
    from ..experiments.rendering import Take
    from ..experiments.sweep import Workers

    if command.tum and (command.data or command.rendered or command.name != "table1"):
        raise IdRgbdoError("tum: is for table1, without --data and --rendered; leave out either")
    workers, data = Workers(command.jobs or cores(), command.cluster), command.data or command.tum
    clips: tuple[Clip, ...] = ()
    films: tuple[RenderTask, ...] = ()
    if only_cost:
        pass  # these render what they time
    elif command.rendered and data is None:
        frames = command.frames or (setup.QUICK_FRAMES if command.quick else setup.FRAMES)
        cache = command.cache or setup.default_cache()
        take = Take(command.later, command.look)
        films = setup.planned_films(command.sequences, frames, command.quick, cache, command.trajectories, take=take)
        with tasks_bar("rendering") as on_progress:
            clips = setup.clips_of(films, workers, on_progress)
    elif data is not None and not command.rendered:
        most = command.frames or (setup.QUICK_FRAMES if command.quick else None)
        clips = setup.recorded_clips(data, command.sequences, most)
    else:
        raise IdRgbdoError("experiment: expected either --rendered or --data FOLDER; see `idrgbdo download tum`")
    paper = setup.paper_config(command.paper)
    return Lab(
        clips,
        command.out,
        workers,
        films=films,
        rendered=command.rendered,
        quick=command.quick,
        seeds=command.seeds or (setup.QUICK_SEEDS if command.quick else setup.SEEDS),
        paper=paper,
        alone=command.tum is not None,
        progress=tasks_bar,
    )


def _command_line(command: ExperimentCommand) -> str:
    """The command with the flags that shape its numbers."""
    words = ["idrgbdo experiment", command.name]
    for name in ("rendered", "quick"):
        words += [f"--{name}"] if getattr(command, name) else []
    for name in ("later", "look", "sequences", "frames", "seeds"):
        words += [f"--{name} {value}"] if (value := getattr(command, name)) else []
    words += [f"--{name} FOLDER" for name in ("data", "tum") if getattr(command, name)]
    return " ".join(words + (["--trajectories FOLDER"] if command.trajectories else []))


def cores() -> int:
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
