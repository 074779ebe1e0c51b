"""`idrgbdo run`: track a recording."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from ..config import Config
from ..plain import plain
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


def run(command: RunCommand) -> int:
    """Track a recording; the exit status is 130 where Ctrl-C ended it."""
    from ..report.viewer import open_viewer
    from ..runs.source import Reading
    from .track import track

    sequence = open_input(command.sequence, command.input)
    print("reading", plain(sequence.recognised), flush=True)
    with open_viewer(sequence.name, command.viewer, command.save_rrd) as viewer:
        reading = Reading(command.sequence, asdict(command.input))
        return track(
            sequence, sequence.name, command.settings, command.out, command.figures, viewer, command.map,
            command.resume, reading,
        )  # fmt: skip
