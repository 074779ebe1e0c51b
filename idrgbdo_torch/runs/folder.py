"""What a run leaves behind: a folder that is valid whenever the run stops."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import os
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path
from statistics import fmean, median
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor

from .. import __version__
from ..errors import IdRgbdoError
from ..evaluation import Evaluation, Measurement
from ..odometry import Odometry, Record, Run, Status, lost_because
from ..text.files import damage_named, read_table
from ..tracker.camera_estimate import CameraEstimate
from ..tracker.inspection import Inspectable
from ..tracker.mapping import ply_bytes
from ..trajectory import TUM_HEADER, Trajectory, in_time, nearest, read_tum, tum_line, tum_text
from . import certainty
from .machine import machine_name
from .own import clear, found, refuse_others
from .source import Reading
from .writing import Lines, cannot_write, lock, write_whole

DEGREES_OF_FREEDOM = ("vx", "vy", "vz", "wx", "wy", "wz")
UPPER = [(row, column) for row in range(6) for column in range(row, 6)]
COLUMNS = (
    *("timestamp", "status", "reason", "keyframe", "reference_time", "segment", "points", "iterations"),
    *("decode_ms", "ms"),
    *(f"entropy_{name}_bits" for name in DEGREES_OF_FREEDOM),
    *(f"information_{DEGREES_OF_FREEDOM[row]}_{DEGREES_OF_FREEDOM[column]}" for row, column in UPPER),
    *certainty.COLUMNS,
)
HEADINGS = {"frames.csv": ",".join(COLUMNS) + "\n", "trajectory.txt": TUM_HEADER, "keyframes.txt": TUM_HEADER}


class RunFolder:
    """Writes trajectory.txt, keyframes.txt and frames.csv as frames come, and the rest at the end.

    One process at a time: the folder is locked until it is closed. When the disk is full a frame stands in all three
    files or in none.
    """

    def __init__(
        self, path: Path, config_toml: str = "", resumed: bool = False, reading: Reading | None = None
    ) -> None:
        """Make the folder. What an earlier run left there goes with the first frame, not before.

        config_toml, reading: what it leaves of settings and recording. resumed: the earlier run is continued, so its
        checkpoint and its figures stay.
        Raises IdRgbdoError where the folder cannot be written, has others' files that a run would replace, or another
        run is writing to it.
        """
        self.path = path
        self._certainty = certainty.Certainty()
        self._config_toml, self._resumed, self._reading = config_toml, resumed, reading
        self._begun = False
        self._files: list[Lines] = []
        try:
            path.mkdir(parents=True, exist_ok=True)
            if not resumed:
                refuse_others(path)
            self._lock = lock(path)
            self._earlier = bool(found(path))
        except OSError as error:
            raise cannot_write(Path(error.filename or path), error) from error

    def _begin(self) -> None:
        """Put this run's files in the place of an earlier one's; first what marks the folder as that of a run."""
        for file in self._files:  # what did not fit before
            file.close()
        try:
            clear(self.path, self._resumed)
            self._files = [Lines(self.path / name) for name in HEADINGS]
        except OSError as error:
            raise cannot_write(Path(error.filename or self.path), error) from error
        for file, heading in zip(self._files, HEADINGS.values(), strict=True):
            file.append(heading)
        self._frames, self._trajectory, self._keyframes = self._files
        write_whole(self.path / "config.toml", self._config_toml)
        if self._reading:
            self._reading.remember(self.path)
        self._begun = True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for file in self._files:
            file.close()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def append(self, record: Record) -> None:
        """Write one frame, handed to the system at once. Raises IdRgbdoError where it does not fit."""
        if not self._begun:
            self._begin()
        line = tum_line(record.timestamp, record.result.T_world_cam)
        sizes = [file.size for file in self._files]
        try:
            self._trajectory.append(line)
            if record.result.keyframe:
                self._keyframes.append(line)
            self._frames.append(_csv_line(row_of(record, self._certainty).values()))
        except IdRgbdoError:
            for file, size in zip(self._files, sizes, strict=True):
                file.cut(size)
            raise

    def finish(
        self, run: Run, odometry: Odometry, evaluation: Evaluation | None = None, with_map: bool = True,
        camera: CameraEstimate | None = None,
    ) -> dict[str, Any]:  # fmt: skip
        """Write the refined trajectory and keyframes, the map where there is one, and the summary; returns the latter.

        trajectory_refined.txt is only written where the odometry changed a pose after its frame. A run without a frame
        leaves the results of an earlier one as they are.
        """
        summary = summarise(run, evaluation) | ({"camera": camera.as_dict()} if camera else {})
        if not self._begun:
            if self._earlier:
                return summary
            self._begin()
        refined = odometry.trajectory()
        if is_refined(refined, run):
            write_whole(self.path / "trajectory_refined.txt", tum_text(refined))
            times = sorted({record.timestamp for record in run.records if record.result.keyframe})
            if times:
                self._keyframes.close()
                write_whole(self.path / "keyframes.txt", tum_text(refined.at(_indices(refined, times))))
        if with_map and isinstance(odometry, Inspectable):
            for segment, cloud in odometry.maps().items():
                write_whole(self.path / map_name(segment), ply_bytes(cloud))
        write_whole(self.path / "summary.json", json.dumps(summary, indent=2) + "\n")
        return summary


def map_name(segment: int) -> str:
    """The file of a segment's points; the first one's is the map."""
    return f"map_segment_{segment}.ply" if segment else "map.ply"


def believable(trajectory: Trajectory, run: Run) -> Trajectory:
    """An odometry's trajectory without the frames that were lost."""
    lost = torch.tensor([status is Status.LOST for status in run.statuses])[in_time(run.timestamps)]
    return trajectory.at(~lost[_indices(run.trajectory(), trajectory.timestamps.tolist())])


