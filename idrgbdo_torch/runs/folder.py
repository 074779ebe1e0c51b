"""What a run leaves behind: a folder that is valid whenever the run stops."""

from __future__ import annotations

import contextlib
import csv
import json
import os
from datetime import datetime
from pathlib import Path
from statistics import fmean, median
from typing import IO, Any, Self

import numpy as np
import torch
from torch import Tensor

from ..errors import IdRgbdoError
from ..evaluation import Evaluation, Measurement
from ..odometry import Odometry, Record, Run, Status
from ..tracker.inspection import Inspectable
from ..tracker.mapping import write_ply
from ..trajectory import TUM_HEADER, Trajectory, nearest, read_tum, tum_line, write_tum
from . import certainty

DEGREES_OF_FREEDOM = ("vx", "vy", "vz", "wx", "wy", "wz")
UPPER = [(row, column) for row in range(6) for column in range(row, 6)]
COLUMNS = (
    *("timestamp", "status", "reason", "keyframe", "reference_time", "segment", "points", "iterations"),
    *("decode_ms", "ms"),
    *(f"entropy_{name}_bits" for name in DEGREES_OF_FREEDOM),
    *(f"information_{DEGREES_OF_FREEDOM[row]}_{DEGREES_OF_FREEDOM[column]}" for row, column in UPPER),
    *certainty.COLUMNS,
)
OWN_FILES = ("trajectory.txt", "trajectory_refined.txt", "keyframes.txt", "frames.csv", "config.toml", "summary.json")


