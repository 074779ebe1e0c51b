"""A recording or a camera tracked into a run folder: what run, demo and live share."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from .. import __version__, datasets, odometry
from ..config import Config
from ..errors import IdRgbdoError
from ..evaluation import Evaluation, hints
from ..evaluation import evaluate as evaluate_trajectory
from ..frame import BrokenFrame, RgbdFrame
from ..odometry import Odometry, Record, Run
from ..report import Snapshot, run_page, watch
from ..report.terminal import (
    Rows,
    evaluation_rows,
    hint_rows,
    progress_bar,
    run_rows,
    show_table,
    status_counter,
)
from ..runs import checkpoint
from ..runs.checkpoint import Checkpoints, Identity, State
from ..runs.folder import RunFolder, believable, default_folder, is_refined, measurements
from ..runs.source import Reading
from ..runs.writing import write_whole
from ..text import configfile
from ..text.plain import plain
from ..trajectory import Trajectory
from .mesh import fuse_mesh
from .observers import Frames, Observer, Session

if TYPE_CHECKING:
    pass

INTERRUPTED = 128 + signal.SIGINT


def make_odometry(config: Config) -> Odometry:
    """The method of this package."""
    from ..tracker.id_rgbdo import IdRgbdo

    return IdRgbdo(config)


def track(
    sequence: datasets.RgbdSequence,
    title: str,
    config: Config,
    out: Path | None,
    observers: Sequence[Observer] = (),
    map_kind: str = "points",
    resume: bool | None = None,
    reading: Reading | None = None,
) -> int:
    """Track a sequence into a run folder, evaluate it where there is ground truth, and show the table.

    observers: what else goes along. resume: go on with the interrupted run in the folder; None where that can never be,
    so no checkpoint is kept.
    reading: what is tracked, left in the folder; a run is continued with the same alone.
    """
    for warning in sequence.warnings:
        print("warning:", plain(warning), file=sys.stderr)
    source = None
    if reading and resume is not None:
        source = reading.source(sequence if isinstance(sequence, datasets.RecordedSequence) else None)
    identity = Identity.of(__version__, config, title, sequence.timestamps, sequence.camera, source)
    if resume:
        path = out or (Path("runs") / title / "latest").resolve()
        state = checkpoint.load(path, identity, [Snapshot])
        print(f"going on after frame {len(state.records)} of {len(sequence)} in {plain(path)}", flush=True)
    else:
        path = out or default_folder(title, datetime.now())
        state = State(make_odometry(config), [], [])
    method, records, done_before = state.odometry, state.records, len(state.records)
    snapshots: list[Snapshot] = state.extras
    folder = RunFolder(path, configfile.dump(config), resumed=bool(resume))
    kept = resume is not None and checkpoint.can_keep(method)
    checkpoints = Checkpoints(path, identity, [Snapshot]) if kept else None
    count_statuses = status_counter()
    session = Session(path, method, records, sequence.groundtruth)
    with folder:
        if reading:
            reading.remember(path)
        with stop_at_interrupt() as stopped, progress_bar(title, len(sequence)) as advance:
            for record in records:
                folder.append(record)
                advance(count_statuses(record))
            if checkpoints:
                checkpoints.offer(state, now=True)

            def on_record(record: Record) -> None:
                folder.append(record)
                records.append(record)
                advance(count_statuses(record))
                if checkpoints:
                    checkpoints.offer(state)

            picks = {number - done_before for number in _spread_out(len(sequence))}
            frames: Frames = watch(_until(stopped, _from(sequence, done_before)), method, picks, snapshots)
            for observer in observers:
                frames = observer.stream(frames, session)
            done = odometry.run(method, frames, on_record, tuple(records))
            if checkpoints:  # an interrupted run goes on here; a finished one drops it at the end
                checkpoints.offer(state, now=True)
            evaluation, rows = _evaluated(done, method, sequence.groundtruth)
            summary = folder.finish(done, method, evaluation, with_map=map_kind != "none")
        if map_kind == "mesh" and done.records:
            rows.append(("mesh", _mesh(sequence, believable(method.trajectory(), done), path / "mesh.ply")))
        if done.records:
            write_whole(path / "report.html", run_page(path, title, sequence.groundtruth, snapshots))
        for observer in observers:
            observer.finish(done, evaluation, session)
    if checkpoints and checkpoints.problem:
        print("warning:", plain(checkpoints.problem), file=sys.stderr)
    if checkpoints and not stopped:
        checkpoints.remove()
    looked_at = f"{title}, interrupted" if stopped else title
    again = [("go on with", "the same command and --resume")] if checkpoints and stopped else []
    results = [("results in", str(folder.path)), ("look at", str(folder.path / "report.html"))]
    show_table(looked_at, [*run_rows(done, summary), *rows, *again, *(results if done.records else results[:1])])
    return INTERRUPTED if stopped else 0


def _from(sequence: datasets.RgbdSequence, first: int) -> Iterable[RgbdFrame | BrokenFrame]:
    """The frames from number `first` on, decoded ahead where the recording allows it."""
    if isinstance(sequence, datasets.RecordedSequence):
        return sequence.frames(first)
    return (sequence.read(number) for number in range(first, len(sequence))) if first else sequence


def _mesh(sequence: datasets.RgbdSequence, trajectory: Trajectory, out: Path) -> str:
    """The mesh in words; why there is none, where it could not be made: the rest of the run is worth as much."""
    try:
        return fuse_mesh(sequence, trajectory, out)
    except IdRgbdoError as error:
        return f"none: {error}"


def _evaluated(done: Run, method: Odometry, groundtruth: Trajectory | None) -> tuple[Evaluation | None, Rows]:
    """The evaluation of a run's causal poses, and the rows to show; why not, where it cannot be evaluated."""
    if groundtruth is None or not done.records:
        return None, []
    noticed = hint_rows(hints(done.trajectory(), groundtruth))
    try:
        evaluation = evaluate_trajectory(done.trajectory(), groundtruth, measurements(done))
        rows = evaluation_rows(evaluation)
        refined = method.trajectory()
        if is_refined(refined, done):
            after = evaluate_trajectory(refined, groundtruth)
            rpe = f", RPE {after.rpe.rmse_m_per_s:.4f} m/s, {after.rpe.rmse_deg_per_s:.3f} deg/s" if after.rpe else ""
            rows.append(("refined", f"ATE {after.ate.rmse_m:.4f} m{rpe}"))
        return evaluation, [*rows, *noticed]
    except IdRgbdoError as error:
        return None, [("not evaluated", str(error)), *noticed]


def _spread_out(frames: int, count: int = 6) -> set[int]:
    """Numbers of frames for pictures, the first one left out, since nothing is tracked in it."""
    return {round((frames - 1) * (k + 1) / (count + 1)) for k in range(count)} - {0}


@contextmanager
def stop_at_interrupt() -> Iterator[list[int]]:
    """The first Ctrl-C only appends to the list, so that no frame is torn by it; the second one raises as usual."""
    stopped: list[int] = []

    def stop(number: int, _: FrameType | None) -> None:
        stopped.append(number)
        signal.signal(signal.SIGINT, signal.default_int_handler)

    before = signal.signal(signal.SIGINT, stop)
    try:
        yield stopped
    finally:
        signal.signal(signal.SIGINT, before)


def _until(stopped: list[int], frames: Iterable[RgbdFrame | BrokenFrame]) -> Iterator[RgbdFrame | BrokenFrame]:
    for frame in frames:
        if stopped:
            return
        yield frame
