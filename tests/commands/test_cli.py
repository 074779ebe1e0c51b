"""The command as a user meets it: help, flags, results, known errors, interruption."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from idrgbdo_torch.commands import demo, track
from idrgbdo_torch.commands.cli import RunCommand, main, parse
from idrgbdo_torch.config import Config
from idrgbdo_torch.definitions import se3
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.odometry import ConstantVelocity, Odometry, Status, TrackResult
from idrgbdo_torch.trajectory import Trajectory, read_tum, write_tum

Make = Callable[..., Path]
SLOW_RUN = """
import sys, time
from idrgbdo_torch.commands import track
from idrgbdo_torch.commands.cli import main
from idrgbdo_torch.odometry import ConstantVelocity

class Slow(ConstantVelocity):
    def track(self, frame):
        time.sleep(0.05)
        return super().track(frame)

track.make_odometry = lambda config: Slow()
sys.exit(main(sys.argv[1:]))
"""


@pytest.fixture
def null_method(monkeypatch: pytest.MonkeyPatch) -> None:
    """The command runs the null baseline, so that tiny pictures of noise do."""

    def make_odometry(config: Config) -> Odometry:
        return ConstantVelocity()

    monkeypatch.setattr(track, "make_odometry", make_odometry)


def test_help_imports_nothing_heavy_and_is_quick() -> None:
    script = (
        "import linecache, sys, time; begin = time.process_time(); from idrgbdo_torch.commands.cli import main\n"
        "try: main(['--help'])\n"
        "except SystemExit as end: assert end.code == 0\n"
        "heavy = {'torch', 'open3d', 'numpy', 'cv2', 'numba', 'rich', 'plotly'} & set(sys.modules)\n"
        "heavy |= {name for name in linecache.cache if name.endswith('typing.py')}  # its source, looked through\n"
        "print('HEAVY', sorted(heavy), 'SECONDS', time.process_time() - begin)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert "HEAVY [] SECONDS" in done.stdout
    assert float(done.stdout.split()[-1]) < 0.4
    for name in ("run", "evaluate", "synth", "demo"):
        assert name in done.stdout


def test_every_configuration_field_is_a_flag(tmp_path: Path) -> None:
    flags = ["--selection.points", "256", "--selection.mode", "rand", "--window.enabled", "false", "--seed", "5"]
    command = parse(["run", "somewhere", *flags])
    assert isinstance(command, RunCommand)
    settings = command.settings
    assert (settings.selection.points, settings.selection.mode, settings.seed) == (256, "rand", 5)
    assert settings.window.enabled is False
    command = parse(["run", "somewhere", "--window.enabled=true"])
    assert isinstance(command, RunCommand)
    assert command.settings == Config()


def test_flags_override_the_configuration_file(tmp_path: Path) -> None:
    (tmp_path / "some.toml").write_text("seed = 3\n[selection]\npoints = 100\nmode = 'grid'\n")
    for flag in (["--config", str(tmp_path / "some.toml")], [f"--config={tmp_path / 'some.toml'}"]):
        command = parse(["run", "somewhere", *flag, "--selection.points", "50"])
        assert isinstance(command, RunCommand)
        selection = command.settings.selection
        assert (command.settings.seed, selection.points, selection.mode) == (3, 50, "grid")


def test_run_writes_its_folder_and_ends_with_the_table(
    make_recording: Make, tmp_path: Path, null_method: None, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert (
        main(["run", str(make_recording(frames=6)), "--out", str(out), "--selection.points", "33", "--every", "2"]) == 0
    )
    assert len(read_tum(out / "trajectory.txt")) == 3
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["frames"], summary["tracked"], summary["matched_poses"]) == (3, 3, 3)
    assert tomllib.loads((out / "config.toml").read_text())["selection"]["points"] == 33
    shown = capsys.readouterr()
    for word in (
        "frames",
        "tracked",
        "lost",
        "keyframes",
        "path length",
        "ms",
        "frames per second",
        "ATE",
        "RPE",
        str(out),
    ):
        assert word in shown.out
    assert "\x1b" not in shown.out
    assert shown.err == ""


def test_without_out_the_results_go_to_runs(
    make_recording: Make, tmp_path: Path, null_method: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["run", str(make_recording("desk", groundtruth=False))]) == 0
    assert (tmp_path / "runs" / "desk" / "latest" / "summary.json").exists()
    assert "evaluation" not in json.loads((tmp_path / "runs" / "desk" / "latest" / "summary.json").read_text())


def test_two_frames_cannot_be_evaluated_but_do_run(
    make_recording: Make, tmp_path: Path, null_method: None, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", str(make_recording(frames=2)), "--out", str(tmp_path / "out")]) == 0
    assert "not evaluated" in capsys.readouterr().out


def test_a_truncated_image_in_the_middle_loses_that_frame(
    make_recording: Make, tmp_path: Path, null_method: None
) -> None:
    folder = make_recording()
    path = sorted((folder / "rgb").iterdir())[2]
    path.write_bytes(path.read_bytes()[:500])
    assert main(["run", str(folder), "--out", str(tmp_path / "out")]) == 0
    rows = (tmp_path / "out" / "frames.csv").read_text().splitlines()[1:]
    assert [row.split(",")[1] for row in rows] == ["weak", "weak", "lost", "weak"]
    assert "truncated PNG" in rows[2]
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["lost"] == 1


def test_a_run_that_tracks_nothing_says_so_and_ends_with_status_1(
    make_recording: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Lost(ConstantVelocity):
        def track(self, frame: RgbdFrame) -> TrackResult:
            return replace(super().track(frame), status=Status.LOST, reason="too dark")

    monkeypatch.setattr(track, "make_odometry", lambda config: Lost())
    assert main(["run", str(make_recording()), "--out", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err.startswith(
        "error: run: no frame of tiny could be tracked; `idrgbdo check` may tell why"
    )
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["lost"] == 4


def test_a_mesh_along_inverted_or_invalid_poses_is_doubted(
    make_recording: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = make_recording(frames=12)
    truth = read_tum(folder / "groundtruth.txt")
    turn = se3.exp(torch.tensor([[0.1 * n, 0.0, 0.05 * n, 0.15 * n, 0.1 * n, -0.1 * n] for n in range(12)]).double())
    write_tum(folder / "groundtruth.txt", Trajectory(truth.timestamps, truth.T_world_cam @ turn))
    write_tum(tmp_path / "a.txt", Trajectory(truth.timestamps, se3.inverse(truth.T_world_cam @ turn)))
    with (tmp_path / "a.txt").open("a") as file:
        file.write("200 nan 0 0 0 0 0 1\n")
    main(["mesh", str(folder), str(tmp_path / "a.txt")])
    warnings = [line for line in capsys.readouterr().err.splitlines() if line.startswith("warning:")]
    assert "1 of the 13 poses of 'a.txt' are marked invalid and are left out" in warnings[0]
    assert "inverted" in warnings[1] or "inverse" in warnings[1]


def remove(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).unlink()


def truncate_all(folder: Path) -> None:
    for path in (folder / "depth").iterdir():
        path.write_bytes(path.read_bytes()[:50])


def shrink_depth(folder: Path) -> None:
    import cv2

    for path in (folder / "depth").iterdir():
        cv2.imwrite(str(path), np.ones((24, 32), np.uint16))


def late_depth(folder: Path) -> None:
    lines = (folder / "depth.txt").read_text().splitlines()[1:]
    moved = [f"{float(line.split()[0]) + 60} {line.split()[1]}" for line in lines]
    (folder / "depth.txt").write_text("\n".join(moved))


@pytest.mark.parametrize(
    ("spoil", "flags", "complaint"),
    [
        (remove("rgb.txt"), [], "has no rgb.txt"),
        (remove("calibration.txt"), [], "unknown intrinsics"),
        (late_depth, [], "the closest two are 59."),
        (truncate_all, [], "truncated PNG"),
        (shrink_depth, [], "expected depth of the colour image's size 64x48, got 32x24"),
        (None, ["--selection.points", "0"], "selection.points: expected a whole number at least 6, got 0"),
        (None, ["--depth-scale", "-5"], "depth_scale: expected a number above 0, got -5.0"),
        (None, ["--every", "0"], "every: expected a whole number at least 1, got 0"),
        (None, ["--config", "wrong.toml"], "selection.pionts: no such key; did you mean 'points'?"),
        (None, ["--config", "range.toml"], "selection.points: expected a whole number at least 6, got -1"),
        (None, ["--config", "none.toml"], "cannot read 'none.toml'"),
        (None, ["--camera", "none.toml"], "cannot read 'none.toml'"),
    ],
)
def test_bad_input_is_one_line_and_exit_status_1(
    make_recording: Make,
    tmp_path: Path,
    null_method: None,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    spoil: Callable[[Path], None] | None,
    flags: list[str],
    complaint: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "wrong.toml").write_text("[selection]\npionts = 24\n")
    (tmp_path / "range.toml").write_text("[selection]\npoints = -1\n")
    folder = make_recording()
    if spoil is not None:
        spoil(folder)
    assert main(["run", str(folder), *flags]) == 1
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("error: ")
    assert shown.err.count("\n") == 1
    assert complaint in shown.err
    assert not (tmp_path / "runs").exists()


def test_no_such_folder_ends_the_program_with_status_1(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "idrgbdo_torch", "run", str(tmp_path / "nowhere")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert (
        done.stderr
        == f"error: sequence: expected a folder at '{tmp_path / 'nowhere'}', found nothing; check the path\n"
    )


def test_an_absurd_depth_scale_is_a_warning(
    make_recording: Make, tmp_path: Path, null_method: None, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = make_recording(depth_m=0.3)
    assert main(["run", str(folder), "--out", str(tmp_path / "out")]) == 0
    err = capsys.readouterr().err
    assert err.startswith("warning: depth scale 5000 makes the first frame's median depth 0.3 m")
    assert "1.5 m with 1000 (millimetres): pass that of your camera with --depth-scale" in err


def test_a_wrong_flag_names_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["run", "somewhere", "--selection.pionts", "24"])
    assert end.value.code == 2
    assert "--selection.points" in capsys.readouterr().err


def test_evaluate_takes_files_and_folders(
    make_recording: Make, tmp_path: Path, null_method: None, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = make_recording(frames=40), tmp_path / "out"
    assert main(["run", str(folder), "--out", str(out)]) == 0
    table = capsys.readouterr().out
    summary = json.loads((out / "summary.json").read_text())["evaluation"]
    for arguments in ([out, folder], [out / "trajectory.txt", folder / "groundtruth.txt"]):
        assert main(["evaluate", *map(str, arguments)]) == 0
        shown = capsys.readouterr().out
        for number in (f"{summary['ate_rmse_m']:.4f} m RMSE", f"{summary['rpe_rmse_m_per_s']:.4f} m/s, "):
            assert number in shown
            assert number in table
        assert "40 of 40 estimated, of 40 reference poses" in shown
    assert main(["evaluate", str(out), str(tmp_path / "none.txt")]) == 1
    assert "cannot read" in capsys.readouterr().err


def test_evaluate_shows_both_rpes_in_metres_and_degrees_and_what_it_noticed(
    make_recording: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = make_recording(frames=40) / "groundtruth.txt"
    late = tmp_path / "late.txt"
    lines = [line.split() for line in truth.read_text().splitlines()[1:]]
    late.write_text("".join(f"{1000 * (float(t) + 1.6e9):.0f} {' '.join(pose)}\n" for t, *pose in lines))
    assert main(["evaluate", str(late), str(late)]) == 0
    shown = capsys.readouterr().out
    assert "RPE, TUM tool  0.0000 m/s, 0.000 deg/s RMSE over 9 pairs" in shown
    assert "RPE, evo       0.0000 m/s, 0.000 deg/s" in shown
    assert "the timestamps of 'late.txt' are milliseconds and are read as such" in shown
    assert main(["evaluate", str(late), str(truth)]) == 1
    said = capsys.readouterr().err
    assert "do not overlap" in said and "with +1600000000.000 s on the timestamps of the reference" in said


def test_ground_truth_that_does_not_overlap_costs_the_evaluation_and_not_the_run(
    make_recording: Make, tmp_path: Path, null_method: None, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = make_recording(frames=6), tmp_path / "out"
    truth = folder / "groundtruth.txt"
    lines = [line.split() for line in truth.read_text().splitlines()[1:]]
    truth.write_text("".join(f"{float(t) + 500:.6f} {' '.join(pose)}\n" for t, *pose in lines))
    assert main(["run", str(folder), "--out", str(out)]) == 0
    assert "not evaluated" in capsys.readouterr().out
    page = (out / "report.html").read_text()
    assert "The ground truth is not shown." in page and "do not overlap" in page
    assert not list(out.glob("*checkpoint*"))  # it is done: nothing is left to resume
    assert "evaluation" not in json.loads((out / "summary.json").read_text())


def start_slow_run(folder: Path, out: Path) -> subprocess.Popen[str]:
    """A run of 0.05 s a frame, in which five frames have already been written."""
    command = [sys.executable, "-c", SLOW_RUN, "run", str(folder), "--out", str(out)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not (out / "frames.csv").exists() or len((out / "frames.csv").read_text().splitlines()) < 6:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    return process


def test_ctrl_c_ends_with_what_was_done_and_status_130(make_recording: Make, tmp_path: Path) -> None:
    out = tmp_path / "out"
    process = start_slow_run(make_recording(frames=300), out)
    process.send_signal(signal.SIGINT)
    shown, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (130, "")
    assert "interrupted" in shown
    summary = json.loads((out / "summary.json").read_text())
    assert 5 <= summary["frames"] < 300
    assert len(read_tum(out / "trajectory.txt")) == summary["frames"]
    assert len((out / "frames.csv").read_text().splitlines()) == summary["frames"] + 1


@pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
def test_what_was_written_before_a_kill_is_valid(make_recording: Make, tmp_path: Path) -> None:
    out = tmp_path / "out"
    process = start_slow_run(make_recording(frames=300), out)
    process.kill()
    process.communicate()
    trajectory = read_tum(out / "trajectory.txt")
    rows = (out / "frames.csv").read_text().splitlines()
    assert len(trajectory) >= 5
    assert len(trajectory) - 1 <= len(rows) - 1 <= len(trajectory)
    assert {row.count(",") for row in rows} == {rows[0].count(",")}


def test_demo_renders_once_and_tracks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], null_method: None
) -> None:
    from idrgbdo_torch.synthetic import SynthConfig

    small = SynthConfig(kind="desk", frames=3, width=80, height=60, fx=65, fy=65, cx=39.5, cy=29.5, samples=1)
    monkeypatch.setattr(demo, "DEMO", small)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    assert main(["demo"]) == 0
    first = capsys.readouterr().out
    assert "rendering" in first
    assert "ATE" in first
    assert main(["demo", "--out", "again"]) == 0
    assert "rendering" not in capsys.readouterr().out
    assert (tmp_path / "again" / "summary.json").exists()
    assert (tmp_path / "runs" / "demo" / "latest" / "trajectory.txt").exists()


def test_synth_makes_what_run_reads(tmp_path: Path, null_method: None, capsys: pytest.CaptureFixture[str]) -> None:
    flags = [
        "--frames",
        "3",
        "--width",
        "80",
        "--height",
        "60",
        "--fx",
        "65",
        "--fy",
        "65",
        "--cx",
        "39.5",
        "--cy",
        "29.5",
    ]
    assert main(["synth", str(tmp_path / "scene"), *flags, "--sensor.motion-blur", "false", "--samples", "1"]) == 0
    assert main(["run", str(tmp_path / "scene"), "--out", str(tmp_path / "out")]) == 0
    assert main(["synth", str(tmp_path / "other"), "--frames", "0"]) == 1
    assert "frames: expected a positive number" in capsys.readouterr().err


def test_the_real_method_gives_the_same_bytes_twice_and_on_other_thread_counts(data_dir: Path, tmp_path: Path) -> None:
    arguments = ["run", str(data_dir / "tum_fr1_xyz_10"), "--out"]
    threads = torch.get_num_threads()
    try:
        for name, count in (("a", 1), ("b", 1), ("c", 2)):
            torch.set_num_threads(count)
            assert main([*arguments, str(tmp_path / name)]) == 0
    finally:
        torch.set_num_threads(threads)
    first, *others = ((tmp_path / name / "trajectory.txt").read_bytes() for name in "abc")
    assert all(other == first for other in others)
    assert json.loads((tmp_path / "a" / "summary.json").read_text())["lost"] == 0
