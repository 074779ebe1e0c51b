"""Which frames are handed on: those with a pose that can be believed, of one segment, thinned, the sharpest."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from rendered import Film

from idrgbdo_torch.commands.cli import main
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.export.tracked import load_run, thinned, trusted
from idrgbdo_torch.frame import BrokenFrame, RgbdFrame
from idrgbdo_torch.tracker.results import joined, joins
from idrgbdo_torch.trajectory import read_tum

Statuses = dict[int, tuple[str, str]]  # by frame: status, segment


def edited(run: Path, folder: Path, statuses: Statuses) -> Path:
    """A copy of a run with other statuses."""
    shutil.copytree(run, folder)
    with (run / "frames.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    for number, (status, segment) in statuses.items():
        rows[number].update(status=status, segment=segment)
    with (folder / "frames.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return folder


def test_lost_and_weak_frames_are_left_out_and_counted(
    tracked: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    statuses = {7: ("lost", "0"), 8: ("lost", "0"), 9: ("weak", "0")}
    run = edited(tracked, tmp_path / "run", statuses)
    chosen = trusted(load_run(run))
    assert set(range(40)) - set(chosen.frames) == {7, 8, 9}
    assert chosen.left_out == {"lost": 2, "weak": 1}
    assert trusted(load_run(run), weak=True).left_out == {"lost": 2}
    assert main(["export", str(run), "--to", "evo", "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "37 of 40" in said and "2 lost, 1 weak" in said
    times = read_tum(tmp_path / "out" / "estimate.tum").timestamps
    assert len(times) == 37 and not torch.isin(read_tum(run / "trajectory.txt").timestamps[7:10], times).any()


def test_only_the_largest_segment_is_taken(tracked: Path, tmp_path: Path) -> None:
    keyframe = [number for number, row in enumerate(load_run(tracked).rows) if row["keyframe"] == "1"][2]
    after = {number: ("ok", "1") for number in range(keyframe + 1, 40)}
    run = load_run(edited(tracked, tmp_path / "run", {keyframe: ("lost", "1"), **after}))
    chosen = trusted(run)
    parts = {0: tuple(range(keyframe)), 1: tuple(range(keyframe, 40))}  # a segment's first frame is where it begins
    assert chosen.frames == max(parts.values(), key=len)
    assert chosen.left_out["in another segment"] == min(map(len, parts.values()))


def test_segments_that_joined_are_one(tracked: Path, tmp_path: Path) -> None:
    """Numbers are given again: the second segment 1 is another one."""
    assert joined(joins(12, 3, 0.1)) == (12, 3) and joined("found again in the keyframe of 1.000 s") is None
    spans = {(12, 20): "1", (20, 22): "0", (22, 30): "1", (30, 40): "1"}
    segments = {n: ("ok", segment) for (first, last), segment in spans.items() for n in range(first, last)}
    folder = edited(tracked, tmp_path / "run", segments)
    lines = (folder / "frames.csv").read_text().splitlines()
    cells = lines[21].split(",")
    cells[1:3] = ["weak", f'"{joins(1, 0, 0.1)}"']
    lines[21] = ",".join(cells)
    (folder / "frames.csv").write_text("\n".join(lines) + "\n")
    assert load_run(folder).segments.tolist() == [0] * 22 + [1] * 18
    chosen = trusted(load_run(folder))
    assert (chosen.segment, chosen.frames) == (0, (*range(20), 21))
    assert chosen.left_out == {"weak": 1, "in another segment": 18}
    assert load_run(folder, refined=False).segments.tolist() == [0] * 12 + [1] * 8 + [0] * 2 + [1] * 18


def test_a_frame_that_could_not_be_read_has_no_pose(tracked: Path, tmp_path: Path) -> None:
    """Odometries never see such a frame, so that the refined poses lack it."""
    folder = edited(tracked, tmp_path / "run", {5: ("lost", "0")})
    lines = (folder / "trajectory_refined.txt").read_text().splitlines(keepends=True)
    (folder / "trajectory_refined.txt").write_text("".join(lines[:6] + lines[7:]))
    run = load_run(folder)
    assert np.isnan(run.T_world_cam[5]).all() and not np.isnan(np.delete(run.T_world_cam, 5, axis=0)).any()
    assert 5 not in trusted(run).frames
    (folder / "frames.csv").write_bytes((tracked / "frames.csv").read_bytes())
    with pytest.raises(IdRgbdoError, match="frames without a pose that were not lost"):
        load_run(folder)


def test_a_run_without_any_pose_is_an_error(tracked: Path, tmp_path: Path) -> None:
    run = edited(tracked, tmp_path / "run", {number: ("lost", "0") for number in range(40)})
    rows = (run / "frames.csv").read_text().replace(",1,", ",0,")
    (run / "frames.csv").write_text(rows)
    with pytest.raises(IdRgbdoError, match=r"no frame of '.*' has a pose that can be believed"):
        trusted(load_run(run))


def test_one_of_a_group_is_the_first_or_the_sharpest(desk: Film) -> None:
    def read(number: int) -> RgbdFrame | BrokenFrame:
        if number in (0, 7):
            return BrokenFrame(0.0, "gone")
        frame = desk.frames[10]
        blur = {5: 1.0, 9: 1.0}.get(number, 3.0)
        gray = torch.from_numpy(cv2.GaussianBlur(frame.gray.numpy(), (0, 0), blur))
        return RgbdFrame(0.0, gray, frame.depth, frame.camera)

    frames = [0, 1, 4, 5, 6, 7, 8, 9, 20]
    assert thinned(frames, 3) == [0, 5, 8]
    assert thinned(frames, 4, read) == [5, 9, 20]
    assert thinned(frames, 1, read) == frames


def test_kitti_has_twelve_numbers_a_frame(tracked: Path, tmp_path: Path) -> None:
    assert main(["export", str(tracked), "--to", "kitti", "--out", str(tmp_path), "--every", "2"]) == 0
    poses = np.loadtxt(tmp_path / "poses.txt").reshape(-1, 3, 4)
    np.testing.assert_allclose(poses, load_run(tracked).T_world_cam[::2, :3], atol=1e-8)
    assert len(np.loadtxt(tmp_path / "times.txt")) == 20


def test_points_and_cameras_can_be_looked_at(tracked: Path, tmp_path: Path) -> None:
    from idrgbdo_torch.tracker.open3d_loader import load_open3d

    assert main(["export", str(tracked), "--to", "ply", "--out", str(tmp_path)]) == 0
    o3d = load_open3d()
    points = o3d.io.read_point_cloud(str(tmp_path / "points.ply"))
    assert len(points.points) > 1500 and points.has_colors() and points.has_normals()
    cameras = o3d.io.read_line_set(str(tmp_path / "cameras.ply"))
    assert (len(cameras.points), len(cameras.lines)) == (5 * 40, 8 * 40 + 39)
    np.testing.assert_allclose(np.asarray(cameras.points)[::5], load_run(tracked).T_world_cam[:, :3, 3], atol=1e-5)


def test_what_does_not_fit_is_one_line(tracked: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty").mkdir()
    assert main(["export", str(tmp_path / "empty"), "--to", "evo"]) == 1
    assert "pass the folder of a run" in capsys.readouterr().err
    assert main(["export", str(tracked), "--to", "ros1", "--out", str(tmp_path / "a.mcap")]) == 1
    assert "end it with .bag for ROS 1" in capsys.readouterr().err
    run = edited(tracked, tmp_path / "run", {})
    (run / "map.ply").unlink()
    assert main(["export", str(run), "--to", "colmap"]) == 1
    assert "run again with --map points" in capsys.readouterr().err
