"""`idrgbdo live`: track a connected camera."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import arg

from ..config import CameraSettings, Config
from ..text import configfile
from ..text.plain import plain
from .input import Settings
from .output import Output


@dataclass(frozen=True)
class LiveCommand:
    """Track a camera that is connected: RealSense, OAK or Azure Kinect."""

    camera: Literal["realsense", "oak", "open3d", "azure"] = "realsense"  # open3d: a RealSense by Open3D's library
    settings: Settings = field(default_factory=Config)
    config: Path | None = None  # TOML; its values are the defaults of the flags
    intrinsics: Path | None = None  # TOML with fx, fy, cx, cy; a RealSense camera knows its own
    device: Annotated[CameraSettings, arg(name="")] = field(default_factory=CameraSettings)
    depth_scale: configfile.Positive | None = None  # depth values per metre; else the camera's
    record: Path | None = None  # RealSense only, .db3 (.bag with open3d): everything the camera gives
    max_frames: configfile.Count = 1800  # a minute; Ctrl-C ends it before
    out: Path | None = None  # folder for the results; else runs/<camera>/<time>
    viewer: bool = False  # watch it in Rerun, pip install "idrgbdo_torch[viewer]"
    save_rrd: Path | None = None  # the same into a file, for machines without a display
    output: Annotated[Output, arg(name="")] = field(default_factory=Output)


def live(command: LiveCommand) -> int:
    """Track a camera until it stops, max_frames are reached, or Ctrl-C."""
    from ..datasets.live import open_camera
    from ..report.viewer import open_viewer
    from .observers import Viewing
    from .track import Job, make_odometry, track

    make_odometry(command.settings)  # compiles the kernels before the camera runs, not while it waits
    sequence = open_camera(
        command.camera,
        camera=command.intrinsics,
        record=command.record,
        depth_scale=command.depth_scale,
        max_frames=command.max_frames,
        settings=command.device,
    )
    print("reading", plain(sequence.recognised), flush=True)
    with open_viewer(sequence.name, command.viewer, command.save_rrd) as viewer:
        observers = [Viewing(viewer)] if viewer else []
        status = track(Job(sequence, sequence.name, command.settings), command.out, observers)
    if sequence.ended:
        print("warning:", plain(sequence.ended), file=sys.stderr)
    if sequence.dropped is not None:
        print(f"{sequence.dropped} of {sequence.dropped + len(sequence.timestamps)} images were dropped")
    return status
