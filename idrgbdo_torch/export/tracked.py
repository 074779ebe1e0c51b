"""A run as its folder tells it, and which of its frames can be handed on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from ..errors import IdRgbdoError
from ..frame import BrokenFrame, RgbdFrame
from ..odometry import Status
from ..text.files import damage_named, read_table
from ..tracker.results import joined
from ..trajectory import Trajectory, nearest, read_tum

Array = NDArray[np.float64]
Read = Callable[[int], RgbdFrame | BrokenFrame]

SAME_TIME_S = 1e-3  # between a row, its pose and its frame: times are written with 1 us


@dataclass(frozen=True)
class TrackedRun:
    """The frames of a run in the order of time."""

    folder: Path
    rows: tuple[dict[str, str], ...]  # of frames.csv
    times: Array  # (N,) s
    T_world_cam: Array  # (N, 4, 4), refined where the run refined them; nan for a frame that could not be read
    segments: NDArray[np.int64]  # (N,) those that joined an earlier one have its number

    def frames_at(self, times: Array) -> NDArray[np.int64]:
        """(M,) numbers of the frames at times (M,) s. Raises IdRgbdoError where there is none."""
        place = nearest(torch.from_numpy(self.times), torch.from_numpy(times)).numpy()
        off = np.abs(self.times[place] - times)
        if len(off) and off.max() > SAME_TIME_S:
            raise IdRgbdoError(
                f"run: '{self.folder}' has no frame at {times[off.argmax()]:.6f} s, where its map has points; run again"
            )
        return np.asarray(place)

    def trajectory(self, frames: Sequence[int]) -> Trajectory:
        """The poses of some frames."""
        return Trajectory(
            torch.from_numpy(self.times)[list(frames)], torch.from_numpy(self.T_world_cam)[list(frames)].contiguous()
        )

    def check_times(self, timestamps: Sequence[float]) -> None:
        """Raises IdRgbdoError where a recording's times (s) are not those that were tracked."""
        if len(timestamps) < len(self.times) or np.any(
            np.abs(np.asarray(timestamps[: len(self.times)]) - self.times) > SAME_TIME_S
        ):
            raise IdRgbdoError(
                f"source: the recording no longer has the {len(self.times)} frames that '{self.folder}' tracked; "
                "put it back or run again"
            )


def load_run(folder: Path, refined: bool = True) -> TrackedRun:
    """A run's folder. refined: False takes every pose as it was known at once.

    Raises IdRgbdoError for a folder that is not a run's, or whose files do not belong together.
    """
    path = folder / "frames.csv"
    rows = tuple(read_table(path, ("timestamp", "status", "segment", "keyframe", "reason")))
    with damage_named(f"run: '{path}'", "the rows of a run", "run again"):
        times = np.array([float(row["timestamp"]) for row in rows])
        if not np.isfinite(times).all() or (np.diff(times) < 0).any():
            raise ValueError("times that are none, or run back")
        for row in rows:
            Status(row["status"]), np.int64(int(row["segment"]))
    hindsight = refined and (folder / "trajectory_refined.txt").exists()
    trajectory = read_tum(folder / ("trajectory_refined.txt" if hindsight else "trajectory.txt"))
    place = nearest(trajectory.timestamps, torch.from_numpy(times))
    T_world_cam = trajectory.T_world_cam[place].numpy()
    T_world_cam[((trajectory.timestamps[place] - torch.from_numpy(times)).abs() > SAME_TIME_S).numpy()] = np.nan
    if any(np.isnan(T[0, 0]) and row["status"] != Status.LOST.value for T, row in zip(T_world_cam, rows, strict=True)):
        raise IdRgbdoError(f"run: '{folder}' has frames without a pose that were not lost; run again")
    return TrackedRun(folder, rows, times, T_world_cam, _segments(rows, hindsight))


def _segments(rows: Sequence[dict[str, str]], hindsight: bool) -> NDArray[np.int64]:
    """(N,) segment of every frame. A segment that joined another moved to it: only poses of hindsight know that."""
    segments = np.array([int(row["segment"]) for row in rows], np.int64)
    for number, row in enumerate(rows if hindsight else ()):
        if pair := joined(row["reason"]):
            so_far = segments[:number]  # a later one may get the number that is free again
            so_far[so_far == pair[0]] = pair[1]
    return segments


@dataclass(frozen=True)
class Chosen:
    """The frames to hand on, and why others are not among them."""

    frames: tuple[int, ...]  # numbers
    segment: int
    left_out: dict[str, int]  # how many, by reason


def trusted(run: TrackedRun, weak: bool = False) -> Chosen:
    """The frames whose poses can be believed: status ok, or weak too if wanted, of one segment.

    Poses of different segments do not fit together, so the one with the most such frames is taken. Its first frame
    belongs to it though its status is lost, which says that nothing leads there from the segment before.
    Raises IdRgbdoError where there is none.
    """
    believed = (Status.OK.value, Status.WEAK.value) if weak else (Status.OK.value,)
    good = np.zeros(len(run.rows), np.bool_)
    for number, row in enumerate(run.rows):
        begins = row["status"] == Status.LOST.value and row["keyframe"] == "1"
        good[number] = (row["status"] in believed or begins) and not np.isnan(run.T_world_cam[number, 0, 0])
    if not good.any():
        raise IdRgbdoError(f"run: no frame of '{run.folder}' has a pose that can be believed; see its report.html")
    counts = np.bincount(run.segments[good])
    largest = int(counts.argmax())
    rest = [row["status"] for row, taken in zip(run.rows, good, strict=True) if not taken]
    left_out = {status.value: rest.count(status.value) for status in (Status.LOST, Status.WEAK)}
    left_out["in another segment"] = int(counts.sum() - counts[largest])
    frames = np.flatnonzero(good & (run.segments == largest)).tolist()
    return Chosen(tuple(frames), largest, {reason: count for reason, count in left_out.items() if count})


def thinned(frames: Sequence[int], every: int, read: Read | None = None) -> list[int]:
    """One of each `every` frames in a row: the first; or the sharpest, where they can be read."""
    groups = [frames[k : k + every] for k in range(0, len(frames), every)]
    if read is None or every == 1:
        return [group[0] for group in groups]
    return [max(group, key=lambda number: sharpness(read(number))) for group in groups]


def sharpness(frame: RgbdFrame | BrokenFrame) -> float:
    """Variance of the Laplacian, gray levels^2: smaller where the same view is smeared. -1 where it cannot be read."""
    if isinstance(frame, BrokenFrame):
        return -1.0
    return float(cv2.Laplacian(frame.gray.numpy(), cv2.CV_32F).var())
