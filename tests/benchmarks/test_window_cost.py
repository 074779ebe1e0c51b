"""What optimising the window costs (the paper's Fig. 8)."""

from __future__ import annotations

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from idrgbdo_torch.experiments import cost


@pytest.mark.parametrize("points", cost.POINTS, ids="{:03}".format)
@pytest.mark.parametrize("keyframes", cost.KEYFRAMES, ids="{:02}".format)
def test_optimise(
    keyframes: int, points: int, full: bool, window_scene: cost.Scene, benchmark: BenchmarkFixture
) -> None:
    benchmark.group = f"5 optimise a window of {keyframes} keyframes"
    if not full and (keyframes, points) not in [(4, 24), (4, 96), (12, 24)]:
        pytest.skip("the short form takes the smallest ones")
    assert benchmark(cost.window_case(window_scene, points, keyframes)) > 0
