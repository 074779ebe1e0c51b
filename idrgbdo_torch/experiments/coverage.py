"""Coverage: how often the truth lies within the ellipsoid that a pose's covariance says, in the world and at hand."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..datasets import open_sequence
from ..definitions.se3 import inverse, log
from ..errors import IdRgbdoError
from ..odometry import Record, Status
from ..odometry import run as run_odometry
from ..runs import certainty
from ..trajectory import Trajectory, associate
from .drawing import SERIES, new_figure
from .lab import Lab, Report, Table
from .sweep import sweep
from .task import Clip, Task, make

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

SHARES = (0.5, 0.9, 0.95, 0.99)  # of the truth, that the ellipsoids are to hold
GOAL = (0.90, 0.99)  # where the third of them should come out
PARTS, QUICK_PARTS = 4, 2  # a clip is tracked from so many places on, each time to its end
LEAST_FRAMES = 30
SAME_TIME_S = 0.02  # between a frame and its reference pose
KINDS = {"world": "in the world", "keyframe": "against the keyframe"}
RESULTS = "coverage.jsonl"


def run(lab: Lab) -> Report:
    """Track every clip from several places on; the shares of true poses inside the ellipsoids, and their curves."""
    parts = QUICK_PARTS if lab.quick else PARTS
    tasks = {_key(task): task for clip in lab.clips for part in divided(clip, parts) for task in (Task(part),)}
    with lab.progress("coverage") as on_progress:
        results = sweep(measure, tasks, lab.out / RESULTS, lab.workers, on_progress)
    films: dict[str, list[Mapping[str, Any]]] = {clip.name: [] for clip in lab.clips}
    for key, task in tasks.items():
        if error := results[key].get("error"):
            raise IdRgbdoError(f"coverage: '{task.clip.name}' could not be measured: {error}")
        films[task.clip.name].append(results[key])
    inside = {name: {kind: _all(found, kind) for kind in KINDS} for name, found in films.items()}
    rows = tuple(_row(name, films[name], inside[name]) for name in films)
    columns = (
        *("sequence", "frames", "lost", "weak"),
        *(f"{100 * share:g} % {where}" for where in KINDS.values() for share in SHARES),
        *(f"NEES/6 {where}" for where in KINDS.values()),
    )
    return Report(
        f"Coverage: % of true poses within the ellipsoid of so many %, {lab.source}",
        {"coverage": Table(columns, rows)},
        _findings(inside),
        lambda: draw(inside),
    )


def divided(clip: Clip, parts: int) -> list[Clip]:
    """The clip from several places on, each to its end; none that is too short."""
    whole = min(clip.length - clip.start, clip.frames or clip.length)
    begins = [part * whole // parts for part in range(parts)]
    return [
        replace(clip, start=clip.start + begin, frames=whole - begin)
        for begin in begins
        if begin == 0 or whole - begin >= LEAST_FRAMES
    ]


def measure(task: Task) -> dict[str, Any]:
    """Track a clip; the squared Mahalanobis distances of the true poses, in the world and against the keyframe."""
    clip = task.clip
    sequence = open_sequence(clip.folder, start=clip.start, max_frames=clip.frames)
    if sequence.groundtruth is None:
        raise IdRgbdoError(f"coverage: '{clip.name}' has no reference poses; choose another with --sequences")
    done = run_odometry(make(task), sequence)
    statuses = [status.value for status in done.statuses]
    counts = {status.value: statuses.count(status.value) for status in Status}
    return {"frames": len(statuses), **counts, **distances(done.records, sequence.groundtruth)}


def distances(records: Sequence[Record], groundtruth: Trajectory) -> dict[str, list[float]]:
    """By kind, e^T Sigma^-1 e of every frame that was tracked and whose covariance is known; the first is no error."""
    found: dict[str, list[float]] = {kind: [] for kind in KINDS}
    follower = certainty.Certainty()
    true = _true_poses(records, groundtruth)
    if records[0].timestamp not in true:
        raise IdRgbdoError("coverage: the first frame has no reference pose; begin later")
    T_first = inverse(true[records[0].timestamp])
    for number, record in enumerate(records):
        world, _ = follower.follow(record)
        result, T_true = record.result, true.get(record.timestamp)
        if number == 0 or T_true is None or result.status is Status.LOST:
            continue
        if world is not None:
            found["world"].append(squared(_difference(result.T_world_cam, T_first @ T_true), world))
        T_true_ref = true.get(result.reference_time) if result.reference_time is not None else None
        if result.T_ref_cam is not None and result.information is not None and T_true_ref is not None:
            error = log(inverse(result.T_ref_cam) @ inverse(T_true_ref) @ T_true).numpy()
            found["keyframe"].append(float(error @ result.information.numpy() @ error))
    return found


def squared(error: Array, covariance: Array) -> float:
    """e^T Sigma^-1 e of an error (6,) with a covariance (6, 6), scaled so that metres and radians are alike."""
    spread = 1.0 / np.sqrt(covariance.diagonal())
    scaled = covariance * np.outer(spread, spread)
    return float((error * spread) @ np.linalg.solve(scaled, error * spread))


def shares_inside(squares: Array, shares: Sequence[float] = SHARES) -> list[float]:
    """Which share of squared distances of 6 degrees of freedom lies within the ellipsoids that are to hold so much."""
    from scipy.stats import chi2

    return [float(np.mean(squares <= chi2.ppf(share, 6))) for share in shares]


def draw(inside: Mapping[str, Mapping[str, Array]]) -> Figure:
    """What should lie inside against what does, a curve a sequence; on the diagonal a covariance is right."""
    figure = new_figure(columns=2, width=4.6, height=4.2)
    expected = np.linspace(0.01, 0.99, 99)
    for axes, (kind, where) in zip(figure.axes, KINDS.items(), strict=True):
        axes.plot([0, 100], [0, 100], color="#1d2733", linewidth=0.8)
        for number, (name, squares) in enumerate(inside.items()):
            measured = 100 * np.array(shares_inside(squares[kind], expected.tolist()))
            style = ("-", "--", ":")[number // len(SERIES) % 3]
            axes.plot(100 * expected, measured, style, color=SERIES[number % len(SERIES)], label=name)
        axes.set(title=f"pose {where}", xlabel="% that should lie inside", xlim=(0, 100), ylim=(0, 101))
    figure.axes[0].set_ylabel("% of true poses that do")
    figure.axes[1].legend(frameon=False, fontsize=8, loc="lower right")
    return figure


def _row(name: str, found: Sequence[Mapping[str, Any]], inside: Mapping[str, Array]) -> tuple[Any, ...]:
    counts = [sum(int(part[key]) for part in found) for key in ("frames", Status.LOST.value, Status.WEAK.value)]
    percents = [100 * share for kind in KINDS for share in shares_inside(inside[kind])]
    return (name, *counts, *percents, *(fmean(inside[kind]) / 6 for kind in KINDS))


def _all(found: Sequence[Mapping[str, Any]], kind: str) -> Array:
    return np.concatenate([np.asarray(part[kind], dtype=np.float64) for part in found])


def _findings(inside: Mapping[str, Mapping[str, Array]]) -> tuple[str, ...]:
    lines = []
    for kind, where in KINDS.items():
        shares = {name: shares_inside(squares[kind], (0.95,))[0] for name, squares in inside.items()}
        good = [name for name, share in shares.items() if GOAL[0] <= share <= GOAL[1]]
        low = {name: share for name, share in shares.items() if share < GOAL[0]}
        line = f"{where}, 95 %: between {min(shares.values()):.1%} and {max(shares.values()):.1%}, "
        line += f"{len(good)} of {len(shares)} sequences between {GOAL[0]:.0%} and {GOAL[1]:.0%}"
        if low:
            line += f"; below: {', '.join(f'{name} {share:.1%}' for name, share in low.items())}"
        lines.append(line)
    return tuple(lines)


def _true_poses(records: Sequence[Record], groundtruth: Trajectory) -> dict[float, Tensor]:
    """T_world_cam by the frame's time, where the reference has one."""
    times = torch.tensor([record.timestamp for record in records], dtype=torch.float64)
    of_frames, of_reference = associate(times, groundtruth.timestamps, SAME_TIME_S)
    poses = groundtruth.T_world_cam
    return {records[int(a)].timestamp: poses[int(b)] for a, b in zip(of_frames, of_reference, strict=True)}


def _difference(T: Tensor, T_true: Tensor) -> Array:
    """(6,) position, and rotation about the world's axes, by which T is off."""
    turned = torch.eye(4, dtype=torch.float64)
    turned[:3, :3] = T[:3, :3] @ T_true[:3, :3].mT
    return np.concatenate([(T - T_true)[:3, 3].numpy(), log(turned)[3:].numpy()])


def _key(task: Task) -> str:
    """A task's key, with the code of the covariance in it."""
    code = Path(certainty.__file__).read_bytes() + Path(__file__).read_bytes()
    return hashlib.sha256(task.key.encode() + code).hexdigest()[:20]
