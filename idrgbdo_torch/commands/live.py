"""`idrgbdo live`: track a connected camera."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import arg

from ..config import Config
from ..text import configfile
from ..text.plain import plain
from .input import Settings
from .output import Output


@dataclass(frozen=True)
class LiveCommand:
    """Track a camera that is connected: RealSense or Azure Kinect."""

    sensor: Literal["realsense", "azure"] = "realsense"
    settings: Settings = field(default_factory=Config)
    config: Path | None = None  # TOML; its values are the defaults of the flags
    camera: Path | None = None  # TOML with fx, fy, cx, cy; a RealSense camera knows its own
    depth_scale: configfile.Positive | None = None  # depth values per metre; else the camera's
    record: Path | None = None  # .bag; RealSense only: everything the camera gives
    max_frames: configfile.Count = 1800  # a minute; Ctrl-C ends it before
    out: Path | None = None  # folder for the results; else runs/<sensor>/<time>
    viewer: bool = False  # watch it in Rerun, pip install "idrgbdo_torch[viewer]"
    save_rrd: Path | None = None  # the same into a file, for machines without a display
    output: Annotated[Output, arg(name="")] = field(default_factory=Output)


def live(command: LiveCommand) -> int:
    """Track a camera until it stops, max_frames are reached, or Ctrl-C."""
    from ..datasets.live import open_camera
    from ..report.viewer import open_viewer
    from .observers import Viewing
    from .track import Job, track

    sequence = open_camera(
        command.sensor,
        camera=command.camera,
        record=command.record,
        depth_scale=command.depth_scale,
        max_frames=command.max_frames,
    )
    print("reading", plain(sequence.recognised), flush=True)
    with open_viewer(sequence.name, command.viewer, command.save_rrd) as viewer:
        observers = [Viewing(viewer)] if viewer else []
        return track(Job(sequence, sequence.name, command.settings), command.out, observers)