class RunFolder:
    """Writes trajectory.txt, keyframes.txt and frames.csv as frames come, and the rest at the end."""

    def __init__(self, path: Path, config_toml: str = "") -> None:
        """Make the folder, with the resolved configuration in it; files of an earlier run there are replaced.

        Raises IdRgbdoError where the folder cannot be written.
        """
        self.path = path
        self._certainty = certainty.Certainty()
        try:
            path.mkdir(parents=True, exist_ok=True)
            for name in (*OWN_FILES, "map.ply", "mesh.ply"):
                (path / name).unlink(missing_ok=True)
            (path / "config.toml").write_text(config_toml, encoding="utf-8")
            self._trajectory, self._keyframes, self._frames = (
                (path / name).open("w", encoding="utf-8", newline="")
                for name in ("trajectory.txt", "keyframes.txt", "frames.csv")
            )
        except OSError as error:
            raise IdRgbdoError(f"out: cannot write '{path}': {error.strerror}; pass another --out") from error
        for file in (self._trajectory, self._keyframes):
            _append(file, TUM_HEADER)
        self._rows = csv.writer(self._frames, lineterminator="\n")
        self._rows.writerow(COLUMNS)
        self._frames.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for file in (self._trajectory, self._keyframes, self._frames):
            file.close()

    def append(self, record: Record) -> None:
        """Write one frame, flushed to the system at once."""
        line = tum_line(record.timestamp, record.result.T_world_cam)
        _append(self._trajectory, line)
        if record.result.keyframe:
            _append(self._keyframes, line)
        self._rows.writerow([*_row(record), *self._certainty.cells(record)])
        self._frames.flush()

    def finish(
        self, run: Run, odometry: Odometry, evaluation: Evaluation | None = None, with_map: bool = True
    ) -> dict[str, Any]:
        """Write the refined trajectory and keyframes, the map where there is one, and the summary; returns the latter.

        trajectory_refined.txt is only written where the odometry changed a pose after its frame.
        """
        refined = odometry.trajectory()
        if is_refined(refined, run):
            write_tum(self.path / "trajectory_refined.txt", refined)
            times = [record.timestamp for record in run.records if record.result.keyframe]
            if times:
                self._keyframes.close()
                write_tum(self.path / "keyframes.part", refined.at(_indices(refined, times)))
                (self.path / "keyframes.part").replace(self.path / "keyframes.txt")
        if with_map and isinstance(odometry, Inspectable):
            for segment, cloud in odometry.maps().items():
                write_ply(self.path / map_name(segment), cloud)
        summary = summarise(run, evaluation)
        (self.path / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
        return summary


def map_name(segment: int) -> str:
    """The file of a segment's points; the first one's is the map."""
    return f"map_segment_{segment}.ply" if segment else "map.ply"


def believable(trajectory: Trajectory, run: Run) -> Trajectory:
    """An odometry's trajectory without the frames that were lost."""
    lost = torch.tensor([status is Status.LOST for status in run.statuses])
    return trajectory.at(~lost[_indices(run.trajectory(), trajectory.timestamps.tolist())])


def run_trajectory(folder: Path) -> Trajectory:
    """The poses of a finished run, refined where there are such, without the frames that were lost.

    Raises IdRgbdoError for a folder that is not a run's.
    """
    refined, causal = folder / "trajectory_refined.txt", folder / "trajectory.txt"
    trajectory = read_tum(refined if refined.exists() else causal)
    try:
        with (folder / "frames.csv").open(newline="", encoding="utf-8") as file:
            lost = [float(row["timestamp"]) for row in csv.DictReader(file) if row["status"] == Status.LOST.value]
    except OSError as error:
        raise IdRgbdoError(
            f"poses: cannot read '{error.filename}': {error.strerror}; pass the folder of a run"
        ) from error
    gone = torch.isin(trajectory.timestamps, torch.tensor(lost, dtype=torch.float64))
    return trajectory.at(~gone)


def is_refined(trajectory: Trajectory, run: Run) -> bool:
    """Whether an odometry's trajectory differs from the poses it gave when the frames came."""
    if len(trajectory) == 0:
        return False
    causal = run.trajectory()
    return not torch.equal(trajectory.T_world_cam, causal.T_world_cam[_indices(causal, trajectory.timestamps.tolist())])


def summarise(run: Run, evaluation: Evaluation | None = None) -> dict[str, Any]:
    """The contents of summary.json. Times are of track() alone (decode_median apart), null where nothing was timed.

    frames_per_second is 1000 over mean_per_frame: what the odometry could keep up with, decoding left out.
    """
    track_ms = [record.track_ms for record in run.records if record.track_ms is not None]
    keyframe_ms = [r.track_ms for r in run.records if r.result.keyframe and r.track_ms is not None]
    mean_ms = fmean(track_ms) if track_ms else None
    lost = run.statuses.count(Status.LOST)
    summary: dict[str, Any] = {
        "frames": len(run.records),
        "tracked": len(run.records) - lost,
        "lost": lost,
        "keyframes": len(keyframe_ms),
        "path_length_m": run.trajectory().path_length_m(),
        "timing_ms": {
            "decode_median": median(record.decode_ms for record in run.records) if run.records else None,
            "track_median": median(track_ms) if track_ms else None,
            "track_p95": float(np.percentile(track_ms, 95)) if track_ms else None,
            "keyframe_median": median(keyframe_ms) if keyframe_ms else None,
            "mean_per_frame": mean_ms,
        },
        "frames_per_second": 1000 / mean_ms if mean_ms else None,
    }
    if evaluation is not None:
        rpe, k2fe = evaluation.rpe, evaluation.k2fe
        summary["evaluation"] = {
            "ate_rmse_m": evaluation.ate.rmse_m,
            "rpe_rmse_m_per_s": rpe.rmse_m_per_s if rpe else None,
            "k2fe_mean_m": k2fe.mean_m if k2fe else None,
            "k2fe_sum_m": k2fe.sum_m if k2fe else None,
        }
        summary["matched_poses"] = evaluation.matched_poses
        T_groundtruth_estimate = evaluation.ate.T_reference_estimate.tolist()
        summary["alignment"] = {"kind": "SE(3), no scale", "T_groundtruth_estimate": T_groundtruth_estimate}
    return summary


def measurements(run: Run) -> list[Measurement]:
    """The frames' poses against their keyframes, for the keyframe-to-frame error."""
    results = [(record.timestamp, record.result) for record in run.records]
    return [
        Measurement(timestamp, result.reference_time, result.T_ref_cam)
        for timestamp, result in results
        if result.reference_time is not None and result.T_ref_cam is not None and result.status is not Status.LOST
    ]


def default_folder(sequence: str, now: datetime, root: Path = Path("runs")) -> Path:
    """A new folder root/<sequence>/<time>, with the link `latest` beside it pointing there."""
    parent, stamp = root / sequence, now.strftime("%Y-%m-%d_%H-%M-%S")
    name, count = stamp, 1
    while (parent / name).exists():
        count += 1
        name = f"{stamp}_{count}"
    try:
        (parent / name).mkdir(parents=True)
    except OSError as error:
        raise IdRgbdoError(f"out: cannot make '{parent / name}': {error.strerror}; pass --out DIR") from error
    with contextlib.suppress(OSError):  # a file system without links
        link = parent / f".latest_{os.getpid()}"
        link.symlink_to(name, target_is_directory=True)
        link.replace(parent / "latest")
    return parent / name


def _indices(trajectory: Trajectory, times: list[float]) -> Tensor:
    """The indices of the poses nearest to the given times (s)."""
    return nearest(trajectory.timestamps, torch.tensor(times, dtype=torch.float64))


def _append(file: IO[str], line: str) -> None:
    file.write(line)
    file.flush()


def _row(record: Record) -> list[str]:
    """The first cells of frames.csv in the order of COLUMNS; empty where there is no value."""
    result = record.result
    information = result.information
    entropy = [f"{bits:.4f}" for bits in result.entropy_bits] or [""] * 6
    return [
        f"{record.timestamp:.6f}",
        result.status.value,
        result.reason,
        str(int(result.keyframe)),
        "" if result.reference_time is None else f"{result.reference_time:.6f}",
        str(result.segment),
        str(result.points),
        str(result.iterations),
        f"{record.decode_ms:.3f}",
        "" if record.track_ms is None else f"{record.track_ms:.3f}",
        *entropy,
        *("" if information is None else f"{float(information[row, column]):.9g}" for row, column in UPPER),
    ]
