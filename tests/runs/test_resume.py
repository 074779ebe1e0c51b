"""A run that was killed goes on where it was, and ends the same; another run's checkpoint is refused."""

from __future__ import annotations

import hashlib
import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np
import pytest
from rendered import Film

from idrgbdo_torch.commands.cli import main
from idrgbdo_torch.config import Config
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.frame import BrokenFrame
from idrgbdo_torch.odometry import Record, run
from idrgbdo_torch.runs import checkpoint
from idrgbdo_torch.runs.checkpoint import Checkpoints, Identity, State
from idrgbdo_torch.synthetic import SynthConfig, synth
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo
from idrgbdo_torch.trajectory import read_tum

FRAMES, KILLED_AT = 30, 18
# the command in a process of its own; it writes a checkpoint after every tenth frame and kills itself
KILLED = f"""
import os, signal, sys
from idrgbdo_torch.commands import track
from idrgbdo_torch.commands.cli import main
from idrgbdo_torch.runs import checkpoint

class Often(checkpoint.Checkpoints):
    def offer(self, state, now=False):
        if len(state.records) % 10 == 0:
            self.write(state)
        if len(state.records) == {KILLED_AT}:
            os.kill(os.getpid(), signal.SIGKILL)

track.Checkpoints = Often
main(sys.argv[1:])
"""


def command(*arguments: str | Path) -> int:
    """The command in a process of its own.

    One that has compiled kernels itself may differ from one that found them compiled in the last bit of a sum.
    """
    done = subprocess.run([sys.executable, "-m", "idrgbdo_torch", *map(str, arguments)], capture_output=True)
    assert b"Traceback" not in done.stderr, done.stderr.decode()
    return done.returncode


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small desk as a folder."""
    folder = tmp_path_factory.mktemp("recordings") / "small"
    synth(SynthConfig(frames=FRAMES, width=240, height=180, fx=197, fy=197, cx=119.5, cy=89.5), folder)
    return folder


@pytest.fixture(scope="module")
def killed_once(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run that was killed at frame 18, its last checkpoint after frame 10."""
    out = tmp_path_factory.mktemp("runs") / "killed"
    assert command("run", recording, "--out", out.with_name("first")) == 0  # whoever is first compiles
    done = subprocess.run([sys.executable, "-c", KILLED, "run", str(recording), "--out", str(out)], capture_output=True)
    assert done.returncode == -signal.SIGKILL, done.stderr.decode()
    assert len(read_tum(out / "trajectory.txt")) == KILLED_AT
    return out


