"""Run folders that are full, taken, gone or occupied: one clear error, and nothing that was written is lost."""

from __future__ import annotations

import csv
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

import cv2
import numpy as np
import pytest
from run_records import RUN, record

from idrgbdo_torch.commands.cli import main
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.odometry import ConstantVelocity, Run
from idrgbdo_torch.runs.folder import RunFolder, default_folder
from idrgbdo_torch.runs.own import FILES
from idrgbdo_torch.runs.writing import write_whole
from idrgbdo_torch.trajectory import read_tum


@contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    """The system refuses to let a file grow further, in the middle of what is written, as a full disk does."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # as Python has it, which a camera's driver may have changed
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("size", [2000, 2100, 2200, 2600, 2877])
def test_where_the_disk_is_full_a_frame_stands_in_all_files_or_in_none(tmp_path: Path, size: int) -> None:
    with RunFolder(tmp_path / "run") as folder:
        count = 0
        with (
            files_of_at_most(size),
            pytest.raises(IdRgbdoError, match=r"cannot write '.*frames.csv': .*make room"),
        ):
            while count < 100:
                folder.append(record(count))
                count += 1
    assert 0 < count < 100
    text = (tmp_path / "run" / "frames.csv").read_text()
    assert text.endswith("\n")
    assert len(list(csv.DictReader(text.splitlines()))) == count
    assert len(read_tum(tmp_path / "run" / "trajectory.txt")) == count
    assert len(read_tum(tmp_path / "run" / "keyframes.txt")) == (count + 2) // 3


def test_after_room_was_made_the_next_frame_is_written(tmp_path: Path) -> None:
    with RunFolder(tmp_path / "run") as folder:
        folder.append(record(0))
        with files_of_at_most(400), pytest.raises(IdRgbdoError):
            folder.append(record(1))
        folder.append(record(2))
    assert read_tum(tmp_path / "run" / "trajectory.txt").timestamps.tolist() == [0, 2]


def test_a_summary_that_does_not_fit_is_an_error_in_one_line(tmp_path: Path) -> None:
    with RunFolder(tmp_path / "run") as folder:
        for each in RUN.records:
            folder.append(each)
        with files_of_at_most(100), pytest.raises(IdRgbdoError, match=r"cannot write '.*summary.json'"):
            folder.finish(RUN, ConstantVelocity())
    assert not list((tmp_path / "run").glob("*.part"))
    assert len(read_tum(tmp_path / "run" / "trajectory.txt")) == 5


def test_two_runs_do_not_write_into_one_folder(tmp_path: Path) -> None:
    with RunFolder(tmp_path / "run") as first:
        first.append(record(0))
        with pytest.raises(IdRgbdoError, match="another run is writing to"):
            RunFolder(tmp_path / "run")
        assert len(read_tum(tmp_path / "run" / "trajectory.txt")) == 1
    with RunFolder(tmp_path / "run") as second:
        second.append(record(5))


def test_a_killed_run_locks_nothing(tmp_path: Path) -> None:
    script = (
        "import os, sys, pathlib; from idrgbdo_torch.runs.folder import RunFolder\n"
        "folder = RunFolder(pathlib.Path(sys.argv[1])); os.kill(os.getpid(), 9)"
    )
    assert subprocess.run([sys.executable, "-c", script, str(tmp_path / "run")]).returncode == -9
    RunFolder(tmp_path / "run").__exit__()


def occupied(folder: Path) -> None:
    (folder / "report.html" / "mine").mkdir(parents=True)


def no_folder(folder: Path) -> None:
    folder.write_text("a file")


def below_a_file(folder: Path) -> None:
    folder.symlink_to(folder.parent / "nowhere" / "at" / "all")


@pytest.mark.parametrize("prepare", [occupied, no_folder, below_a_file])
def test_what_stands_in_the_way_is_found_before_anything_runs(
    make_recording: Callable[..., Path], tmp_path: Path, prepare: Callable[[Path], None],
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    out = tmp_path / "out"
    prepare(out)
    assert main(["run", str(make_recording()), "--out", str(out)]) == 1
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 1 and errors[0].startswith("error: out: cannot write")
    assert not (out / "trajectory.txt").exists()


def test_what_an_earlier_run_left_goes_with_the_first_frame(tmp_path: Path) -> None:
    with RunFolder(tmp_path) as folder:
        folder.append(record(0))
    (tmp_path / "figures").mkdir()
    (tmp_path / "elsewhere").write_text("of the user")
    (tmp_path / "report.html").symlink_to(tmp_path / "elsewhere")
    left = ["figures/frame_000050.png", "figures/trajectory.png", "checkpoint.bin", "map.ply", "summary.json"]
    mine = ["figures/mine.png", "figures/frame_1.png", "data.part", "map_segment_of_mine.ply"]
    for name in (*left, *mine):
        (tmp_path / name).write_text("old")
    with RunFolder(tmp_path, resumed=True) as folder:
        folder.append(record(0))
    assert (tmp_path / "checkpoint.bin").exists() and (tmp_path / "figures" / "trajectory.png").exists()
    (tmp_path / "map.ply").write_text("old")
    (tmp_path / "summary.json").write_text("old")
    with RunFolder(tmp_path) as folder:
        assert all((tmp_path / name).exists() for name in left)
        folder.append(record(0))
    assert not any((tmp_path / name).exists() for name in (*left, "report.html"))
    assert all((tmp_path / name).exists() for name in mine)
    assert (tmp_path / "elsewhere").read_text() == "of the user"


@pytest.mark.parametrize("name", [*FILES, "checkpoint.bin", "map_segment_1.ply", "figures/frame_000050.png"])
def test_files_that_no_run_wrote_are_never_replaced(tmp_path: Path, name: str) -> None:
    (tmp_path / "figures").mkdir()
    (tmp_path / name).write_text("mine, of which there is no other copy")
    with pytest.raises(IdRgbdoError, match=rf"out: expected a new folder, .*'{name}' that no run wrote"):
        RunFolder(tmp_path)
    assert (tmp_path / name).read_text() == "mine, of which there is no other copy"


def test_a_run_that_fails_at_its_first_image_leaves_the_earlier_one(
    make_recording: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording, out = make_recording(), tmp_path / "out"
    assert main(["run", str(recording), "--out", str(out), "--figures"]) == 0
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}

    def refuse(*_: object) -> None:
        raise IdRgbdoError("depth: expected metres")

    monkeypatch.setattr("idrgbdo_torch.tracker.id_rgbdo.IdRgbdo.track", refuse)
    assert main(["run", str(recording), "--out", str(out), "--figures"]) == 1
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before


def test_a_run_without_a_frame_leaves_the_earlier_one(tmp_path: Path) -> None:
    with RunFolder(tmp_path) as folder:
        folder.append(record(0))
    before = (tmp_path / "trajectory.txt").read_text()
    with RunFolder(tmp_path) as folder:
        folder.finish(Run("none", ()), ConstantVelocity())
    assert (tmp_path / "trajectory.txt").read_text() == before and not (tmp_path / "summary.json").exists()


def test_a_link_is_replaced_and_not_followed(tmp_path: Path) -> None:
    (tmp_path / "user").write_text("of the user")
    (tmp_path / "report.html").symlink_to(tmp_path / "user")
    write_whole(tmp_path / "report.html", "page of \udcff")
    assert (tmp_path / "user").read_text() == "of the user"
    assert (tmp_path / "report.html").read_text() == "page of \\udcff"


def test_a_folder_that_vanishes_is_an_error_in_one_line(tmp_path: Path) -> None:
    with RunFolder(tmp_path / "run") as folder:
        folder.append(record(0))
        for path in (tmp_path / "run").iterdir():
            path.unlink()
        (tmp_path / "run").rmdir()
        with pytest.raises(IdRgbdoError, match="cannot write"):
            folder.finish(RUN, ConstantVelocity())


def test_runs_of_the_same_second_get_folders_of_their_own(tmp_path: Path) -> None:
    now = datetime(2026, 11, 26, 17, 0)
    folders = {default_folder("desk", now, tmp_path) for _ in range(3)}
    assert len(folders) == 3
    assert (tmp_path / "desk" / "latest").resolve() in folders


def test_a_run_without_any_pose_gets_its_report_and_says_why_there_is_no_mesh(
    make_recording: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = make_recording()
    for image in (folder / "rgb").glob("*.png"):
        cv2.imwrite(str(image), np.zeros((48, 64, 3), np.uint8))
    assert main(["run", str(folder), "--out", str(tmp_path / "out"), "--map", "mesh"]) == 1
    output = capsys.readouterr()
    assert "none: trajectory: expected poses" in output.out and "Traceback" not in output.err
    assert (tmp_path / "out" / "report.html").stat().st_size > 0 and (tmp_path / "out" / "summary.json").exists()


def test_a_run_of_a_folder_whose_name_is_not_utf8(make_recording: Callable[..., Path], tmp_path: Path) -> None:
    folder = make_recording()
    odd = Path(os.fsdecode(os.fsencode(folder.parent) + b"/caf\xe9 \x1b[31m"))
    folder.rename(odd)
    command = [sys.executable, "-m", "idrgbdo_torch", "run", str(odd), "--out", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True)
    assert done.returncode == 0, done.stderr
    assert b"Traceback" not in done.stderr and b"\x1b" not in done.stdout + done.stderr
    assert b"caf" in (tmp_path / "out" / "report.html").read_bytes()
