"""Attacks on the readers: recordings of every format of which any file may be spoiled, missing or something else.

One image that cannot be read costs its frame; whatever else is wrong costs one sentence, and what is read is finite.
"""

from __future__ import annotations

import json
import re
from dataclasses import asdict
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from calibration_files import FILES
from numpy.random import Generator
from run_records import record

from idrgbdo_torch.config import Config
from idrgbdo_torch.datasets import RgbdSequence, open_sequence
from idrgbdo_torch.datasets.calibration import find_calibration
from idrgbdo_torch.datasets.poses import log_poses, matrices
from idrgbdo_torch.export.tracked import load_run
from idrgbdo_torch.frame import BrokenFrame, RgbdFrame
from idrgbdo_torch.runs.folder import RunFolder, run_trajectory
from idrgbdo_torch.text import configfile
from idrgbdo_torch.trajectory import read_tum

from . import hostile, recorded
from .mutate import spoiled, token, tree_spoiled, words_spoiled
from .promise import refused

PAGE = 4096  # bytes, of SQLite


@cache
def ready() -> None:
    """Make all recordings, and read each once, so that all is compiled."""
    for kind, made in (
        *((kind, recorded.folder_of) for kind in recorded.WRITERS),
        *((kind, recorded.bag_of) for kind in recorded.BAGS),
    ):
        with TemporaryDirectory() as folder:
            assert len(frames(recorded.write(made(kind), Path(folder)))) == recorded.FRAMES


def one_image(rng: Generator, folder: Path) -> None:
    """One image file is anything: its frame may be lost, the others are there."""
    kind = list(recorded.WRITERS)[rng.integers(len(recorded.WRITERS))]
    files = recorded.folder_of(kind)
    images = [name for name in files if recorded.is_image(name)]
    chosen = images[rng.integers(len(images))]
    path = recorded.write(files, folder)
    if rng.random() < 0.25:
        hostile.in_place_of(rng, folder / chosen)
    else:
        data = hostile.image(rng, Path(chosen).suffix, files[chosen])
        (folder / chosen).write_bytes(data)
    present = (folder / chosen).exists() or (folder / chosen).is_symlink()
    found = frames(path)
    lost = [frame for frame in found if isinstance(frame, BrokenFrame)]
    assert len(lost) <= 1, [frame.reason for frame in lost]
    assert len(found) == recorded.FRAMES or not present
    assert all(frame.reason for frame in lost)


def one_text(rng: Generator, folder: Path) -> None:
    """A list, a calibration or a pose file that somebody edited."""
    kind = list(recorded.WRITERS)[rng.integers(len(recorded.WRITERS))]
    files = recorded.folder_of(kind)
    texts = [name for name in files if not recorded.is_image(name)]
    chosen = texts[rng.integers(len(texts))]
    path = recorded.write(files, folder)
    if rng.random() < 0.15:
        hostile.in_place_of(rng, folder / chosen)
    else:
        (folder / chosen).write_bytes(edited(rng, files[chosen], chosen))
    refused(lambda: frames(path))


def strange_folder(rng: Generator, folder: Path) -> None:
    """Names that mean something under which there is something else, beside a whole recording or in its place."""
    kind = list(recorded.WRITERS)[rng.integers(len(recorded.WRITERS))]
    files = recorded.folder_of(kind)
    path = recorded.write(files, folder)
    names = (
        *("a.json", "camera.toml", "calibration.txt", "camera.yaml", "K.txt", "metadata", "metadata.yaml", "rgb.txt"),
        *("depth.txt", "associations.txt", "groundtruth.txt", "traj.txt", "trajectory.log", "a.gt.freiburg"),
        *("rgb", "depth", "color", "results", "intrinsic", "frame-000000.color.png", "scene_00.depth", "pose"),
        *("a.bag", "a.mcap", "²".join("ab"), "٣.png", "9" * 200 + ".png", "\udcff.json", "\x1b[2J.png", "nan.txt"),
    )
    for _ in range(int(rng.integers(1, 4))):
        place = path / names[rng.integers(len(names))]
        if rng.random() < 0.4 or place.is_dir():
            place = (place if place.is_dir() else path) / names[rng.integers(len(names))]
        if not place.is_dir():
            hostile.in_place_of(rng, place)
    suffix = ("", ".bag", ".mcap", ".db3")[rng.integers(4)]
    if suffix and rng.random() < 0.2:
        path = folder / f"other{suffix}"
        hostile.in_place_of(rng, path)
    refused(lambda: frames(path))


