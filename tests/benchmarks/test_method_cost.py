"""What a whole frame costs with each method, keyframes included in the mean, decoding left out."""

from __future__ import annotations

import pytest
from endless import back_and_forth
from pytest_benchmark.fixture import BenchmarkFixture
from rendered import Film

from baselines import METHODS
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.odometry import TrackResult

ROUNDS, MORE_ROUNDS = 24, 240  # more for ours, so that keyframes count with their share


@pytest.mark.parametrize("name", list(METHODS))
def test_track(name: str, full: bool, footage: Film, benchmark: BenchmarkFixture) -> None:
    benchmark.group = "6 a whole frame"
    method = METHODS[name]
    odometry = method.make(0)
    frames = back_and_forth(footage.frames)
    for _ in range(3):  # the first keyframe, compilation, caches
        odometry.track(next(frames))

    def next_frame() -> tuple[tuple[RgbdFrame], dict[str, object]]:
        return (next(frames),), {}

    rounds = MORE_ROUNDS if method.kind == "ours" else ROUNDS
    result: TrackResult = benchmark.pedantic(odometry.track, setup=next_frame, rounds=rounds if full else 2)
    benchmark.extra_info["description"] = method.description
    assert result.T_world_cam.shape == (4, 4)
