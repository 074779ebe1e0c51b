"""What a decoded frame costs before it is tracked: its pyramid, and what a keyframe needs."""

from __future__ import annotations

import numpy as np
from pytest_benchmark.fixture import BenchmarkFixture
from rendered import Film

from idrgbdo_torch.config import Config
from idrgbdo_torch.experiments.cost import Scene
from idrgbdo_torch.frame import prepare
from idrgbdo_torch.tracker.backends import backend_named
from idrgbdo_torch.tracker.keyframe import make_keyframe

FUSED = backend_named("fused")


def test_pyramid(footage: Film, benchmark: BenchmarkFixture) -> None:
    benchmark.group = "2 prepare a frame"
    assert len(benchmark(prepare, footage.frames[1]).images) == 6


def test_keyframe(scene: Scene, benchmark: BenchmarkFixture) -> None:
    """Edges, gradients, candidates and their patches: what a keyframe costs beside the window."""
    benchmark.group = "2 prepare a frame"
    frame = prepare(scene.frames[0])
    keyframe = benchmark(lambda: make_keyframe(frame, Config(), np.random.default_rng(0), FUSED))
    assert len(keyframe.points.uv) > 50
