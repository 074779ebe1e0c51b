"""What it costs to decode a frame's files, beside OpenCV on the same files."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.datasets.images import read_color, read_depth
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.synthetic import RenderedSequence, SynthConfig
from idrgbdo_torch.synthetic.sequence import write_tum as write_folder

Files = dict[str, Path]


@pytest.fixture(scope="module")
def folder(full: bool, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two frames as PNG."""
    path = tmp_path_factory.mktemp("decode") / "film"
    small = SynthConfig(frames=2, width=160, height=120, fx=131.0, fy=131.0, cx=79.5, cy=59.5)
    config = SynthConfig(frames=2) if full else small
    write_folder(RenderedSequence(config), path)
    return path


@pytest.fixture(scope="module")
def files(folder: Path) -> Files:
    """The first frame's depth and colour, and its colour as JPEG."""
    color, depth = (min((folder / kind).iterdir()) for kind in ("rgb", "depth"))
    assert cv2.imwrite(str(folder / "color.jpg"), cv2.imread(str(color)))
    return {"PNG depth": depth, "PNG colour": color, "JPEG colour": folder / "color.jpg"}


def ours(name: str, path: Path) -> np.ndarray:
    """The image as the package reads it."""
    return read_depth(path) if "depth" in name else read_color(path)


def opencvs(name: str, path: Path) -> np.ndarray:
    """The image as one reads it with OpenCV alone."""
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED if "depth" in name else cv2.IMREAD_COLOR_BGR)
    assert image is not None
    return image


@pytest.mark.parametrize("reader", [ours, opencvs])
@pytest.mark.parametrize("name", ["PNG depth", "PNG colour", "JPEG colour"])
def test_decode(
    name: str, reader: Callable[[str, Path], np.ndarray], files: Files, benchmark: BenchmarkFixture
) -> None:
    benchmark.group = f"1 decode: {name}"
    np.testing.assert_array_equal(benchmark(reader, name, files[name]), opencvs(name, files[name]))


def test_frame(folder: Path, benchmark: BenchmarkFixture) -> None:
    benchmark.group = "1 decode: both PNGs, to gray levels and metres"
    sequence = open_sequence(folder)
    assert isinstance(benchmark(sequence.read, 0), RgbdFrame)


def test_a_frame_is_decoded_in_half_of_opencvs_time(
    full: bool, files: Files, ratio: Callable[[str, float], None]
) -> None:
    """Least processor time of a thread, the two readers in turns."""
    times: dict[tuple[str, Callable[..., np.ndarray]], float] = {}
    for name, path in files.items():
        for reader in (ours, opencvs):
            reader(name, path)
            times[name, reader] = np.inf
        for _ in range(25 if full else 1):
            for reader in (ours, opencvs):
                times[name, reader] = min(times[name, reader], seconds(partial(reader, name, path)))
    pairs = {"PNG": ("PNG colour", "PNG depth"), "JPEG colour and PNG depth": ("JPEG colour", "PNG depth")}
    for title, pair in pairs.items():
        theirs, mine = (sum(times[name, reader] for name in pair) for reader in (opencvs, ours))
        ratio(f"decode: cv2.imread over ours, {title}", theirs / mine)


def seconds(do: Callable[[], object]) -> float:
    """Of this thread on the processor."""
    begin = time.thread_time_ns()
    do()
    return (time.thread_time_ns() - begin) / 1e9