def run_trajectory(folder: Path) -> Trajectory:
    """The poses of a finished run, refined where there are such, without the frames that were lost.

    Raises IdRgbdoError for a folder that is not a run's.
    """
    refined, causal = folder / "trajectory_refined.txt", folder / "trajectory.txt"
    trajectory = read_tum(refined if refined.exists() else causal)
    rows = read_table(folder / "frames.csv", ("timestamp", "status"), "poses")
    with damage_named(str(folder / "frames.csv"), "the rows of a run", "run again"):
        lost = [float(row["timestamp"]) for row in rows if row["status"] == Status.LOST.value]
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
        "version": __version__,
        "machine": machine_name(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "frames": len(run.records),
        "tracked": len(run.records) - lost,
        "weak": run.statuses.count(Status.WEAK),
        "lost": lost,
        "lost_because": lost_because(run.records),
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
    return summary if evaluation is None else summary | evaluation_summary(evaluation)


def evaluation_summary(evaluation: Evaluation) -> dict[str, Any]:
    """The errors as summary.json has them."""
    rpe, k2fe = evaluation.rpe, evaluation.k2fe
    errors = {
        "ate_rmse_m": evaluation.ate.rmse_m,
        "rpe_rmse_m_per_s": rpe.rmse_m_per_s if rpe else None,
        "rpe_rmse_deg_per_s": rpe.rmse_deg_per_s if rpe else None,
        "rpe_pairs": len(rpe.errors_m) if rpe else 0,
        "k2fe_mean_m": k2fe.mean_m if k2fe else None,
        "k2fe_sum_m": k2fe.sum_m if k2fe else None,
    }
    T_groundtruth_estimate = evaluation.ate.T_reference_estimate.tolist()
    return {
        "evaluation": errors,
        "matched_poses": evaluation.matched_poses,
        "alignment": {"kind": "SE(3), no scale", "T_groundtruth_estimate": T_groundtruth_estimate},
    }


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
    try:
        parent.mkdir(parents=True, exist_ok=True)
        while True:
            try:
                (parent / name).mkdir()  # another run may take the same name at the same time
                break
            except FileExistsError:
                count += 1
                name = f"{stamp}_{count}"
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


def _csv_line(cells: Iterable[str]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(cells)
    return text.getvalue()


def row_of(record: Record, follower: certainty.Certainty) -> dict[str, str]:
    """The next row of frames.csv by its columns."""
    return dict(zip(COLUMNS, [*_row(record), *follower.cells(record)], strict=True))


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
