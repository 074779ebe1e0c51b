"""What a frame costs before it is tracked: decoding its files, and its pyramid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from rendered import Film

from idrgbdo_torch.config import Config
from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.datasets.images import read_color, read_depth
from idrgbdo_torch.experiments.cost import Scene
from idrgbdo_torch.frame import RgbdFrame, prepare
from idrgbdo_torch.synthetic import RenderedSequence, SynthConfig
from idrgbdo_torch.synthetic.sequence import write_tum as write_folder
from idrgbdo_torch.tracker.backends import backend_named
from idrgbdo_torch.tracker.keyframe import make_keyframe

FUSED = backend_named("fused")


@pytest.fixture(scope="module")
def folder(full: bool, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two frames as PNG."""
    path = tmp_path_factory.mktemp("decode") / "film"
    small = SynthConfig(frames=2, width=160, height=120, fx=131.0, fy=131.0, cx=79.5, cy=59.5)
    config = SynthConfig(frames=2) if full else small
    write_folder(RenderedSequence(config), path)
    return path


@pytest.mark.parametrize("what", ["colour", "depth", "frame"])
def test_decode(what: str, folder: Path, benchmark: BenchmarkFixture) -> None:
    benchmark.group = "1 decode a PNG (frame: both, and gray levels and metres)"
    sequence = open_sequence(folder)
    color, depth = (next((folder / kind).iterdir()) for kind in ("rgb", "depth"))
    read = {
        "colour": lambda: read_color(color),
        "depth": lambda: read_depth(depth),
        "frame": lambda: sequence.read(0),
    }[what]
    assert benchmark(read) is not None
    assert isinstance(sequence.read(0), RgbdFrame)


def test_pyramid(footage: Film, benchmark: BenchmarkFixture) -> None:
    benchmark.group = "2 prepare a frame"
    assert len(benchmark(prepare, footage.frames[1]).images) == 6


def test_keyframe(scene: Scene, benchmark: BenchmarkFixture) -> None:
    """Edges, gradients, candidates and their patches: what a keyframe costs beside the window."""
    benchmark.group = "2 prepare a frame"
    frame = prepare(scene.frames[0])
    keyframe = benchmark(lambda: make_keyframe(frame, Config(), np.random.default_rng(0), FUSED))
    assert len(keyframe.points.uv) > 50
