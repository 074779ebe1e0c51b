"""One run of one method on one clip with one seed: the unit of every sweep over accuracy."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import torch

from ..comparison.outcome import versions_of
from ..comparison.shipped import shipped_folder, shipped_methods
from ..config import Config
from ..datasets import RgbdSequence, open_sequence
from ..errors import IdRgbdoError
from ..evaluation import Evaluation, evaluate
from ..frame import BrokenFrame, RgbdFrame
from ..odometry import Odometry, Run, Status, run
from ..runs.folder import is_refined, measurements, summarise
from ..runs.machine import machine_name
from ..text import configfile
from ..tracker.tracking import motion_information

OURS = "ours"
PACKAGE = Path(__file__).resolve().parent.parent
DECIDING = (
    "definitions",
    "kernels",
    "tracker",
    "datasets",
    "evaluation",
    "text",
)  # folders that change results
FRAME_BYTES = 11  # a pixel, decoded: gray and depth in 4 each, colour in 3
KEPT_SHARE = 0.25  # of the machine's memory, that all processes together may fill with decoded frames


@dataclass(frozen=True)
class Clip:
    """A part of a sequence in TUM's layout."""

    name: str  # of the sequence
    folder: Path
    digest: str  # of the sequence's contents
    length: int  # frames of the whole sequence
    start: int = 0
    frames: int | None = None  # None: to the end

    def shifted(self, step: int, shifts: int) -> Clip:
        """The clip moved on by `step` frames; all of `shifts` such clips have the same length."""
        whole = min(self.length - self.start, self.frames or self.length)
        return replace(self, start=self.start + step, frames=whole - (shifts - 1))


@dataclass(frozen=True)
class Task:
    """What is run. `config` is of OURS; other methods are named as in METHODS of baselines/."""

    clip: Clip
    method: str = OURS
    config: Config | None = None
    seed: int = 0

    @property
    def key(self) -> str:
        """A digest of everything that decides the result; where the recording lies is no part of it."""
        clip = self.clip
        settings = _settings(self)
        parts = [clip.digest, clip.start, clip.frames, self.method, settings, self.seed, code_digest()]
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:20]


@dataclass(frozen=True)
class Measured:
    """The numbers of a task. None stands for what could not be measured."""

    sequence: str
    method: str
    seed: int
    error: str = ""  # why there is nothing else
    frames: int = 0
    lost: int = 0
    weak: int = 0
    keyframes: int = 0
    ate_m: float | None = None
    rpe_m_per_s: float | None = None
    rpe_deg_per_s: float | None = None
    k2fe_mean_m: float | None = None
    refined_ate_m: float | None = None  # of the poses that the window refined afterwards
    entropy_bits: float | None = None  # mean differential entropy of the pose against its keyframe, metres and radians
    ms_median: float | None = None
    ms_mean: float | None = None
    ms_p95: float | None = None
    total_s: float | None = None  # in track(), all frames


def measured(result: dict[str, Any], task: Task) -> Measured:
    """A result of `measure` as numbers; a failed one is the task's error."""
    known = {item.name for item in fields(Measured)}
    about = {"sequence": task.clip.name, "method": task.method, "seed": task.seed}
    return Measured(**{**about, **{name: value for name, value in result.items() if name in known}})


def measure(task: Task) -> dict[str, Any]:
    """Run the task; the fields of a Measured, and when and where they were measured."""
    sequence = open_clip(task.clip)
    odometry = make(task)
    done = run(odometry, _frames(task.clip))
    evaluation, refined = _evaluate(done, odometry, sequence, task.method == OURS)
    summary = summarise(done)
    timing = summary["timing_ms"]
    numbers = Measured(
        task.clip.name,
        task.method,
        task.seed,
        frames=summary["frames"],
        lost=summary["lost"],
        weak=done.statuses.count(Status.WEAK),
        keyframes=summary["keyframes"],
        ate_m=evaluation.ate.rmse_m if evaluation else None,
        rpe_m_per_s=evaluation.rpe.rmse_m_per_s if evaluation and evaluation.rpe else None,
        rpe_deg_per_s=evaluation.rpe.rmse_deg_per_s if evaluation and evaluation.rpe else None,
        k2fe_mean_m=evaluation.k2fe.mean_m if evaluation and evaluation.k2fe else None,
        refined_ate_m=refined,
        entropy_bits=_mean_entropy_bits(done),
        ms_median=timing["track_median"],
        ms_mean=timing["mean_per_frame"],
        ms_p95=timing["track_p95"],
        total_s=sum(record.track_ms or 0.0 for record in done.records) / 1000,
    )
    date = datetime.now(UTC).isoformat(timespec="seconds")
    return {**asdict(numbers), "settings": _difference(task), "date": date, "machine": machine_name()}


