"""Sizes of the benchmarks: as the documentation reports them with --benchmark-enable or --gate, else tiny and untimed.

`pytest tests/benchmarks --gate` measures only the ratios, and fails where one is outside its range in ranges.json.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import cv2
import pytest
import torch
from gate import outside, wanted
from rendered import Film, film

from idrgbdo_torch.experiments import cost
from idrgbdo_torch.synthetic import SynthConfig


def pytest_addoption(parser: pytest.Parser) -> None:
    """--gate, where the benchmarks are named on the command line."""
    parser.addoption("--gate", action="store_true", help="measure the ratios of ranges.json, fail outside of them")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """The gate has no use for times that nothing is compared with."""
    if config.getoption("--gate", default=False):
        timed = [item for item in items if "benchmark" in getattr(item, "fixturenames", ())]
        config.hook.pytest_deselected(items=timed)
        items[:] = [item for item in items if item not in timed]


@pytest.fixture(scope="session")
def full(request: pytest.FixtureRequest) -> bool:
    """Whether times are taken: 640x480, and the targets must hold."""
    return bool(request.config.getoption("benchmark_enable") or request.config.getoption("--gate", default=False))


@pytest.fixture(scope="session", autouse=True)
def one_thread() -> Iterator[None]:
    """For every library that can be told at run time; for Open3D set OMP_NUM_THREADS=1."""
    of_torch, of_opencv = torch.get_num_threads(), cv2.getNumThreads()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    yield
    torch.set_num_threads(of_torch)
    cv2.setNumThreads(of_opencv)


@pytest.fixture(scope="session")
def shrink(full: bool) -> int:
    """By what the image size is divided."""
    return 1 if full else 4


@pytest.fixture(scope="session")
def scene(shrink: int) -> cost.Scene:
    """A keyframe and a frame four later."""
    return cost.pair(shrink)


@pytest.fixture(scope="session")
def window_scene(shrink: int) -> cost.Scene:
    """As many keyframes as a window may have."""
    return cost.window_scene(shrink=shrink)


@pytest.fixture(scope="session")
def footage(full: bool) -> Film:
    """Frames of a desk, filmed by hand."""
    if full:
        return film(SynthConfig(frames=60))
    return film(SynthConfig(frames=12, width=160, height=120, fx=131.0, fy=131.0, cx=79.5, cy=59.5))


@pytest.fixture
def show(full: bool, capsys: pytest.CaptureFixture[str]) -> Callable[[str], None]:
    """Writes a line past pytest, where the figures mean something."""

    def line(text: str) -> None:
        if full:
            with capsys.disabled():
                print(f"\n  {text}", end="", flush=True)

    return line


@pytest.fixture
def ratio(full: bool, show: Callable[[str], None]) -> Callable[[str, float], None]:
    """Shows a ratio, and fails where it is outside its range and was measured in full."""

    def within(name: str, value: float) -> None:
        show(f"{name}: {value:.3g} ({wanted(name)} wanted)")
        assert not (full and outside(name, value)), outside(name, value)

    return within
