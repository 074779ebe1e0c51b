"""The folder of a run: its files, their columns and keys, and that they are valid whenever it stops."""

from __future__ import annotations

import csv
import json
import tomllib
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
import torch
from inspected import Inspected
from rendered import Film
from run_records import RUN

from idrgbdo_torch import __version__
from idrgbdo_torch.config import Config
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.evaluation import evaluate
from idrgbdo_torch.odometry import ConstantVelocity, Run, run
from idrgbdo_torch.runs.folder import COLUMNS, RunFolder, default_folder, measurements, summarise
from idrgbdo_torch.text import configfile
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo
from idrgbdo_torch.tracker.mapping import Cloud
from idrgbdo_torch.trajectory import Trajectory, read_tum


class Refining(Inspected):
    """Ends with its poses shifted by 1 m, and with a map."""

    def trajectory(self) -> Trajectory:
        causal = RUN.trajectory()
        moved = causal.T_world_cam.clone()
        moved[:, 2, 3] += 1.0
        return Trajectory(causal.timestamps, moved)

    def maps(self) -> dict[int, Cloud]:
        rgb = np.array([[255, 0, 7], [1, 2, 3]], np.uint8)
        return {0: Cloud(np.array([[0.5, -1, 2], [0, 0, 1]], np.float32), rgb, np.zeros((2, 3), np.float32))}


def test_what_is_written_frame_by_frame_is_there_at_once(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "run", configfile.dump(Config()))
    for count, each in enumerate(RUN.records, start=1):
        folder.append(each)
        trajectory = read_tum(tmp_path / "run" / "trajectory.txt")  # while the run goes on
        assert len(trajectory) == count
        with (tmp_path / "run" / "frames.csv").open(newline="") as file:
            assert len(list(csv.DictReader(file))) == count
    torch.testing.assert_close(trajectory.T_world_cam, RUN.trajectory().T_world_cam, rtol=0, atol=1e-8)
    assert read_tum(tmp_path / "run" / "keyframes.txt").timestamps.tolist() == [0, 3]
    assert tomllib.loads((tmp_path / "run" / "config.toml").read_text())["selection"]["points"] == 24