def make(task: Task) -> Odometry:
    """The task's odometry."""
    if task.method == OURS:
        from ..tracker.id_rgbdo import IdRgbdo

        return IdRgbdo(replace(task.config or Config(), seed=task.seed))
    return shipped_methods()[task.method].make(task.seed)


def prior_entropy_bits(config: Config, rate: float = 30.0) -> float:
    """Differential entropy of the pose of a frame that only the motion prior predicts."""
    return _entropy_bits(motion_information(config, 1.0 / rate))


def content_digest(folder: Path) -> str:
    """What tells a recording from another of the same name: its lists, its reference, and its first and last images."""
    digest = hashlib.sha256()
    for name in ("rgb.txt", "depth.txt", "groundtruth.txt", "calibration.txt", "camera.toml"):
        path = folder / name
        digest.update(path.read_bytes() if path.exists() else b"none")
    for kind in ("rgb", "depth"):
        images = sorted((folder / kind).iterdir()) if (folder / kind).is_dir() else []
        for path in (*images[:1], *images[-1:]):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


@lru_cache(maxsize=1)
def code_digest() -> str:
    """Of the code that decides results, so that a changed method is measured anew; and of the libraries' versions."""
    folders = [*(PACKAGE / name for name in DECIDING), shipped_folder()]
    files = sorted(PACKAGE.glob("*.py")) + [path for folder in folders for path in sorted(folder.rglob("*.py"))]
    digest = hashlib.sha256(json.dumps(versions_of(("torch", "numpy", "numba", "open3d"))).encode())
    for path in files:
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()


def _settings(task: Task) -> str:
    if task.method == OURS:
        return configfile.dump(replace(task.config or Config(), seed=task.seed))
    return shipped_methods()[task.method].settings()


def _difference(task: Task) -> str:
    """How the configuration differs from the defaults, for a reader of the results."""
    if task.config is None:
        return ""
    return ", ".join(f"{name}={value}" for name, value in _changes(task.config, Config()))


def _changes(config: Any, default: Any, where: str = "") -> list[tuple[str, Any]]:
    found: list[tuple[str, Any]] = []
    for item in fields(config):
        a, b = getattr(config, item.name), getattr(default, item.name)
        if hasattr(a, "__dataclass_fields__"):
            found += _changes(a, b, f"{where}{item.name}.")
        elif a != b and item.name != "seed":
            found.append((f"{where}{item.name}", a))
    return found


@lru_cache(maxsize=2)
def open_clip(clip: Clip) -> RgbdSequence:
    return open_sequence(clip.folder, start=clip.start, max_frames=clip.frames)


def _frames(clip: Clip) -> Sequence[RgbdFrame | BrokenFrame] | RgbdSequence:
    """The clip's frames: decoded once for all tasks in a row that want them, where they fit into memory."""
    sequence = open_clip(replace(clip, start=0, frames=None))
    camera = sequence.camera
    if len(sequence) * camera.width * camera.height * FRAME_BYTES > _kept_bytes():
        return open_clip(clip)
    end = len(sequence) if clip.frames is None else clip.start + clip.frames
    return _decoded(clip.folder)[clip.start : end]


def _kept_bytes() -> float:
    """Memory for decoded frames that a process may keep for its next task; none where the system does not say."""
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return 0.0
    return KEPT_SHARE * memory / (os.cpu_count() or 1)


@lru_cache(maxsize=1)
def _decoded(folder: Path) -> tuple[RgbdFrame | BrokenFrame, ...]:
    return tuple(open_sequence(folder))


def _evaluate(
    done: Run, odometry: Odometry, sequence: RgbdSequence, ours: bool
) -> tuple[Evaluation | None, float | None]:
    """The errors of the causal poses, and the ATE of the refined ones where there are such."""
    if sequence.groundtruth is None:
        return None, None
    has_keyframes = ours or any(record.result.keyframe for record in done.records[1:])
    try:
        evaluation = evaluate(done.trajectory(), sequence.groundtruth, measurements(done) if has_keyframes else ())
        refined = odometry.trajectory()
        if not is_refined(refined, done):
            return evaluation, None
        return evaluation, evaluate(refined, sequence.groundtruth).ate.rmse_m
    except IdRgbdoError:
        return None, None  # the reference covers too little of the clip


def _mean_entropy_bits(done: Run) -> float | None:
    found = [
        _entropy_bits(record.result.information.numpy())
        for record in done.records
        if record.result.information is not None and record.result.status is not Status.LOST
    ]
    finite = [bits for bits in found if math.isfinite(bits)]
    return fmean(finite) if finite else None


def _entropy_bits(information: np.ndarray[Any, np.dtype[np.float64]] | torch.Tensor) -> float:
    """Eq. 11 of the (6, 6) covariance that is this information's inverse; infinite where it has none."""
    sign, log_determinant = np.linalg.slogdet(np.asarray(information))
    if sign <= 0:
        return math.inf
    return float(0.5 * (6 * math.log2(2 * math.pi * math.e) - log_determinant / math.log(2)))
