"""Runs every method on every sequence, one process each, and remembers what is done."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import torch

from ..datasets import RgbdSequence
from ..errors import IdRgbdoError
from ..evaluation import ASSOCIATION_LIMIT_S, evaluate
from ..frame import RgbdFrame
from ..runs.machine import machine_name
from ..runs.writing import is_file_name, write_whole
from ..text.files import MOST_TEXT, read_bytes
from ..trajectory import associate, read_tum, tum_text
from .methods import Methods
from .outcome import (
    EXTERNAL,
    Outcome,
    append_outcome,
    configuration_digest,
    read_outcomes,
    stamp,
    stamped,
    versions_of,
)
from .summary import Comparison
from .worker import Source, run_apart


@dataclass(frozen=True)
class External:
    """A trajectory that another program wrote, as a row of the table."""

    name: str
    trajectory: Path  # TUM text
    sequence: str | None = None  # its name; None where that is clear


@dataclass(frozen=True)
class Progress:
    """What is going on, for a progress bar."""

    method: str
    sequence: str
    seed: int
    job: int  # from 1
    jobs: int
    frame: int
    frames: int


def compare(
    methods: Methods,
    sources: Sequence[Source],
    out: Path,
    *,
    seeds: int = 1,
    externals: Sequence[External] = (),
    overwrite: bool = False,
    on_progress: Callable[[Progress], None] = lambda progress: None,
) -> Comparison:
    """Run what is not done yet, and lay everything that was asked for side by side.

    methods: by name; those that are random run with seeds 0 to seeds - 1, the others once. Each outcome is appended to
    out/results.jsonl as it comes, its run folder is out/runs/<sequence>/<method>. An outcome with the same method,
    seed, settings, frames and versions is not repeated, unless overwrite is set or the method broke.
    Raises IdRgbdoError for sequences that cannot be read or told apart, before anything runs.
    """
    sequences = [source.open() for source in sources]
    names = [sequence.name for sequence in sequences]
    for name in names:
        if names.count(name) > 1:
            raise IdRgbdoError(f"sequences: expected different names, got '{name}' twice; rename a folder")
    for name in methods:
        if not is_file_name(name):
            raise IdRgbdoError(f"methods: expected names that a folder can have, got '{name}'; rename it in METHODS")
    if twice := {each.name for each in externals} & set(methods):
        raise IdRgbdoError(f"external: '{twice.pop()}' is the name of a method; pass another")
    by_name = dict(zip(names, sequences, strict=True))
    outside = [_external_outcome(each, by_name[_sequence_of(each, sources, names)], out) for each in externals]
    done = {} if overwrite else read_outcomes(out)
    machine = machine_name()
    digests = [_frames_digest(sequence) for sequence in sequences]
    wanted: list[Outcome] = []
    jobs = [
        (name, seed, source, sequence, digest)
        for source, sequence, digest in zip(sources, sequences, digests, strict=True)
        for name, method in methods.items()
        for seed in range(seeds if method.random else 1)
    ]
    for number, (name, seed, source, sequence, digest) in enumerate(jobs, start=1):
        method = methods[name]
        outcome = Outcome(
            name,
            sequence.name,
            seed,
            configuration_digest(method, digest),
            versions_of(method.libraries),
            method.description,
            method.kind,
            date=datetime.now(UTC).isoformat(timespec="seconds"),
            machine=machine,
            folder=str(Path("runs") / sequence.name / (f"{name}_{seed}" if method.random else name)),
        )
        known = done.get(outcome.key)
        if known is None or known.error or not _is_there(out / known.folder, known):
            tracked = 0
            progress = Progress(name, sequence.name, seed, number, len(jobs), 0, len(sequence))
            on_progress(progress)

            def on_frame(status: str, progress: Progress = progress) -> None:
                nonlocal tracked
                tracked += 1
                on_progress(replace(progress, frame=tracked))

            answer = run_apart(method, seed, source, out / outcome.folder, on_frame)
            known = replace(outcome, error=answer) if isinstance(answer, str) else replace(outcome, **answer)
            if not known.error:  # else what is there may be of an earlier run, or of nobody
                stamp(out / known.folder, known)
            append_outcome(out, known)
        wanted.append(known)
    for outcome in outside:
        if outcome.key not in done:
            append_outcome(out, outcome)
        wanted.append(outcome)
    groundtruths = {sequence.name: sequence.groundtruth for sequence in sequences}
    return Comparison(tuple(wanted), out, groundtruths)


def _is_there(folder: Path, outcome: Outcome) -> bool:
    """Whether the poses of an outcome are still in its folder."""
    return (folder / "trajectory.txt").exists() and stamped(folder, outcome)


def parse_external(text: str) -> External:
    """NAME=FILE, or NAME@SEQUENCE=FILE."""
    name, _, path = text.partition("=")
    name, _, sequence = name.partition("@")
    if not name or not path:
        raise IdRgbdoError(f"external: expected NAME=FILE or NAME@SEQUENCE=FILE, got '{text}'; correct it")
    if not is_file_name(name):
        raise IdRgbdoError(f"external: expected a name that a folder can have, got '{name}'; leave out / and the like")
    return External(name, Path(path), sequence or None)


def _sequence_of(external: External, sources: Sequence[Source], names: Sequence[str]) -> str:
    """The sequence that an outside trajectory belongs to: the named one, the only one, or the one it lies in."""
    if external.sequence is not None:
        if external.sequence not in names:
            raise IdRgbdoError(f"external: no sequence '{external.sequence}' here; expected one of {', '.join(names)}")
        return external.sequence
    inside = [
        name
        for name, source in zip(names, sources, strict=True)
        if source.folder.resolve() in external.trajectory.resolve().parents
    ]
    if len(names) == 1 or len(inside) == 1:
        return (inside or list(names))[0]
    raise IdRgbdoError(
        f"external: which sequence is '{external.trajectory}' of? write {external.name}@SEQUENCE={external.trajectory}"
    )


def _external_outcome(external: External, sequence: RgbdSequence, out: Path) -> Outcome:
    """The outcome of a trajectory file; a frame without a pose is lost."""
    trajectory = read_tum(external.trajectory)  # says what is wrong where it cannot be read
    times = torch.tensor(sequence.timestamps, dtype=torch.float64)
    of_estimate, _ = associate(trajectory.timestamps, times, ASSOCIATION_LIMIT_S)
    matched = len(of_estimate)
    folder = Path("runs") / sequence.name / external.name
    estimate = trajectory.at(of_estimate)
    write_whole(out / folder / "trajectory.txt", tum_text(estimate), make_folder=True)
    evaluation = None
    if sequence.groundtruth is not None and matched > 2:
        with contextlib.suppress(IdRgbdoError):  # the reference covers too little of the estimate
            evaluation = evaluate(estimate, sequence.groundtruth)
    rpe = evaluation.rpe if evaluation else None
    missing = len(sequence) - matched
    return Outcome(
        external.name,
        sequence.name,
        0,
        hashlib.sha256(read_bytes(external.trajectory, MOST_TEXT, external.name)).hexdigest()[:12],
        {},
        "a trajectory that another program wrote",
        EXTERNAL,
        frames=len(sequence),
        tracked=matched,
        lost=missing,
        reasons={"no pose in the file": missing} if missing else {},
        ate_rmse_m=evaluation.ate.rmse_m if evaluation else None,
        rpe_rmse_m_per_s=rpe.rmse_m_per_s if rpe else None,
        rpe_rmse_deg_per_s=rpe.rmse_deg_per_s if rpe else None,
        rpe_pairs=len(rpe.errors_m) if rpe else 0,
        matched_poses=evaluation.matched_poses if evaluation else 0,
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        folder=str(folder),
    )


def _frames_digest(sequence: RgbdSequence) -> str:
    """What tells the frames of a sequence from those of another: times, camera, reference, and three of the images."""
    digest = hashlib.sha256(f"{sequence.timestamps} {sequence.camera}".encode())
    if sequence.groundtruth is not None:
        digest.update(sequence.groundtruth.T_world_cam.numpy().tobytes())
    for index in (0, len(sequence) // 2, len(sequence) - 1):
        frame = sequence.read(index)
        if isinstance(frame, RgbdFrame):
            digest.update(frame.gray.numpy().tobytes() + frame.depth.numpy().tobytes())
    return digest.hexdigest()
