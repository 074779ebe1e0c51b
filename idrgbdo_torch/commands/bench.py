"""`idrgbdo bench`: what tracking costs on this machine, in one table."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from ..config import Config
from ..text.configfile import Count
from ..text.plain import plain
from .input import Input, Settings, open_input
from .output import Output, answer

if TYPE_CHECKING:
    from ..datasets import RgbdSequence
    from ..report.terminal import Rows

UNKNOWN = "unknown"


@dataclass(frozen=True)
class BenchCommand:
    """Measure what tracking costs on this machine: rate, milliseconds, processor, memory and energy of a frame."""

    sequence: Positional[Path | None] = None  # folder or bag; else the demo's rendered desk
    config: Path | None = None  # TOML, or fast, accurate, paper; its values are the defaults of the flags
    rounds: Count = 3  # how often the sequence is tracked, each time from the beginning
    input: Annotated[Input, arg(name="")] = field(default_factory=Input)
    output: Annotated[Output, arg(name="")] = field(default_factory=Output)
    settings: Settings = field(default_factory=Config)


def bench(command: BenchCommand) -> int:
    """Track a recording some times and show what that took."""
    from ..report.terminal import show_table
    from .demo import demo_folder

    sequence = open_input(command.sequence or demo_folder(), command.input)
    for warning in sequence.warnings:
        print("warning:", plain(warning), file=sys.stderr)
    figures = measured(sequence, command.settings, command.rounds)
    answer(**figures)
    show_table(f"{sequence.name} on {figures['machine']}", rows(figures))
    return 0


def measured(sequence: RgbdSequence, config: Config, rounds: int) -> dict[str, Any]:
    """What tracking a recording takes, decoding included but for track_ms; kernels are compiled before.

    Processor time is that of all threads. Energy is that of the whole machine meanwhile.
    """
    from time import perf_counter, process_time

    import numpy as np

    from .. import __version__
    from ..odometry import Record, Status, run
    from ..runs.machine import EnergyMeter, machine_name, peak_memory_mb
    from ..tracker.id_rgbdo import IdRgbdo

    IdRgbdo(config)  # compiles
    next(iter(sequence), None)  # the decoder's kernels too
    meter = EnergyMeter()
    records: list[Record] = []

    def on_record(record: Record) -> None:
        meter.joules()  # before a counter has gone round

    wall, busy = perf_counter(), process_time()
    for _ in range(rounds):
        records += run(IdRgbdo(config), sequence, on_record).records
    wall, busy, joules = perf_counter() - wall, process_time() - busy, meter.joules()
    ms = [record.track_ms for record in records if record.track_ms is not None]
    count = len(records)
    median, p95, p99 = (float(x) for x in np.percentile(ms, [50, 95, 99])) if ms else (None, None, None)
    camera = sequence.camera
    return {
        "idrgbdo": __version__,
        "machine": machine_name(),
        "sequence": sequence.name,
        "image": [camera.width, camera.height],
        "points": config.selection.points,
        "frames": count,
        "lost": sum(record.result.status is Status.LOST for record in records),
        "keyframes": sum(record.result.keyframe for record in records),
        "frames_per_second": count / wall,
        "track_ms": {"median": median, "p95": p95, "p99": p99, "mean": float(np.mean(ms)) if ms else None},
        "processor_s_per_frame": busy / count if count else None,
        "peak_memory_mb": peak_memory_mb(),
        "joules_per_frame": joules / count if joules is not None and count else None,
    }


def rows(figures: dict[str, Any]) -> Rows:
    """The figures as a table."""
    ms, processor, memory = figures["track_ms"], figures["processor_s_per_frame"], figures["peak_memory_mb"]
    joules = figures["joules_per_frame"]
    width, height = figures["image"]
    frames = f"{figures['frames']} of {width}x{height}, {figures['keyframes']} keyframes, {figures['lost']} lost"
    spread = (
        f"{ms['median']:.2f} ms median, {ms['p95']:.2f} ms 95 %, {ms['p99']:.2f} ms 99 %" if ms["median"] else UNKNOWN
    )
    return [
        ("frames", frames),
        ("points", str(figures["points"])),
        ("speed", f"{figures['frames_per_second']:.1f} frames per second, decoding included"),
        ("tracking a frame", spread),
        ("processor a frame", UNKNOWN if processor is None else f"{1000 * processor:.2f} ms, all threads"),
        ("peak memory", UNKNOWN if memory is None else f"{memory:.0f} MB"),
        ("energy a frame", UNKNOWN if joules is None else f"{joules:.3f} J, all that ran on the machine"),
    ]
