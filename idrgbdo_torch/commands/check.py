"""`idrgbdo check`: is a recording fit to be tracked?"""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from ..errors import IdRgbdoError
from ..text.plain import plain
from .input import Input
from .output import Output, answer

if TYPE_CHECKING:
    from ..check import Finding, Report


COLORS = {"good": "green", "note": "yellow", "fault": "red", "unknown": "dim"}


@dataclass(frozen=True)
class CheckCommand:
    """Find out whether a recording is fit to be tracked, and what to do where it is not."""

    sequence: Positional[Path]  # as for `idrgbdo run`
    input: Annotated[Input, arg(name="")] = field(default_factory=Input)
    out: Path | None = None  # PNG; else runs/<sequence>/check.png
    output: Annotated[Output, arg(name="")] = field(default_factory=Output)


def check(command: CheckCommand) -> int:
    """Look at a recording, show what was found, draw the picture; the exit status is 1 where there is a fault."""
    from ..check import check as check_sequence
    from ..check import sampled_frames
    from ..check.picture import draw
    from ..config import Config
    from ..report.pictures import save
    from ..report.terminal import progress_bar
    from .input import open_input
    from .track import make_odometry

    if command.out and command.out.suffix.lower() != ".png":
        raise IdRgbdoError(f"out: expected a name ending in .png, got '{command.out}'; pass another --out")
    sequence = open_input(command.sequence, command.input)
    print("reading", plain(sequence.recognised), flush=True)
    for warning in sequence.warnings:
        print("warning:", plain(warning), file=sys.stderr)
    folder = command.sequence if command.input.associations is None else None
    whole = command.input.start == 0 and command.input.every == 1 and command.input.max_frames is None
    make_odometry(Config())  # so that its kernels are compiled under a bar of their own
    with progress_bar(f"checking {sequence.name}", sampled_frames(sequence)) as advance:
        report = check_sequence(sequence, folder if whole else None, advance)
    picture = command.out or Path("runs") / sequence.name / "check.png"
    save(picture, draw(report.measured))
    _show(sequence.name, report, len(sequence.warnings))
    print(f"picture: {plain(picture)}")
    rows = [asdict(finding) | {"verdict": finding.verdict.value} for finding in report.findings]
    faults = [fault.name for fault in report.faults]
    read = {"reading": sequence.recognised, "warnings": list(sequence.warnings)}
    answer(sequence=sequence.name, **read, faults=faults, findings=rows, picture=picture)
    return 1 if report.faults else 0


def _show(title: str, report: Report, warnings: int) -> None:
    """A row a question; on a terminal as a table. warnings: sentences on how it was read, which have been said."""
    faults = report.faults
    verdict = f"faults: {', '.join(finding.name for finding in faults)}" if faults else "nothing wrong was found"
    if warnings:
        verdict += f"; {warnings} warning{'s' if warnings > 1 else ''} above on how it was read"
    if not sys.stdout.isatty():
        print(f"{plain(title)}, {report.measured.sampled} of {report.measured.frames} frames looked at")
        for finding in report.findings:
            text = "\n    ".join(map(plain, _text(finding, "; ").splitlines()))
            print(f"  {finding.verdict.value:<8}{finding.name:<21}{text}")
        print(plain(verdict))
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    caption = f"{report.measured.sampled} of {report.measured.frames} frames looked at; {verdict}"
    table = Table(title=Text(plain(title)), title_justify="left", caption=caption, caption_justify="left")
    for column in ("", "verdict", "measured, and what to do"):
        table.add_column(column)
    for finding in report.findings:
        color = COLORS[finding.verdict.value]
        table.add_row(
            finding.name,
            f"[{color}]{finding.verdict.value}[/]",
            Text("\n".join(map(plain, _text(finding, "\n").splitlines()))),
        )
    Console().print(table)


def _text(finding: Finding, between: str) -> str:
    return between.join(filter(None, (finding.value, finding.advice)))
