"""What choosing points and tracking with them costs (the paper's Fig. 7)."""

from __future__ import annotations

from dataclasses import replace

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from idrgbdo_torch.experiments import cost


@pytest.mark.parametrize("candidates", [250, 500, 1000, 2000, 4000], ids="{:04}".format)
def test_select_24(candidates: int, scene: cost.Scene, benchmark: BenchmarkFixture) -> None:
    benchmark.group = "3 select 24 of N candidates"
    config = cost.configured(24)
    config = replace(config, selection=replace(config.selection, candidates=candidates))
    chosen = benchmark(cost.selection_case(scene, 24, config=config))
    assert len(set(chosen.tolist())) == len(chosen) > 6


@pytest.mark.parametrize("points", cost.POINTS, ids="{:03}".format)
@pytest.mark.parametrize("select", [False, True], ids=["track", "select and track"])
def test_track(points: int, select: bool, scene: cost.Scene, benchmark: BenchmarkFixture) -> None:
    benchmark.group = "4 track a frame" + (", points chosen anew" if select else "")
    tracked = benchmark(cost.tracking_case(scene, points, select=select))
    assert tracked.iterations > 0
