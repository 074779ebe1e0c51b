"""The command idrgbdo: from the command line to the function that does it, imported when it is needed."""

from __future__ import annotations

import io
import os
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import subcommand

from .. import __version__
from ..config import Config
from ..errors import IdRgbdoError
from ..text import configfile
from ..text.plain import plain
from .check import CheckCommand, check
from .compare import CompareCommand, compare
from .demo import DemoCommand, demo
from .doctor import DoctorCommand, doctor
from .download import DownloadCommand, download
from .evaluate import EvaluateCommand, evaluate
from .experiment import ExperimentCommand, experiment
from .export import ExportCommand, export
from .live import LiveCommand, live
from .mesh import MeshCommand, mesh
from .run import RunCommand, run
from .synth import SynthCommand, synth
from .video import VideoCommand, video

DESCRIPTION = """RGB-D odometry from a handful of informative points: a pose per frame, a map, and how certain they are.

First look: `idrgbdo demo`. A recording: `idrgbdo run FOLDER`."""

Command = (
    RunCommand | LiveCommand | CheckCommand | MeshCommand | VideoCommand | EvaluateCommand | SynthCommand | DemoCommand
    | CompareCommand | DownloadCommand | DoctorCommand | ExperimentCommand | ExportCommand
)  # fmt: skip
ACTIONS: dict[type, Callable[..., int]] = {
    RunCommand: run, LiveCommand: live, CheckCommand: check, MeshCommand: mesh, VideoCommand: video,
    EvaluateCommand: evaluate, SynthCommand: synth, DemoCommand: demo, CompareCommand: compare,
    DownloadCommand: download, DoctorCommand: doctor, ExperimentCommand: experiment,
    ExportCommand: export,
}  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """The exit status: 0, 1 after a known error (one line on stderr), 130 after Ctrl-C. Wrong flags exit with 2.

    141 where nobody reads the output any more, as with `| head`.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # names of files need not be UTF-8
    try:
        command = parse(list(sys.argv[1:] if argv is None else argv))
        status = ACTIONS[type(command)](command)
        sys.stdout.flush()
        return status
    except IdRgbdoError as error:
        print("error:", plain(" ".join(str(error).split())), file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())  # or the interpreter complains at its end
        return 141


def parse(argv: list[str]) -> Command:
    """The command line as a command. Raises IdRgbdoError for wrong values, SystemExit(2) for wrong flags."""
    if argv in (["--version"], ["-V"]):
        print(f"idrgbdo {__version__}")
        raise SystemExit(0)
    settings = base_settings(argv)
    # tyro has one union of all commands, each with the defaults that --config gives
    commands = (
        Annotated[RunCommand, subcommand("run", default=RunCommand(tyro.MISSING, settings))]
        | Annotated[LiveCommand, subcommand("live", default=LiveCommand(settings=settings))]
        | Annotated[CheckCommand, subcommand("check")]
        | Annotated[MeshCommand, subcommand("mesh")]
        | Annotated[VideoCommand, subcommand("video", default=VideoCommand(tyro.MISSING, settings))]
        | Annotated[ExportCommand, subcommand("export")]
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


def base_settings(argv: list[str]) -> Config:
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