@pytest.fixture
def killed(killed_once: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return shutil.copytree(killed_once, tmp_path / "killed")


def test_a_killed_run_ends_as_if_nothing_had_happened(recording: Path, killed: Path, tmp_path: Path) -> None:
    whole = tmp_path / "whole"
    assert command("run", recording, "--out", whole) == 0
    assert command("run", recording, "--out", killed, "--resume") == 0
    for name in ("trajectory.txt", "trajectory_refined.txt", "keyframes.txt"):
        assert (killed / name).read_bytes() == (whole / name).read_bytes(), name
    assert (killed / "map.ply").read_bytes() == (whole / "map.ply").read_bytes()
    first, second = (json.loads((folder / "summary.json").read_text()) for folder in (whole, killed))
    assert second["frames"] == FRAMES
    errors = [summary["evaluation"]["ate_rmse_m"] for summary in (first, second)]
    assert errors[1] == pytest.approx(errors[0], rel=1e-3)
    assert len((killed / "frames.csv").read_text().splitlines()) == FRAMES + 1
    assert not (killed / checkpoint.NAME).exists()
    assert (killed / "report.html").exists()


def test_what_was_found_out_before_is_not_done_again(
    recording: Path, killed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", str(recording), "--out", str(killed), "--resume"]) == 0
    assert f"going on after frame 10 of {FRAMES}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("flags", "what"),
    [
        (["--selection.points", "30"], "another settings (points = 24, points = 30)"),
        (["--max-frames", "20"], "another frames (30, now 20)"),
        (["--every", "2"], "another frames (30, now 15)"),
        (["--camera", "CAMERA"], "another camera"),
        (["--depth-scale", "1000"], "another depth_scale (None, now 1000.0)"),
        (["--association-limit", "0.01"], "another association_limit (0.02, now 0.01)"),
    ],
)
def test_another_run_is_refused_in_one_line(
    recording: Path, killed: Path, flags: list[str], what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    camera = tmp_path / "camera.toml"
    camera.write_text("fx = 190.0\nfy = 197.0\ncx = 119.5\ncy = 89.5\n")
    before = (killed / "trajectory.txt").read_bytes()
    flags = [str(camera) if flag == "CAMERA" else flag for flag in flags]
    assert main(["run", str(recording), "--out", str(killed), "--resume", *flags]) == 1
    errors = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("warning")]
    assert len(errors) == 1 and what in errors[0] and errors[0].count("--resume") == 0
    assert (killed / "trajectory.txt").read_bytes() == before


def edited_image(folder: Path) -> None:
    image = min((folder / "depth").glob("*.png"))
    cv2.imwrite(str(image), cv2.imread(str(image), cv2.IMREAD_UNCHANGED) + 1)


def edited_list(folder: Path) -> None:
    lines = (folder / "depth.txt").read_text().splitlines()
    (folder / "depth.txt").write_text("\n".join([*lines[:-2], lines[-1], ""]))


def other_pairs(folder: Path) -> None:
    """The same times, some other images."""
    lines = (folder / "depth.txt").read_text().splitlines()
    stamps, names = zip(*(line.split() for line in lines if line[0] != "#"), strict=True)
    swapped = [*names[:12], names[13], names[12], *names[14:]]
    lines = [f"{stamp} {name}" for stamp, name in zip(stamps, swapped, strict=True)]
    (folder / "depth.txt").write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize("edit", [edited_image, edited_list, other_pairs])
def test_a_recording_that_was_edited_meanwhile_is_refused(
    recording: Path, killed: Path, edit: Callable[[Path], None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = shutil.copytree(recording, tmp_path / "copy" / recording.name)
    edit(copy)
    before = (killed / "trajectory.txt").read_bytes()
    assert main(["run", str(copy), "--out", str(killed), "--resume"]) == 1
    error = capsys.readouterr().err.strip()
    assert "another" in error and len(error.splitlines()) == 1
    assert (killed / "trajectory.txt").read_bytes() == before


def test_where_the_recording_lies_does_not_matter(recording: Path, killed: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(recording, tmp_path / "elsewhere" / recording.name)
    assert main(["run", str(copy), "--out", str(killed), "--resume"]) == 0


def test_where_there_is_nothing_to_go_on_with_it_says_so(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", str(recording), "--out", str(tmp_path / "none"), "--resume"]) == 1
    assert "there is no interrupted run" in capsys.readouterr().err
    finished = tmp_path / "finished"
    assert main(["run", str(recording), "--out", str(finished), "--max-frames", "3"]) == 0
    capsys.readouterr()
    assert main(["run", str(recording), "--out", str(finished), "--max-frames", "3", "--resume"]) == 1
    assert "that run is finished" in capsys.readouterr().err


IDENTITY = Identity("1", "seed = 0\n", "desk", 40, 0.0, 1.3, "camera")


def test_a_damaged_checkpoint_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / checkpoint.NAME
    Checkpoints(tmp_path, IDENTITY).write(State(IdRgbdo(), [], []))
    assert isinstance(checkpoint.load(tmp_path, IDENTITY).odometry, IdRgbdo)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(IdRgbdoError, match=r"resume: .* is damaged"):
        checkpoint.load(tmp_path, IDENTITY)
    path.write_bytes(b"")
    with pytest.raises(IdRgbdoError, match="cannot be read"):
        checkpoint.load(tmp_path, IDENTITY)
    path.write_bytes(b"not a checkpoint")
    with pytest.raises(IdRgbdoError, match="is no checkpoint"):
        checkpoint.load(tmp_path, IDENTITY)


def sealed(path: Path, identity: Identity, tree: dict[str, object]) -> None:
    """A checkpoint as somebody could make it who knows how."""
    text = json.dumps({"identity": asdict(identity), **tree}).encode()
    data = checkpoint.MAGIC + len(text).to_bytes(checkpoint.COUNT_BYTES, "big") + text
    path.write_bytes(data + hashlib.sha256(data).digest())


@pytest.mark.parametrize(
    "node",
    [
        ["object", "Path", {"self": "/tmp"}],
        ["object", "system", ["touch evil"]],
        ["object", "Pinhole", {"fx": "x"}],
        ["array", "object", [3], False],
        ["array", "float64", [1 << 40, 1 << 40], False],
        ["array", "float64", [-1], False],
        ["list", [[5]]],
        ["constant", "backend of evil"],
        ["os.system", "touch evil"],
        [],
        7,
    ],
)
def test_a_sealed_checkpoint_of_a_stranger_makes_nothing_but_known_types(tmp_path: Path, node: object) -> None:
    sealed(tmp_path / checkpoint.NAME, IDENTITY, {"root": [1], "nodes": [node, ["list", [[0], [0], [0]]]]})
    with pytest.raises(IdRgbdoError, match="resume: "):
        checkpoint.load(tmp_path, IDENTITY)


def test_a_flipped_bit_is_never_believed(killed: Path, recording: Path) -> None:
    path = killed / checkpoint.NAME
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for position in [*rng.integers(0, len(whole), 24), 0, len(whole) - 1]:
        flipped = bytearray(whole)
        flipped[position] ^= 1 << int(rng.integers(8))
        path.write_bytes(flipped)
        with pytest.raises(IdRgbdoError, match="resume: "):
            checkpoint.load(killed, IDENTITY)


def test_what_is_not_in_the_table_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(IdRgbdoError, match="Path' is not among the types"):
        Checkpoints(tmp_path, IDENTITY).write(State(IdRgbdo(), [], [tmp_path]))


def test_where_a_checkpoint_does_not_fit_the_run_goes_on(tmp_path: Path) -> None:
    checkpoints = Checkpoints(tmp_path / "gone", IDENTITY)
    checkpoints.offer(State(IdRgbdo(), [], []), now=True)
    assert "cannot write" in checkpoints.problem


def test_another_version_is_refused(tmp_path: Path) -> None:
    Checkpoints(tmp_path, IDENTITY).write(State(IdRgbdo(), [], []))
    config = Config()
    with pytest.raises(IdRgbdoError, match=r"another version \(1, now 2\)"):
        checkpoint.load(tmp_path, Identity("2", IDENTITY.settings, "desk", 40, 0.0, 1.3, "camera"))
    assert "seed = 0" in Identity.of("1", config, "desk", [0.0, 1.3], "camera").settings  # type: ignore[arg-type]


def test_writing_never_takes_more_than_a_small_share(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]
    monkeypatch.setattr(checkpoint, "monotonic", lambda: clock[0])
    checkpoints = Checkpoints(tmp_path, IDENTITY)
    written: list[float] = []

    def write(path: Path, state: State) -> None:
        path.touch()
        written.append(clock[0])
        clock[0] += 0.2

    monkeypatch.setattr(checkpoints, "_write", write)
    state = State(IdRgbdo(), [], [])
    for _ in range(2000):
        clock[0] += 0.01
        checkpoints.offer(state)
    assert written[0] == pytest.approx(1.0, abs=0.02)
    assert 0.2 * len(written) < 0.04 * clock[0]
    assert len(written) >= 3


def test_a_continued_run_starts_from_the_last_record(desk: Film) -> None:
    odometry = IdRgbdo()
    first = run(odometry, desk.frames[:5])
    gone = [BrokenFrame(desk.frames[5].timestamp, "gone"), *desk.frames[6:8]]
    seen: list[Record] = []
    whole = run(odometry, gone, seen.append, first.records)
    assert len(whole.records) == 8
    assert len(seen) == 3
    assert whole.records[5].result.T_world_cam.equal(first.records[4].result.T_world_cam)


def test_ctrl_c_leaves_a_checkpoint(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "stopped"
    words = [sys.executable, "-m", "idrgbdo_torch", "run", str(recording), "--out", str(out)]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    deadline = time.monotonic() + 120
    path = out / "trajectory.txt"
    while time.monotonic() < deadline and not (path.exists() and len(path.read_text().splitlines()) > 2):
        time.sleep(0.005)
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=120)
    if process.returncode == 0:
        pytest.skip("the run ended before it could be interrupted")
    assert b"--resume" in output
    before = len(read_tum(path))
    assert main(["run", str(recording), "--out", str(out), "--resume"]) == 0
    assert before < len(read_tum(path)) == FRAMES
