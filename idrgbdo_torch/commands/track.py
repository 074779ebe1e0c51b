"""A recording or a camera tracked into a run folder: what run, demo and live share."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from types import FrameType
from typing import Any

from .. import __version__, datasets, odometry
from ..config import Config
from ..definitions.records import Records
from ..errors import IdRgbdoError
from ..evaluation import Evaluation, hints
from ..evaluation import evaluate as evaluate_trajectory
from ..frame import BrokenFrame, RgbdFrame
from ..odometry import Odometry, Record, Run
from ..report import Glimpse, run_page, watch
from ..report.terminal import (
    Rows,
    camera_rows,
    compiling_bar,
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
from .output import answer

INTERRUPTED = 128 + signal.SIGINT
WHY = "`idrgbdo check` may tell why: dark images, say, or a wrong depth scale"


def make_odometry(config: Config) -> Odometry:
    """The method of this package; on a terminal a bar shows its kernels being compiled, where they have to be."""
    from ..tracker.id_rgbdo import IdRgbdo
    from ..tracker.warmup import warm_up

    if config.backend == "fused":
        with compiling_bar() as on_function:
            warm_up(lambda config: IdRgbdo(config, compile_ahead=False), on_function)
    return IdRgbdo(config)


@dataclass(frozen=True)
class Job:
    """A recording or a camera to be tracked, and how."""

    sequence: datasets.RgbdSequence
    title: str
    config: Config
    map_kind: str = "points"
    reading: Reading | None = None  # what is tracked, left in the folder; a run is continued with the same alone

    def identity(self) -> Identity:
        """What a checkpoint has to be of to be continued."""
        sequence, source = self.sequence, None
        if self.reading:
            source = self.reading.source(sequence if isinstance(sequence, datasets.RecordedSequence) else None)
        return Identity.of(__version__, self.config, self.title, sequence.timestamps, sequence.camera, source)

    def begin(self) -> State:
        """A run without a frame yet."""
        return State(make_odometry(self.config), Records(), [])

    def go_on(self, path: Path) -> State:
        """The interrupted run in a folder. Raises IdRgbdoError where there is none of this job."""
        return checkpoint.load(path, self.identity(), [Glimpse])


@dataclass(frozen=True)
class Tracked:
    """What became of a job."""

    done: Run
    evaluation: Evaluation | None
    summary: dict[str, Any]
    rows: Rows  # of the evaluation and the mesh
    stopped: bool  # before the end
    kept: bool  # in a checkpoint
    problem: str  # with it, a sentence


def track(
    job: Job,
    out: Path | None,
    observers: Sequence[Observer] = (),
    resume: bool | None = None,
) -> int:
    """Track a sequence into a run folder, evaluate it where there is ground truth, and show the table.

    observers: what else goes along. resume: go on with the interrupted run in the folder; None where that can never be,
    so no checkpoint is kept. The exit status: 130 where Ctrl-C ended it, 1 where no frame could be tracked.
    """
    for warning in job.sequence.warnings:
        print("warning:", plain(warning), file=sys.stderr)
    if resume:
        path = out or (Path("runs") / job.title / "latest").resolve()
        state = job.go_on(path)
        print(f"going on after frame {len(state.records)} of {len(job.sequence)} in {plain(path)}", flush=True)
    else:
        path = out or default_folder(job.title, datetime.now())
        state = job.begin()
    tracked = do(job, path, state, observers, resume)
    if tracked.problem:
        print("warning:", plain(tracked.problem), file=sys.stderr)
    looked_at = f"{job.title}, interrupted" if tracked.stopped else job.title
    again = [("go on with", "the same command and --resume")] if tracked.kept and tracked.stopped else []
    folder, has_page = path.absolute(), bool(tracked.done.records)
    results = [("results in", str(folder)), ("look at", str(folder / "report.html"))]
    shown = [*run_rows(tracked.done, tracked.summary), *tracked.rows, *again, *(results if has_page else results[:1])]
    show_table(looked_at, shown)
    answer(sequence=job.title, folder=folder, report=folder / "report.html" if has_page else None, **tracked.summary)
    if tracked.stopped:
        return INTERRUPTED
    if tracked.done.records and not tracked.summary["tracked"]:
        print(f"error: run: no frame of {plain(job.title)} could be tracked; {WHY}", file=sys.stderr)
        return 1
    return 0


def do(
    job: Job,
    path: Path,
    state: State,
    observers: Sequence[Observer] = (),
    resume: bool | None = None,
    terminal: bool = True,
) -> Tracked:
    """Track what is left of a job into a run folder.

    resume: as for track(). terminal: with a bar, and Ctrl-C ends it after a frame; else silent, and fit for a thread.
    """
    sequence, method, records = job.sequence, state.odometry, state.records
    done_before = len(records)
    glimpses: list[Glimpse] = state.extras
    kept = resume is not None and checkpoint.can_keep(method)
    checkpoints = Checkpoints(path, job.identity(), [Glimpse]) if kept else None
    count_statuses = status_counter()
    session = Session(path, method, records, sequence.groundtruth)
    folder = RunFolder(path, configfile.dump(job.config), bool(resume), job.reading)
    with folder:
        with _watched(job, terminal) as (stopped, advance):
            for record in records:
                folder.append(record)
                advance(count_statuses(record))
            if checkpoints and records:
                checkpoints.offer(state, now=True)

            def on_record(record: Record) -> None:
                folder.append(record)
                state.camera.look(record, method)
                advance(count_statuses(record))
                if checkpoints:  # with the first frame too: the checkpoint of an earlier run has gone by then
                    checkpoints.offer(state, now=len(state.records) == 1)

            frames: Frames = watch(_until(stopped, _from(sequence, done_before)), method, glimpses, done_before)
            for observer in observers:
                frames = observer.stream(frames, session)
            done = odometry.run(method, frames, on_record, records)
            if checkpoints and done.records:  # an interrupted run goes on here; a finished one drops it at the end
                checkpoints.offer(state, now=True)
            evaluation, rows = _evaluated(done, method, sequence.groundtruth)
            seen = state.camera.estimate(sequence.camera)
            summary = folder.finish(done, method, evaluation, job.map_kind != "none", seen)
            rows = [*camera_rows(seen, sequence.camera), *rows]
        if job.map_kind == "mesh" and done.records:
            trajectory = believable(method.trajectory(), done)
            rows.append(("mesh", _mesh(sequence, trajectory, path / "mesh.ply", terminal)))
        if done.records:
            page = run_page(path, job.title, sequence.groundtruth, glimpses, sequence.camera)
            write_whole(path / "report.html", page)
        for observer in observers:
            observer.finish(done, evaluation, session)
    if checkpoints and done.records and not stopped:
        checkpoints.remove()
    problem = checkpoints.problem if checkpoints else ""
    return Tracked(done, evaluation, summary, rows, bool(stopped), checkpoints is not None, problem)


@contextmanager
def _watched(job: Job, terminal: bool) -> Iterator[tuple[list[int], Callable[[str], None]]]:
    """What Ctrl-C appends to, and a function that is told of every frame."""
    if not terminal:
        yield [], lambda note: None
        return
    with stop_at_interrupt() as stopped, progress_bar(job.title, len(job.sequence)) as advance:
        yield stopped, advance


def _from(sequence: datasets.RgbdSequence, first: int) -> Iterable[RgbdFrame | BrokenFrame]:
    """The frames from number `first` on, decoded ahead where the recording allows it."""
    if isinstance(sequence, datasets.RecordedSequence):
        return sequence.frames(first)
    return (sequence.read(number) for number in range(first, len(sequence))) if first else sequence


def _mesh(sequence: datasets.RgbdSequence, trajectory: Trajectory, out: Path, terminal: bool) -> str:
    """The mesh in words; why there is none, where it could not be made: the rest of the run is worth as much."""
    try:
        return fuse_mesh(sequence, trajectory, out, terminal=terminal)
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
