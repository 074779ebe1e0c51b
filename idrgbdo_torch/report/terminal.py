"""What the command shows: a progress bar while it works, a table at the end. Silent where nobody watches."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from ..definitions.camera import Pinhole
from ..evaluation import Evaluation
from ..odometry import Record, Run, Status, lost_because
from ..text.plain import plain
from ..tracker.camera_estimate import CameraEstimate

Rows = list[tuple[str, str]]
MOST_REASONS = 3  # kinds of reasons for a loss that are shown
KERNELS = 60  # functions that are compiled, about
COLORS = {Status.OK: "green", Status.WEAK: "yellow", Status.LOST: "red"}


@contextmanager
def progress_bar(title: str, total: int | None) -> Iterator[Callable[[str], None]]:
    """A bar with frames per second and remaining time, on a terminal only; call the function once a frame.

    total: None for no bar at all.
    """
    if total is None or not sys.stdout.isatty():
        yield lambda note: None
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn())
    details = (TextColumn("{task.fields[fps]:.0f} fps {task.fields[note]}"), TimeRemainingColumn())
    with Progress(*columns, *details) as progress:
        task = progress.add_task(plain(title), total=total, fps=0.0, note="")
        begin, done = time.monotonic(), 0

        def advance(note: str) -> None:
            nonlocal done
            done += 1
            progress.update(task, advance=1, fps=done / max(time.monotonic() - begin, 1e-9), note=note)

        yield advance


@contextmanager
def compiling_bar() -> Iterator[Callable[[], None] | None]:
    """A bar over the kernels, shown from the first that has to be compiled; call the function once a kernel.

    On a terminal only; None elsewhere.
    """
    if not sys.stdout.isatty():
        yield None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, transient=True) as progress:
        tasks = [progress.add_task("compiling the kernels, once", total=KERNELS, visible=False)]
        yield lambda: progress.update(tasks[0], advance=1, visible=True)


def status_counter() -> Callable[[Record], str]:
    """A function that counts the statuses of the records it is shown and says how many there were of each."""
    counts: Counter[Status] = Counter()

    def count(record: Record) -> str:
        counts[record.result.status] += 1
        return " ".join(f"[{COLORS[status]}]{counts[status]} {status.value}[/]" for status in Status if counts[status])

    return count


def show_table(title: str, rows: Rows) -> None:
    """Names and values: a table on a terminal, else plain lines."""
    title, rows = plain(title), [(plain(name), plain(value)) for name, value in rows]
    if not sys.stdout.isatty():
        width = max(len(name) for name, _ in rows)
        print(title, *(f"  {name:<{width}}  {value}" for name, value in rows), sep="\n")
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(title), title_justify="left", show_header=False)
    for name, value in rows:
        table.add_row(Text(name), Text(value))
    Console().print(table)


def run_rows(run: Run, summary: dict[str, Any]) -> Rows:
    """The table of a run without its evaluation."""
    timing, fps = summary["timing_ms"], summary["frames_per_second"]
    weak = run.statuses.count(Status.WEAK)
    reasons = list(lost_because(run.records).items())
    shown = [f"{count} x {why}" for why, count in reasons[:MOST_REASONS]]
    shown += [f"{sum(count for _, count in reasons[MOST_REASONS:])} x other"] if reasons[MOST_REASONS:] else []
    rows = [
        ("frames", str(summary["frames"])),
        ("tracked", f"{summary['tracked']}" + (f" ({weak} of them weak)" if weak else "")),
        ("lost", f"{summary['lost']}" + (f" ({'; '.join(shown)})" if shown else "")),
        ("keyframes", str(summary["keyframes"])),
        ("path length", f"{summary['path_length_m']:.3f} m"),
    ]
    if fps is not None:
        median, p95, decode = timing["track_median"], timing["track_p95"], timing["decode_median"]
        rows.append(
            ("time per frame", f"{median:.1f} ms median, {p95:.1f} ms 95 % (and {decode:.1f} ms of waiting for images)")
        )
        rows.append(("speed", f"{fps:.1f} frames per second"))
    return rows


def camera_rows(estimate: CameraEstimate | None, camera: Pinhole) -> Rows:
    """What the images surely show otherwise than the camera file says."""
    found = estimate.departures(camera) if estimate else {}
    return [("camera", f"{'; '.join(found.values())}, unlike its file says")] if found else []


def evaluation_rows(evaluation: Evaluation, both: bool = False) -> Rows:
    """The errors with their units, and what they were measured on. both: the RPE as evo has it too."""
    rpe, k2fe = evaluation.rpe, evaluation.k2fe
    rows = [("ATE", f"{evaluation.ate.rmse_m:.4f} m RMSE after SE(3) alignment without scale")]
    if rpe is None:
        rows.append(("RPE", f"none: {evaluation.no_rpe}"))
    else:
        on = f"RMSE over {len(rpe.errors_m)} pairs {rpe.delta_s:g} s apart"
        degrees = f"{rpe.rmse_deg_per_s:.3f} deg/s"
        if both:
            rows.append(("RPE, TUM tool", f"{rpe.rmse_m_per_s:.4f} m/s, {degrees} {on} (end to begin)"))
            rows.append(("RPE, evo", f"{rpe.rmse_evo_m_per_s:.4f} m/s, {degrees} over the same (begin to end)"))
        else:
            rows.append(("RPE", f"{rpe.rmse_m_per_s:.4f} m/s, {degrees} {on}"))
    if k2fe is not None:
        rows.append(
            ("K2FE", f"{1000 * k2fe.mean_m:.3f} mm mean, {k2fe.sum_m:.4f} m sum over {len(k2fe.errors_m)} frames")
        )
    return [*rows, ("matched poses", f"{evaluation.matched_poses} of {evaluation.poses}")]


def hint_rows(hints: Sequence[str]) -> Rows:
    """What a reader of the errors should know."""
    return [("note", hint) for hint in hints]