def test_a_row_of_frames_csv(tmp_path: Path) -> None:
    with RunFolder(tmp_path) as folder:
        for each in RUN.records:
            folder.append(each)
    with (tmp_path / "frames.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == COLUMNS
    assert sum(name.startswith("information_") for name in COLUMNS) == 21
    row = rows[4]
    assert (row["timestamp"], row["status"], row["reason"], row["keyframe"], row["ms"]) == (
        "4.000000",
        "lost",
        "too few points",
        "0",
        "",
    )
    assert (row["reference_time"], row["points"], row["iterations"], row["segment"]) == ("3.000000", "24", "7", "0")
    assert float(row["entropy_wz_bits"]) == 6.5
    assert float(row["information_vx_wz"]) == 5 + 30
    assert float(row["information_wy_wy"]) == 28 * 2


def test_summary_has_exactly_the_documented_keys() -> None:
    summary = summarise(RUN)
    assert list(summary) == [
        *("version", "machine", "date", "frames", "tracked", "weak", "lost", "lost_because", "keyframes"),
        *("path_length_m", "timing_ms", "frames_per_second"),
    ]
    assert (summary["frames"], summary["tracked"], summary["lost"], summary["keyframes"]) == (5, 4, 1, 2)
    assert (summary["version"], summary["weak"], summary["lost_because"]) == (__version__, 1, {"too few points": 1})
    timing = {
        "decode_median": 2,
        "track_median": 6,
        "track_p95": 18.05,
        "keyframe_median": 12.5,
        "mean_per_frame": 9.25,
    }
    assert summary["timing_ms"] == pytest.approx(timing)
    assert summary["frames_per_second"] == pytest.approx(1000 / 9.25)
    evaluated = summarise(RUN, evaluate(RUN.trajectory(), RUN.trajectory(), measurements(RUN)))
    assert list(evaluated)[12:] == ["evaluation", "matched_poses", "alignment"]
    assert list(evaluated["evaluation"]) == [
        *("ate_rmse_m", "rpe_rmse_m_per_s", "rpe_rmse_deg_per_s", "rpe_pairs", "k2fe_mean_m", "k2fe_sum_m"),
    ]
    assert evaluated["matched_poses"] == 5
    json.dumps(evaluated, allow_nan=False)


def test_an_empty_run_has_a_summary() -> None:
    summary = summarise(Run("none", ()))
    assert (summary["frames"], summary["path_length_m"], summary["timing_ms"]["track_median"]) == (0, 0, None)


def test_lost_frames_do_not_count_as_measurements() -> None:
    assert [m.timestamp for m in measurements(RUN)] == [1, 2, 3]


def test_finish_writes_the_refined_poses_the_map_and_the_summary(tmp_path: Path) -> None:
    with RunFolder(tmp_path) as folder:
        for each in RUN.records:
            folder.append(each)
        summary = folder.finish(RUN, Refining())
    refined = read_tum(tmp_path / "trajectory_refined.txt")
    torch.testing.assert_close(refined.positions[:, 2], RUN.trajectory().positions[:, 2] + 1, rtol=0, atol=1e-8)
    keyframes = read_tum(tmp_path / "keyframes.txt")
    assert keyframes.timestamps.tolist() == [0, 3]
    torch.testing.assert_close(keyframes.T_world_cam, refined.T_world_cam[[0, 3]])
    assert json.loads((tmp_path / "summary.json").read_text()) == summary
    assert (tmp_path / "map.ply").read_bytes().startswith(b"ply\n")
    assert not list(tmp_path.glob("*.part"))


def test_a_method_that_refines_nothing_gets_no_refined_file(tmp_path: Path) -> None:
    odometry = ConstantVelocity()
    with RunFolder(tmp_path) as folder:
        folder.finish(Run("none", ()), odometry)
    assert not (tmp_path / "trajectory_refined.txt").exists()
    assert not (tmp_path / "map.ply").exists()


def test_results_of_an_earlier_run_are_replaced_and_other_files_kept(tmp_path: Path) -> None:
    with RunFolder(tmp_path) as folder:
        folder.append(RUN.records[0])
    for name in ("summary.json", "map.ply", "trajectory_refined.txt", "notes.txt"):
        (tmp_path / name).write_text("old")
    with RunFolder(tmp_path) as folder:
        folder.append(RUN.records[0])
        assert sorted(path.name for path in tmp_path.iterdir()) == [
            *("config.toml", "frames.csv", "keyframes.txt", "notes.txt", "trajectory.txt"),
        ]


def test_a_folder_that_cannot_be_made_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(IdRgbdoError, match=r"out: cannot write '.*file/run'"):
        RunFolder(tmp_path / "file" / "run")


def test_default_folders_never_collide_and_latest_points_to_the_newest(tmp_path: Path) -> None:
    now = datetime(2026, 3, 1, 14, 5, 33)
    first, second = (default_folder("desk", now, tmp_path) for _ in range(2))
    assert first == tmp_path / "desk" / "2026-03-01_14-05-33"
    assert second == tmp_path / "desk" / "2026-03-01_14-05-33_2"
    assert (tmp_path / "desk" / "latest").resolve() == second.resolve()
    assert sorted(path.name for path in (tmp_path / "desk").iterdir()) == [first.name, second.name, "latest"]


def test_the_map_has_the_points_of_every_keyframe(desk: Film, tmp_path: Path) -> None:
    """Those of the keyframes that are still in the window too."""
    odometry = IdRgbdo()
    with RunFolder(tmp_path / "run") as folder:
        done = run(odometry, desk.frames[:16], folder.append)
        folder.finish(done, odometry)
    assert sum(record.result.keyframe for record in done.records) > 2
    header = (tmp_path / "run" / "map.ply").read_bytes().split(b"end_header")[0]
    vertices = int(header.split(b"element vertex ")[1].split()[0])
    assert vertices == len(odometry.map_points()[0]) > 500
