"""What reaches a terminal: no sequence from outside, no traceback, whoever hangs up or presses Ctrl-C when."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from idrgbdo_torch.commands.cli import main
from idrgbdo_torch.text.plain import plain
from idrgbdo_torch.trajectory import read_tum

Make = Callable[..., Path]
IDRGBDO = [sys.executable, "-m", "idrgbdo_torch"]


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("desk", "desk"),
        ("café 机 [red]", "café 机 [red]"),
        ("\x1b[2J", "\\x1b[2J"),
        ("a\r\nb\tc", "a\\r\\nb\\tc"),
        ("\x9b31m", "\\x9b31m"),
        ("\u202egnp", "\\u202egnp"),
        (os.fsdecode(b"caf\xe9"), "caf\\udce9"),
    ],
)
def test_control_characters_are_spelt_out(text: str, shown: str) -> None:
    assert plain(text) == shown


def test_keys_of_a_file_move_no_cursor(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "config.toml").write_text('"\\u001b[2J" = 1\n')
    assert main(["demo", "--config", str(tmp_path / "config.toml")]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "\x1b" not in error


def test_a_name_that_looks_like_markup_is_shown_as_it_is(make_recording: Make, tmp_path: Path) -> None:
    """On a terminal, where names stand in bars and tables."""
    folder = make_recording("[/] [bold]\x1b[2J")
    ours, theirs = pty.openpty()
    command = [*IDRGBDO, "run", str(folder), "--out", str(tmp_path / "out")]
    process = subprocess.Popen(command, stdout=theirs, stderr=subprocess.PIPE)
    os.close(theirs)
    shown = b""
    while True:
        try:
            shown += os.read(ours, 65536)
        except OSError:  # the other end is closed
            break
    errors = process.communicate()[1]
    assert process.returncode == 0, errors
    assert b"Traceback" not in errors and b"\x1b[2J" not in shown
    assert b"\\x1b[2J" in shown and b"[bold]" in shown


def test_nobody_reads_any_more() -> None:
    """As with `idrgbdo compare --methods list | head -0`."""
    ours, theirs = os.pipe()
    os.close(ours)
    done = subprocess.run([*IDRGBDO, "compare", "--methods", "list"], stdout=theirs, stderr=subprocess.PIPE)
    os.close(theirs)
    assert done.stderr == b"" and done.returncode == 141


@pytest.mark.parametrize("delay_s", [0.3, 0.6, 1.2, 2.4])
def test_ctrl_c_is_one_line_from_the_start(make_recording: Make, tmp_path: Path, delay_s: float) -> None:
    command = [*IDRGBDO, "run", str(make_recording(frames=300)), "--out", str(tmp_path / "out")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    time.sleep(delay_s)
    process.send_signal(signal.SIGINT)
    time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=120)
    assert b"Traceback" not in errors and b"KeyboardInterrupt" not in errors, errors.decode()
    assert process.returncode in (0, 130, -signal.SIGINT)
    written = tmp_path / "out" / "trajectory.txt"
    if written.exists() and written.read_text().count("\n") > 1:
        assert len(read_tum(written)) > 0


def test_a_picture_that_cannot_be_written_is_said_so(
    make_recording: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    assert main(["check", str(make_recording()), "--out", str(tmp_path / "file" / "check.png")]) == 1
    output = capsys.readouterr()
    assert "picture:" not in output.out and "cannot write" in output.err and output.err.count("\n") == 1


@pytest.mark.parametrize("command", [["check"], ["run", "--out", "out"]])
def test_a_picture_or_scene_replaces_no_file_of_another_kind(
    make_recording: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    command: list[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    recording = make_recording()
    camera = recording / "camera.toml"
    camera.write_text("fx = 50\nfy = 50\ncx = 31.5\ncy = 23.5\n")
    name, *flags = command
    assert main([name, str(recording), *flags, "--save-rrd" if flags else "--out", str(camera)]) == 1
    assert "expected a name ending in ." in capsys.readouterr().err
    assert camera.read_text().startswith("fx = 50")


def test_a_film_of_a_run_ends_where_it_is_told_to(
    make_recording: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["run", str(make_recording(frames=9)), "--out", str(out)]) == 0
    for flags, frames in (([], 9), (["--max-frames", "4"], 4), (["--max-frames", "40"], 9)):
        capsys.readouterr()
        assert main(["video", str(out), "--out", str(tmp_path / "film.gif"), *flags]) == 0
        assert f"frames             {frames}\n" in capsys.readouterr().out
    assert main(["video", str(out), "--start", "3"]) == 1
    assert "filmed as it was read" in capsys.readouterr().err
