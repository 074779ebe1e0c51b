"""`idrgbdo run`: track recordings."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from ..config import Config
from ..errors import IdRgbdoError
from ..text.configfile import Count
from ..text.plain import plain
from .input import Input, Settings, open_input
from .output import Output


@dataclass(frozen=True)
class Extras:
    """What fewer people need."""

    save_rrd: Path | None = None  # what the viewer would show, into a file
    odom_bag: Path | None = None  # also the poses as nav_msgs/Odometry: .bag for ROS 1, .mcap for ROS 2
    odom_axes: Literal["optical", "body"] = "optical"  # of these: z forward and y down, or x forward and z up
    jobs: Count | None = None  # of several recordings, so many side by side; else as many as there are cores
    cluster: str = ""  # address of a Dask scheduler instead, whose workers see the same files


@dataclass(frozen=True)
class RunCommand:
    """Track recordings and write trajectory, map and certainty into a folder each."""

    sequences: Positional[tuple[Path, ...]]  # folders, bags, or a pattern such as 'episodes/*'; see docs/data.md
    out: Path | None = None  # folder for the results; else runs/<sequence>/<time>, of several runs/batch
    config: Path | None = None  # TOML, or fast, accurate, paper; its values are the defaults of the flags
    map: Literal["none", "points", "mesh"] = "points"  # keyframe points; mesh: all depth fused too, in a second pass
    figures: bool = False  # also draw the chosen points on some frames, and the trajectory from above
    viewer: bool = False  # watch it in Rerun, pip install "idrgbdo_torch[viewer]"
    resume: bool = False  # go on with the interrupted run in --out, else in runs/<sequence>/latest
    input: Annotated[Input, arg(name="")] = field(default_factory=Input)
    extras: Annotated[Extras, arg(name="")] = field(default_factory=Extras)
    output: Annotated[Output, arg(name="")] = field(default_factory=Output)
    settings: Settings = field(default_factory=Config)


def run(command: RunCommand) -> int:
    """Track a recording, or several; the exit status is 130 where Ctrl-C ended it, 1 where nothing was tracked."""
    from .batch import expanded, run_many

    paths = expanded(command.sequences)
    if not paths:
        raise IdRgbdoError("sequences: expected the folder of a recording, or a bag, got none; name at least one")
    several = len(paths) > 1 or command.extras.cluster or paths != list(command.sequences)
    return run_many(command, paths) if several else _run_one(command, paths[0])


def _run_one(command: RunCommand, path: Path) -> int:
    """Track a recording, with all that can go along."""
    from ..export.bag import check_place
    from ..export.tracked import load_run, trusted
    from ..report.viewer import open_viewer
    from ..runs.folder import default_folder
    from ..runs.source import Reading
    from .export import write_odometry
    from .observers import Observer, Pictures, Viewing
    from .track import Job, track

    sequence, extras = open_input(path, command.input), command.extras
    print("reading", plain(sequence.recognised), flush=True)
    out = command.out
    if extras.odom_bag:
        check_place(extras.odom_bag, option="odom_bag")
    if extras.odom_bag and out is None:
        newest = (Path("runs") / sequence.name / "latest").resolve()
        out = newest if command.resume else default_folder(sequence.name, datetime.now())
    with open_viewer(sequence.name, command.viewer, extras.save_rrd) as viewer:
        observers: list[Observer] = [Viewing(viewer)] if viewer else []
        observers += [Pictures()] if command.figures else []
        job = Job(sequence, sequence.name, command.settings, command.map, Reading(path, asdict(command.input)))
        status = track(job, out, observers, command.resume)
    if extras.odom_bag and out is not None:
        tracked = load_run(out)
        chosen = trusted(tracked)
        write_odometry(tracked, chosen, chosen.frames, extras.odom_bag, extras.odom_axes)
        print(f"odometry of {len(chosen.frames)} frames in {extras.odom_bag}", flush=True)
    return status
