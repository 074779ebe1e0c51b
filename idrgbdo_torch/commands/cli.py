"""The command idrgbdo: from the command line to the function that does it, imported when it is needed."""

from __future__ import annotations

import difflib
import io
import os
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import arg, subcommand

from .. import __version__
from ..config import Config, settings_file
from ..errors import IdRgbdoError
from ..text import configfile
from ..text.plain import plain
from .bench import BenchCommand, bench
from .check import CheckCommand, check
from .compare import CompareCommand, compare
from .completion import CompletionCommand, completion
from .demo import DemoCommand, demo
from .doctor import DoctorCommand, doctor
from .download import DownloadCommand, download
from .evaluate import EvaluateCommand, evaluate
from .experiment import ExperimentCommand, experiment
from .export import ExportCommand, export
from .live import LiveCommand, live
from .mesh import MeshCommand, mesh
from .node import NodeCommand, node
from .output import Output, as_json, collected, silence
from .run import RunCommand, run
from .synth import SynthCommand, synth
from .video import VideoCommand, video

DESCRIPTION = """RGB-D odometry from a handful of informative points: a pose per frame, a map, and how certain they are.

First look: `idrgbdo demo`. A recording: `idrgbdo run FOLDER`. Every command takes --quiet and --json."""

Command = (
    RunCommand | LiveCommand | CheckCommand | MeshCommand | VideoCommand | EvaluateCommand | SynthCommand | DemoCommand
    | CompareCommand | DownloadCommand | DoctorCommand | ExperimentCommand | ExportCommand | NodeCommand
    | CompletionCommand | BenchCommand
)  # fmt: skip
ACTIONS: dict[type, Callable[..., int]] = {
    RunCommand: run, LiveCommand: live, CheckCommand: check, MeshCommand: mesh, VideoCommand: video,
    EvaluateCommand: evaluate, SynthCommand: synth, DemoCommand: demo, CompareCommand: compare,
    DownloadCommand: download, DoctorCommand: doctor, ExperimentCommand: experiment,
    ExportCommand: export, NodeCommand: node, CompletionCommand: completion,
    BenchCommand: bench,
}  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """The exit status: 0, 1 after a known error (one line on stderr), 130 after Ctrl-C. Wrong flags exit with 2.

    141 where nobody reads the output any more, as with `| head`.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # names of files need not be UTF-8
    words = list(sys.argv[1:] if argv is None else argv)
    try:
        with collected() as facts:
            status = _done(words, facts)
        if "--json" in words:
            print(as_json({"status": status, **facts}))
        sys.stdout.flush()
        return status
    except BrokenPipeError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())  # or the interpreter complains at its end
        return 141


def _done(words: list[str], facts: dict[str, Any]) -> int:
    """Do what the words say; the exit status."""
    try:
        command = parse(words)
        output = getattr(command, "output", Output())
        with silence(output.quiet or output.json):
            return ACTIONS[type(command)](command)
    except IdRgbdoError as error:
        facts["error"] = " ".join(str(error).split())
        print("error:", plain(facts["error"]), file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        facts["error"] = "interrupted"
        print("interrupted", file=sys.stderr)
        return 130


def parse(argv: list[str]) -> Command:
    """The command line as a command. Raises IdRgbdoError for wrong values, SystemExit(2) for wrong flags."""
    if argv in (["--version"], ["-V"]):
        print(f"idrgbdo {__version__}")
        raise SystemExit(0)
    settings = base_settings(argv)
    # tyro has one union of all commands, each with the defaults that --config gives
    commands = (
        Annotated[RunCommand, subcommand("run", default=RunCommand(tyro.MISSING, settings=settings))]
        | Annotated[LiveCommand, subcommand("live", default=LiveCommand(settings=settings))]
        | Annotated[CheckCommand, subcommand("check")]
        | Annotated[MeshCommand, subcommand("mesh")]
        | Annotated[VideoCommand, subcommand("video", default=VideoCommand(tyro.MISSING, settings=settings))]
        | Annotated[ExportCommand, subcommand("export")]
        | Annotated[EvaluateCommand, subcommand("evaluate")]
        | Annotated[SynthCommand, subcommand("synth")]
        | Annotated[DemoCommand, subcommand("demo", default=DemoCommand(settings=settings))]
        | Annotated[CompareCommand, subcommand("compare")]
        | Annotated[DownloadCommand, subcommand("download")]
        | Annotated[DoctorCommand, subcommand("doctor")]
        | Annotated[BenchCommand, subcommand("bench", default=BenchCommand(settings=settings))]
        | Annotated[ExperimentCommand, subcommand("experiment")]
        | Annotated[NodeCommand, subcommand("node", default=NodeCommand(settings=settings))]
        | Annotated[CompletionCommand, subcommand("completion")]
    )
    _check_name(argv)
    arguments = [re.sub(r"^(--[\w.-]+=)?(true|false)$", _capitalised, argument) for argument in argv] or ["--help"]
    # a help for the union itself, or tyro looks for one in the source of the typing module, for 35 ms
    one: Any = Annotated[commands, arg(help="each has its own --help")]
    command: Command = tyro.cli(one, prog="idrgbdo", description=DESCRIPTION, args=arguments)
    configfile.check(command)
    return command


def _check_name(argv: list[str]) -> None:
    """End with status 2 and the nearest name where the first word is no command."""
    names = [command.__name__.removesuffix("Command").lower() for command in ACTIONS]
    if not argv or argv[0].startswith("-") or argv[0] in names:
        return
    near = difflib.get_close_matches(argv[0], names, n=1, cutoff=0.5)
    hint = f"did you mean '{near[0]}'?" if near else f"the commands are {', '.join(names)}"
    if Path(argv[0]).exists():
        hint = f"to track it: idrgbdo run {argv[0]}"
    print(f"error: no command '{plain(argv[0])}'; {plain(hint)}", file=sys.stderr)
    raise SystemExit(2)


def base_settings(argv: list[str]) -> Config:
    """The defaults with the file, or the preset, after --config laid over them."""
    for position, argument in enumerate(argv):
        if argument.startswith("--config="):
            return configfile.load(settings_file(Path(argument.removeprefix("--config="))), Config())
        if argument == "--config" and position + 1 < len(argv):
            return configfile.load(settings_file(Path(argv[position + 1])), Config())
    return Config()


def _capitalised(match: re.Match[str]) -> str:
    """tyro writes booleans as Python does; people and TOML write them small."""
    return (match[1] or "") + match[2].capitalize()