def bags(rng: Generator, folder: Path) -> None:
    """Bytes or pages of a ROS recording are others, or its metadata.yaml."""
    kind = recorded.BAGS[rng.integers(len(recorded.BAGS))]
    files = dict(recorded.bag_of(kind))
    chosen = list(files)[rng.integers(len(files))]
    data = files[chosen]
    if chosen.endswith(".yaml"):
        files[chosen] = edited(rng, data, chosen)
    elif rng.random() < 0.5:
        at = PAGE * int(rng.integers(len(data) // PAGE)) if rng.random() < 0.7 else int(rng.integers(len(data)))
        filling = (bytes(PAGE), b"\xff" * PAGE, rng.bytes(PAGE))[rng.integers(3)]
        files[chosen] = data[:at] + filling[: len(data) - at] + data[at + PAGE :]
    else:
        files[chosen] = spoiled(rng, data)
    path = recorded.write(files, folder)
    if path.is_dir() and rng.random() < 0.3:
        path = next(file for file in path.iterdir() if file.suffix != ".yaml")
    refused(lambda: frames(path))


def camera_files(rng: Generator, folder: Path) -> None:
    """A calibration of another program that somebody edited: finite numbers that a camera can have, or a sentence."""
    name = list(FILES)[rng.integers(len(FILES))]
    (folder / name).write_bytes(edited(rng, FILES[name][0].encode(), name))
    with np.errstate(all="raise"):
        refused(lambda: believable(asdict(find_calibration(folder, folder / name))))


def settings(rng: Generator, folder: Path) -> None:
    """A configuration that somebody edited."""
    path = folder / "config.toml"
    path.write_bytes(edited(rng, configfile.dump(Config()).encode(), "config.toml"))
    refused(lambda: believable(asdict(configfile.load(path, Config()))))


def poses(rng: Generator, folder: Path) -> None:
    """Trajectories and matrices that somebody edited."""
    row = "1305031102.175304 1.3405 0.6266 1.6575 0.6574 0.6126 -0.2949 -0.3248\n"
    rows = "".join(row.replace("102.", f"{102 + k}.") for k in range(5))
    T = "1 0 0 0.5\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"
    log = "".join(f"{k} {k} {k + 1}\n{T}" for k in range(3))
    text, read = ((rows, read_tum), (T * 3, matrices), (log, log_poses))[rng.integers(3)]
    (folder / "poses.txt").write_bytes(edited(rng, text.encode(), "poses.txt"))
    if rng.random() < 0.1:
        hostile.in_place_of(rng, folder / "poses.txt")
    refused(lambda: read(folder / "poses.txt"))


def run_tables(rng: Generator, folder: Path) -> None:
    """frames.csv and the trajectory of a run that somebody edited."""
    with RunFolder(folder / "run") as run:
        for number in range(4):
            run.append(record(number))
    path = folder / "run" / ("frames.csv", "trajectory.txt")[rng.integers(2)]
    path.write_bytes(edited(rng, path.read_bytes(), path.name))
    if rng.random() < 0.1:
        hostile.in_place_of(rng, path)
    refused(lambda: load_run(folder / "run"))
    refused(lambda: run_trajectory(folder / "run"))


def edited(rng: Generator, data: bytes, name: str) -> bytes:
    """Text of which words, lines, numbers, branches or bytes are others."""
    kind = rng.integers(4)
    if kind == 0:
        return spoiled(rng, data)
    text = data.decode("utf-8")
    if kind == 1 and text.lstrip().startswith("{"):
        return json.dumps(tree_spoiled(rng, json.loads(text))).encode()
    if kind == 2:
        numbers = list(re.finditer(r"-?\d+(\.\d+)?(e[-+]?\d+)?", text))
        if numbers:
            chosen = numbers[rng.integers(len(numbers))]
            return (text[: chosen.start()] + token(rng) + text[chosen.end() :]).encode("utf-8", "surrogateescape")
    return words_spoiled(rng, text).encode("utf-8", "surrogateescape")


def frames(path: Path) -> list[RgbdFrame | BrokenFrame]:
    """All frames of a recording, each of them sound or broken. Raises IdRgbdoError where it cannot be opened."""
    sequence: RgbdSequence = open_sequence(path)
    assert sequence.recognised and all(sequence.warnings) and np.isfinite(sequence.timestamps).all()
    found = list(sequence)
    assert len(found) == len(sequence)
    for frame in found:
        if isinstance(frame, RgbdFrame):
            assert bool(frame.depth.isfinite().all()) and float(frame.depth.min()) >= 0
            believable(asdict(frame.camera))
    return found


def believable(values: object) -> None:
    """All numbers in a tree are finite, and none is absurd."""
    if isinstance(values, dict):
        values = list(values.values())
    if isinstance(values, list | tuple):
        for value in values:
            believable(value)
    elif isinstance(values, float):
        assert abs(values) < 1e100, values
    elif isinstance(values, int):
        assert abs(values) < 1 << 63
