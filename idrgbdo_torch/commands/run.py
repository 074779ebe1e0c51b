"""`idrgbdo run`: track a recording."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from ..config import Config
from ..text.plain import plain
from .input import Input, Settings, open_input


@dataclass(frozen=True)
class RunCommand:
    """Track a recording and write trajectory, map and certainty into a folder."""

    sequence: Positional[Path]  # folder or bag; see docs/data.md for what is recognised
    settings: Settings = field(default_factory=Config)
    input: Annotated[Input, arg(name="")] = field(default_factory=Input)
    config: Path | None = None  # TOML; its values are the defaults of the flags
    out: Path | None = None  # folder for the results; else runs/<sequence>/<time>
    figures: bool = False  # also draw the chosen points on some frames, and the trajectory from above
    map: Literal["none", "points", "mesh"] = "points"  # keyframe points; mesh: all depth fused too, in a second pass
    resume: bool = False  # go on with the interrupted run in --out, else in runs/<sequence>/latest
    viewer: bool = False  # watch it in Rerun, pip install "idrgbdo_torch[viewer]"
    save_rrd: Path | None = None  # the same into a file, for machines without a display
    odom_bag: Path | None = None  # also the poses as nav_msgs/Odometry: .bag for ROS 1, .mcap for ROS 2
    odom_axes: Literal["optical", "body"] = "optical"  # of these: z forward and y down, or x forward and z up


def run(command: RunCommand) -> int:
    """Track a recording; the exit status is 130 where Ctrl-C ended it."""
    from ..export.tracked import load_run, trusted
    from ..report.viewer import open_viewer
    from ..runs.folder import default_folder
    from ..runs.source import Reading
    from .export import write_odometry
    from .observers import Observer, Pictures, Viewing
    from .track import track

    sequence = open_input(command.sequence, command.input)
    print("reading", plain(sequence.recognised), flush=True)
    out = command.out
    if command.odom_bag and out is None:
        newest = (Path("runs") / sequence.name / "latest").resolve()
        out = newest if command.resume else default_folder(sequence.name, datetime.now())
    with open_viewer(sequence.name, command.viewer, command.save_rrd) as viewer:
        observers: list[Observer] = [Viewing(viewer)] if viewer else []
        observers += [Pictures()] if command.figures else []
        reading = Reading(command.sequence, asdict(command.input))
        status = track(
            sequence, sequence.name, command.settings, out, observers, command.map, command.resume, reading,
        )  # fmt: skip
    if command.odom_bag and out is not None:
        tracked = load_run(out)
        chosen = trusted(tracked)
        write_odometry(tracked, chosen, chosen.frames, command.odom_bag, command.odom_axes)
        print(f"odometry of {len(chosen.frames)} frames in {command.odom_bag}", flush=True)
    return status
