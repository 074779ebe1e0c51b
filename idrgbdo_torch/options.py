"""What the commands ask for: every flag with its default and what it means. The rest have theirs beside their code."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import FlagConversionOff, Positional, arg

from . import configfile
from .config import Config
from .synthetic.config import SynthConfig

Settings = Annotated[Config, arg(name=""), FlagConversionOff]


@dataclass(frozen=True)
class Input:
    """How the recording is read."""

    format: str | None = None  # tum, icl_nuim, 7scenes, redwood, replica, scannet, ros, folder; else it is recognised
    camera: Path | None = None  # TOML with fx, fy, cx, cy [k1 k2 p1 p2 k3 depth_scale]; else what the recording says
    associations: Path | None = None  # list `timestamp colour timestamp depth`; else images are paired by time
    association_limit: configfile.NonNegative = 0.02  # s, between the two images of a pair
    depth_scale: configfile.Positive | None = None  # depth values per metre; else the camera file's or the format's
    color_topic: str | None = None  # of a ROS recording; else the likeliest
    depth_topic: str | None = None  # the same; choose one that is registered to colour
    start: configfile.Index = 0  # frames left out at the beginning
    every: configfile.Count = 1  # take every n-th frame
    max_frames: configfile.Count | None = None  # stop after so many


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


@dataclass(frozen=True)
class CheckCommand:
    """Find out whether a recording is fit to be tracked, and what to do where it is not."""

    sequence: Positional[Path]  # as for `idrgbdo run`
    input: Annotated[Input, arg(name="")] = field(default_factory=Input)
    out: Path | None = None  # PNG; else runs/<sequence>/check.png


@dataclass(frozen=True)
class MeshCommand:
    """Fuse a recording's depth into a coloured mesh, along the poses of a run."""

    sequence: Positional[Path]  # as for `idrgbdo run`
    poses: Positional[Path]  # the folder of a run, or a trajectory, TUM text
    input: Annotated[Input, arg(name="")] = field(default_factory=Input)
    out: Path | None = None  # PLY; else mesh.ply beside the poses
    voxel: configfile.Positive = 0.01  # m
    depth_max: configfile.Positive = 3.0  # m, farther depth is left out
    blocks: configfile.Count = 40_000  # of 8^3 voxels, 6 kB each; where they run out the voxels become larger
    fuse_every: configfile.Count = 1  # fuse every n-th frame


@dataclass(frozen=True)
class VideoCommand:
    """Film a run or a recording: every frame with its tracked points, coloured by what each is worth."""

    source: Positional[Path]  # the folder of a run, which is tracked again; or a recording, as for `idrgbdo run`
    settings: Settings = field(default_factory=Config)
    input: Annotated[Input, arg(name="")] = field(default_factory=Input)
    config: Path | None = None  # TOML; its values are the defaults of the flags
    out: Path | None = None  # .mp4 or .gif; else video.mp4 in the run's folder, or in runs/<sequence>
    fps: configfile.Positive | None = None  # frames per second; else the recording's own
    width: configfile.Count | None = None  # px; else as large as the images, 480 for a gif


@dataclass(frozen=True)
class EvaluateCommand:
    """Compare a trajectory with a reference: ATE and RPE."""

    estimate: Positional[Path]  # TUM text, or the folder of a run
    groundtruth: Positional[Path]  # TUM text, or the folder of a recording
    association_limit: configfile.Positive = 0.02  # s, between an estimated and a reference pose


@dataclass(frozen=True)
class SynthCommand:
    """Render a sequence with exact poses into a folder in TUM's layout."""

    out: Positional[Path]  # a new folder
    scene: Annotated[SynthConfig, arg(name=""), FlagConversionOff] = field(default_factory=SynthConfig)


@dataclass(frozen=True)
class DemoCommand:
    """Render a short sequence on first use, track it, and show how well that went. Needs no file and no network."""

    settings: Settings = field(default_factory=Config)
    config: Path | None = None  # TOML; its values are the defaults of the flags
    out: Path | None = None  # folder for the results; else runs/demo/<time>
    viewer: bool = False  # watch it in Rerun, pip install "idrgbdo_torch[viewer]"
    save_rrd: Path | None = None  # the same into a file, for machines without a display
