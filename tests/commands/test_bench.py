"""`idrgbdo bench`: one table and one file of what tracking costs here, and the kernel's energy counters."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from idrgbdo_torch.commands.bench import rows
from idrgbdo_torch.commands.cli import main
from idrgbdo_torch.runs.machine import EnergyMeter


def test_bench_measures_and_answers_with_json(
    make_recording: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", str(make_recording()), "--rounds", "2", "--max-frames", "3", "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["frames"] == 6 and figures["keyframes"] >= 2  # each round begins with one
    ms = figures["track_ms"]
    assert 0 < ms["median"] <= ms["p95"] <= ms["p99"] < 60_000
    assert figures["frames_per_second"] > 0 and figures["processor_s_per_frame"] > 0
    assert 50 < figures["peak_memory_mb"] < 50_000
    shown = dict(rows(figures))
    assert shown["speed"].startswith(f"{figures['frames_per_second']:.1f} frames per second")
    assert (
        shown["tracking a frame"] == f"{ms['median']:.2f} ms median, {ms['p95']:.2f} ms 95 %, {ms['p99']:.2f} ms 99 %"
    )
    assert (shown["energy a frame"] == "unknown") == (figures["joules_per_frame"] is None)


def test_bench_shows_a_table(make_recording: Callable[..., Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", str(make_recording()), "--rounds", "1", "--max-frames", "2"]) == 0
    shown = capsys.readouterr().out
    for name in ("speed", "tracking a frame", "processor a frame", "peak memory", "energy a frame"):
        assert name in shown


def counter(folder: Path, name: str, microjoules: int, largest: int = 999_999) -> Path:
    """A RAPL counter as the kernel lays it out."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "name").write_text(f"{name}\n")
    (folder / "max_energy_range_uj").write_text(f"{largest}\n")
    (folder / "energy_uj").write_text(f"{microjoules}\n")
    return folder / "energy_uj"


def test_energy_is_that_of_all_packages_past_a_restart_of_their_counters(tmp_path: Path) -> None:
    first = counter(tmp_path / "intel-rapl:0", "package-0", 100_000)
    second = counter(tmp_path / "intel-rapl:1", "package-1", 900_000)
    core = counter(tmp_path / "intel-rapl:0:0", "core", 0)
    meter = EnergyMeter(tmp_path)
    assert meter.joules() == 0.0
    first.write_text("350000\n")
    core.write_text("200000\n")  # a part of its package
    assert meter.joules() == pytest.approx(0.25)
    second.write_text("400000\n")  # past the largest
    assert meter.joules() == pytest.approx(0.25 + 0.5)


def test_energy_is_unknown_where_the_kernel_does_not_tell(tmp_path: Path) -> None:
    assert EnergyMeter(tmp_path / "nowhere").joules() is None
    unreadable = counter(tmp_path / "intel-rapl:0", "package-0", 0)
    unreadable.write_text("")
    assert EnergyMeter(tmp_path).joules() is None
