"""Attacks on what lies in folders: disks that are full anywhere, notes of a run and results that somebody edited."""

from __future__ import annotations

import csv
import json
import resource
import signal
from pathlib import Path

from numpy.random import Generator
from run_records import record

from idrgbdo_torch.comparison.outcome import Outcome, append_outcome, read_outcomes
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.runs.folder import RunFolder
from idrgbdo_torch.runs.source import NAME, Reading, recall
from idrgbdo_torch.runs.writing import is_file_name
from idrgbdo_torch.text.plain import plain
from idrgbdo_torch.trajectory import read_tum

from .mutate import spoiled, token, words_spoiled
from .promise import refused

COLUMNS = 500  # bytes that the files have before the first frame, about


def full_disk(rng: Generator, folder: Path) -> None:
    """A frame stands in all files or in none, wherever the disk is full, and the next fits after room was made."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # as Python has it, which a camera's driver may have changed
    number = 0
    with RunFolder(folder / "run") as run:
        resource.setrlimit(resource.RLIMIT_FSIZE, (COLUMNS + int(rng.integers(6000)), before[1]))
        try:
            while number < 40:
                run.append(record(number))
                number += 1
        except IdRgbdoError:
            pass
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        run.append(record(number))
    text = (folder / "run" / "frames.csv").read_text()
    times = [float(row["timestamp"]) for row in csv.DictReader(text.splitlines())]
    assert text.endswith("\n") and times == read_tum(folder / "run" / "trajectory.txt").timestamps.tolist()
    assert times == list(range(len(times))) and times[-1] == number


def edited_note(rng: Generator, folder: Path) -> None:
    """input.json as somebody edited it."""
    Reading(folder, {"camera": folder / "camera.toml", "every": 1, "depth_scale": None}).remember(folder)
    data = (folder / NAME).read_text()
    edited = (
        words_spoiled(rng, data).encode("utf-8", "surrogateescape")
        if rng.random() < 0.5
        else spoiled(rng, data.encode())
    )
    (folder / NAME).write_bytes(edited)
    refused(lambda: recall(folder))


def edited_results(rng: Generator, folder: Path) -> None:
    """results.jsonl of a comparison: what cannot be read is no outcome, the others are."""
    for number in range(3):
        append_outcome(folder, Outcome(f"m{number}", "s", 0, "c", {"torch": "2"}))
    path = folder / "results.jsonl"
    path.write_bytes(path.read_bytes() + spoiled(rng, json.dumps({"method": "x", "sequence": "s"}).encode()) + b"\n")
    outcomes: list[str] = []
    assert not refused(lambda: outcomes.extend(each.method for each in read_outcomes(folder).values()))
    assert {"m0", "m1", "m2"} <= set(outcomes)


def names(rng: Generator, folder: Path) -> None:
    """What may be a name leads nowhere else; what is shown moves no cursor."""
    text = "".join(token(rng) + chr(int(rng.integers(1, 0x2FFF))) for _ in range(int(rng.integers(1, 4))))
    shown = plain(text)
    assert shown.isprintable() and shown.encode("utf-8")
    if is_file_name(text):
        assert (folder / text).parent == folder and Path(text).name == text
