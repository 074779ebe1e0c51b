"""The command idrgbdo: from the command line to the function that does it, imported when it is needed."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import subcommand

from . import __version__, configfile
from .check_command import check
from .compare_command import CompareCommand, compare
from .config import Config
from .doctor_command import DoctorCommand, doctor
from .download_command import DownloadCommand, download
from .errors import IdRgbdoError
from .experiment_command import ExperimentCommand, experiment
from .live_command import live
from .options import (
    CheckCommand,
    DemoCommand,
    EvaluateCommand,
    LiveCommand,
    MeshCommand,
    RunCommand,
    SynthCommand,
    VideoCommand,
)
from .video_command import video

DESCRIPTION = """RGB-D odometry from a handful of informative points: a pose per frame, a map, and how certain they are.

First look: `idrgbdo demo`. A recording: `idrgbdo run FOLDER`."""

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
