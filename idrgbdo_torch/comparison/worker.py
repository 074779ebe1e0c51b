"""The process in which one method runs, so that nothing it does to memory, threads or itself touches another's."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from ..datasets import RgbdSequence, open_sequence
from ..errors import IdRgbdoError
from ..evaluation import evaluate
from ..odometry import Record, found_again, run
from ..runs.folder import RunFolder, measurements, summarise
from ..runs.machine import peak_memory_mb
from .methods import Method

STDERR = "stderr.txt"


@dataclass(frozen=True)
class Source:
    """A recorded sequence and which of its frames are used."""

    folder: Path
    start: int = 0
    every: int = 1
    max_frames: int | None = None
    format: str | None = None  # else it is recognised
    camera: Path | None = None  # else the recording's own
    depth_scale: float | None = None  # depth values per metre; else the camera file's or the format's

    def open(self) -> RgbdSequence:
        """The sequence. Raises IdRgbdoError where there is none."""
        return open_sequence(
            self.folder,
            format=self.format,
            camera=self.camera,
            depth_scale=self.depth_scale,
            start=self.start,
            every=self.every,
            max_frames=self.max_frames,
        )


def run_apart(
    method: Method, seed: int, source: Source, folder: Path, on_frame: Callable[[str], None]
) -> dict[str, Any] | str:
    """Run a method in a new process into a run folder: the measured fields of an Outcome, or why there are none.

    on_frame gets each frame's status. Interrupting this ends the process too.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / STDERR).unlink(missing_ok=True)
    context = multiprocessing.get_context("spawn")  # a fork would share the parent's threads and memory
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(theirs, method, seed, source, folder), daemon=True)
    process.start()
    theirs.close()
    answer: dict[str, Any] | None = None
    ended = False
    try:
        while answer is None:
            message = ours.recv()
            if isinstance(message, dict):
                answer = message
            else:
                on_frame(message)
        ended = True
    except EOFError:
        ended = True  # without an answer
    finally:
        if not ended:
            process.terminate()
        process.join()
    return answer if answer is not None else _last_words(folder / STDERR, process.exitcode)


def _work(connection: Connection, method: Method, seed: int, source: Source, folder: Path) -> None:
    """In the new process: track the sequence, send each status, then the fields."""
    with (folder / STDERR).open("wb") as file:
        os.dup2(file.fileno(), 2)  # what libraries in C++ say at their end is of interest too
    sequence = source.open()
    odometry = method.make(seed)
    with RunFolder(folder, method.settings()) as run_folder:

        def on_record(record: Record) -> None:
            run_folder.append(record)
            connection.send(record.result.status.value)

        # read one by one: a thread that decodes ahead would take time from the method that is timed
        frames = (sequence.read(index) for index in range(len(sequence)))
        done = run(odometry, frames, on_record)
        evaluation = None
        later_keyframes = [record for record in done.records[1:] if record.result.keyframe]
        if sequence.groundtruth is not None and len(done.records) > 2:
            try:
                evaluation = evaluate(
                    done.trajectory(), sequence.groundtruth, measurements(done) if later_keyframes else ()
                )
            except IdRgbdoError:
                evaluation = None  # the reference covers too little of the sequence
        run_folder.finish(done, odometry, evaluation)
    summary = summarise(done, evaluation)
    again, breaks = found_again(done.records)
    errors, timing = summary.get("evaluation", {}), summary["timing_ms"]
    connection.send(
        {
            "frames": summary["frames"],
            "tracked": summary["tracked"],
            "weak": summary["weak"],
            "lost": summary["lost"],
            "breaks": breaks,
            "found_again": again,
            "reasons": summary["lost_because"],
            "keyframes": summary["keyframes"],
            "ate_rmse_m": errors.get("ate_rmse_m"),
            "rpe_rmse_m_per_s": errors.get("rpe_rmse_m_per_s"),
            "rpe_rmse_deg_per_s": errors.get("rpe_rmse_deg_per_s"),
            "rpe_pairs": errors.get("rpe_pairs", 0),
            "matched_poses": summary.get("matched_poses", 0),
            "k2fe_mean_m": errors.get("k2fe_mean_m"),
            "track_ms_median": timing["track_median"],
            "track_ms_p95": timing["track_p95"],
            "decode_ms_median": timing["decode_median"],
            "peak_memory_mb": peak_memory_mb(),
        }
    )


def _last_words(stderr: Path, exit_code: int | None) -> str:
    """Why a process ended: the last line it wrote, else its exit status."""
    lines = stderr.read_text(encoding="utf-8", errors="replace").split("\n") if stderr.exists() else []
    words = [line.strip() for line in lines if line.strip()]
    ended = f"ended by signal {-exit_code}" if exit_code is not None and exit_code < 0 else f"exit status {exit_code}"
    return words[-1] if words else f"the process broke off ({ended})"
