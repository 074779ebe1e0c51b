"""Milliseconds a frame of every method, for timing reports: `pytest tests/test_speed.py --benchmark-enable`.

Without that flag each method tracks once, untimed. Only the ratios mean something, and only on a quiet machine.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from rendered import Film

from baselines import METHODS
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.odometry import TrackResult

FRAMES = 12


def back_and_forth(film: Film) -> Iterator[RgbdFrame]:
    """The first frames, then the same backwards, and so on, at 30 frames a second without end."""
    frames = [*film.frames[:FRAMES], *film.frames[FRAMES - 2 : 0 : -1]]
    number = 0
    while True:
        yield replace(frames[number % len(frames)], timestamp=number / 30)
        number += 1


@pytest.mark.parametrize("name", list(METHODS))
def test_track(name: str, benchmark: BenchmarkFixture, desk: Film) -> None:
    odometry = METHODS[name].make(0)
    frames = back_and_forth(desk)
    for _ in range(3):  # the first keyframe, compilation, caches
        odometry.track(next(frames))

    def next_frame() -> tuple[tuple[RgbdFrame], dict[str, object]]:
        return (next(frames),), {}

    result: TrackResult = benchmark.pedantic(odometry.track, setup=next_frame, rounds=2 * FRAMES)
    benchmark.extra_info["description"] = METHODS[name].description
    assert result.T_world_cam.shape == (4, 4)
