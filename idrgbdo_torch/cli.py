"""The command idrgbdo: what can be asked for. What is then done stands in commands.py, imported when it is needed."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro
from tyro.conf import FlagConversionOff, Positional, arg, subcommand

from . import __version__, configfile
from .check_command import check
from .compare_command import CompareCommand, compare
from .config import Config
from .doctor_command import DoctorCommand, doctor
from .download_command import DownloadCommand, download
from .errors import IdRgbdoError
from .experiment_command import ExperimentCommand, experiment
from .live_command import live
from .synthetic.config import SynthConfig
from .video_command import video

DESCRIPTION = """RGB-D odometry from a handful of informative points: a pose per frame, a map, and how certain they are.

First look: `idrgbdo demo`. A recording: `idrgbdo run FOLDER`."""

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


Command = (
    RunCommand
    | LiveCommand
    | CheckCommand
    | MeshCommand
    | VideoCommand
    | EvaluateCommand
    | SynthCommand
    | DemoCommand
    | CompareCommand
    | DownloadCommand
    | DoctorCommand
    | ExperimentCommand
)


def main(argv: Sequence[str] | None = None) -> int:
    """The exit status: 0, 1 after a known error (one line on stderr), 130 after Ctrl-C. Wrong flags exit with 2."""
    try:
        command = parse(list(sys.argv[1:] if argv is None else argv))
        if isinstance(command, CompareCommand):
            return compare(command)
        if isinstance(command, DownloadCommand):
            return download(command)
        if isinstance(command, DoctorCommand):
            return doctor(command)
        if isinstance(command, ExperimentCommand):
            return experiment(command)
        if isinstance(command, CheckCommand):
            return check(command)
        if isinstance(command, LiveCommand):
            return live(command)
        if isinstance(command, VideoCommand):
            return video(command)
        from . import commands

        if isinstance(command, RunCommand):
            return commands.run(command)
        if isinstance(command, EvaluateCommand):
            return commands.evaluate(command)
        if isinstance(command, MeshCommand):
            return commands.mesh(command)
        if isinstance(command, SynthCommand):
            return commands.synth(command)
        return commands.demo(command)
    except IdRgbdoError as error:
        print("error:", " ".join(str(error).split()), file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130


def parse(argv: list[str]) -> Command:
    """The command line as a command. Raises IdRgbdoError for wrong values, SystemExit(2) for wrong flags."""
    if argv in (["--version"], ["-V"]):
        print(f"idrgbdo {__version__}")
        raise SystemExit(0)
    settings = _base_settings(argv)
    # tyro has one union of all commands, each with the defaults that --config gives
    commands = (
        Annotated[RunCommand, subcommand("run", default=RunCommand(tyro.MISSING, settings))]
        | Annotated[LiveCommand, subcommand("live", default=LiveCommand(settings=settings))]
        | Annotated[CheckCommand, subcommand("check")]
        | Annotated[MeshCommand, subcommand("mesh")]
        | Annotated[VideoCommand, subcommand("video", default=VideoCommand(tyro.MISSING, settings))]
        | Annotated[EvaluateCommand, subcommand("evaluate")]
        | Annotated[SynthCommand, subcommand("synth")]
        | Annotated[DemoCommand, subcommand("demo", default=DemoCommand(settings))]
        | Annotated[CompareCommand, subcommand("compare")]
        | Annotated[DownloadCommand, subcommand("download")]
        | Annotated[DoctorCommand, subcommand("doctor")]
        | Annotated[ExperimentCommand, subcommand("experiment")]
    )
    arguments = [re.sub(r"^(--[\w.-]+=)?(true|false)$", _capitalised, argument) for argument in argv] or ["--help"]
    command: Command = tyro.cli(commands, prog="idrgbdo", description=DESCRIPTION, args=arguments)
    configfile.check(command)
    return command


def _base_settings(argv: list[str]) -> Config:
    """The defaults with the file after --config laid over them."""
    for position, argument in enumerate(argv):
        if argument.startswith("--config="):
            return configfile.load(Path(argument.removeprefix("--config=")), Config())
        if argument == "--config" and position + 1 < len(argv):
            return configfile.load(Path(argv[position + 1]), Config())
    return Config()


def _capitalised(match: re.Match[str]) -> str:
    """tyro writes booleans as Python does; people and TOML write them small."""
    return (match[1] or "") + match[2].capitalize()
