"""Attacks on runs: killed at any moment, a run that is continued ends with the same bytes as one that was not."""

from __future__ import annotations

import csv
import subprocess
import sys
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

from numpy.random import Generator

from idrgbdo_torch.runs.checkpoint import NAME
from idrgbdo_torch.synthetic import SynthConfig, synth

BYTES = ("trajectory.txt", "trajectory_refined.txt", "keyframes.txt", "map.ply")
TIMES = ("decode_ms", "ms")
# a checkpoint after every frame, so that most kills fall into the writing of one
KILLED = """
import os, signal, sys, threading, time
from idrgbdo_torch.commands import track
from idrgbdo_torch.commands.cli import main
from idrgbdo_torch.runs import checkpoint
checkpoint.SHARE = checkpoint.LEAST_S = 0.0

class Killed(checkpoint.Checkpoints):
    def __init__(self, *arguments):
        super().__init__(*arguments)
        timer = threading.Timer(float(sys.argv[1]), lambda: os.kill(os.getpid(), signal.SIGKILL))
        timer.daemon = True
        timer.start()

track.Checkpoints = Killed
sys.exit(main(sys.argv[2:]))
"""


def command(*words: str | Path) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run([sys.executable, *map(str, words)], capture_output=True, timeout=300)


@cache
def undisturbed() -> tuple[Path, Path]:
    """A recording and its run, made after the kernels were compiled."""
    folder = Path(mkdtemp())
    synth(SynthConfig(frames=30, width=240, height=180, fx=197, fy=197, cx=119.5, cy=89.5), folder / "desk")
    for name in ("first", "whole"):
        done = command("-m", "idrgbdo_torch", "run", folder / "desk", "--out", folder / name)
        assert done.returncode == 0, done.stderr
    return folder / "desk", folder / "whole"


def rows(folder: Path) -> list[dict[str, str]]:
    """frames.csv without what the clock said."""
    with (folder / "frames.csv").open(newline="") as file:
        return [{name: cell for name, cell in row.items() if name not in TIMES} for row in csv.DictReader(file)]


def killed(rng: Generator, folder: Path) -> None:
    """Killed once or twice, then continued to the end."""
    recording, whole = undisturbed()
    out = folder / "out"
    resume: list[str] = []
    for _ in range(int(rng.integers(1, 3))):
        done = command("-c", KILLED, str(rng.uniform(0.0, 1.5)), "run", recording, "--out", out, *resume)
        assert b"Traceback" not in done.stderr, done.stderr.decode()
        assert done.returncode in (0, -9), done.stderr.decode()
        resume = ["--resume"] if (out / NAME).exists() else []
        if done.returncode == 0:
            break
    else:
        done = command("-m", "idrgbdo_torch", "run", recording, "--out", out, *resume)
        assert done.returncode == 0, done.stderr.decode()
    for name in BYTES:
        assert (out / name).read_bytes() == (whole / name).read_bytes(), f"{name} differs"
    assert rows(out) == rows(whole), "frames.csv differs"
    assert not list(out.glob("*.part")) and not (out / NAME).exists()
