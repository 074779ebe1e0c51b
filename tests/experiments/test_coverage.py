"""Coverage: right covariances cover what they should, wrong ones do not, and the experiment measures both kinds."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from idrgbdo_torch.commands.cli import main
from idrgbdo_torch.definitions.se3 import exp, inverse
from idrgbdo_torch.experiments.coverage import SHARES, distances, divided, shares_inside, squared
from idrgbdo_torch.experiments.task import Clip
from idrgbdo_torch.odometry import Record, Status, TrackResult
from idrgbdo_torch.synthetic import SynthConfig, synth
from idrgbdo_torch.trajectory import Trajectory

SIGMA = np.array([0.03, 0.01, 0.002, 0.001, 0.004, 0.02])  # m and rad
FILM = SynthConfig(kind="desk", frames=40, width=160, height=120, fx=131.0, fy=131.0, cx=79.5, cy=59.5, samples=1)


def film_of_frames(count: int, truly: float) -> tuple[list[Record], Trajectory]:
    """Frames against one keyframe, wrong by `truly` times what their information says."""
    rng = np.random.default_rng(1)
    T_world_first = exp(torch.tensor([1.0, 2.0, 0.5, 0.4, -1.0, 0.2], dtype=torch.float64))  # of the reference
    poses, records = [torch.eye(4, dtype=torch.float64)], []
    records.append(Record(0.0, TrackResult(poses[0], Status.OK, keyframe=True), 0.0, 1.0))
    for number in range(1, count):
        true = exp(torch.from_numpy(rng.normal(size=6) * 0.3))
        error = exp(torch.from_numpy(truly * SIGMA * rng.normal(size=6)))
        found = inverse(error @ inverse(true))
        information = torch.diag(torch.from_numpy(SIGMA**-2))
        result = TrackResult(found, Status.OK, reference_time=0.0, T_ref_cam=found, information=information)
        records.append(Record(number / 30, result, 0.0, 1.0))
        poses.append(true)
    times = torch.arange(count, dtype=torch.float64) / 30
    return records, Trajectory(times, T_world_first @ torch.stack(poses))


def test_a_right_covariance_covers_what_it_says_and_a_wrong_one_does_not() -> None:
    right, sure, careful = (distances(*film_of_frames(*film)) for film in ((1500, 1.0), (300, 3.0), (300, 0.3)))
    for kind in ("world", "keyframe"):
        assert len(right[kind]) == 1499
        assert shares_inside(np.array(right[kind])) == pytest.approx(SHARES, abs=0.03)
        assert shares_inside(np.array(sure[kind]))[2] < 0.4
        assert shares_inside(np.array(careful[kind]))[0] > 0.99


def test_distances_do_not_depend_on_units() -> None:
    covariance = np.diag([1e-8, 1e-8, 1e-8, 1e-2, 1e-2, 1e-2])
    assert squared(np.array([2e-4, 0, 0, 0, 0.1, 0]), covariance) == pytest.approx(5.0)


def test_a_clip_is_tracked_from_several_places_to_its_end() -> None:
    parts = divided(Clip("x", Path("x"), "", 240), 4)
    assert [(part.start, part.frames) for part in parts] == [(0, 240), (60, 180), (120, 120), (180, 60)]
    assert [part.start for part in divided(Clip("x", Path("x"), "", 60, 5, 40), 4)] == [5, 15]


def test_the_command_measures_it_and_draws_it(
    tmp_path: Path, make_recording: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    synth(FILM, tmp_path / "data" / "desk")
    command = ["experiment", "coverage", "--data", str(tmp_path / "data"), "--out", str(tmp_path / "out")]
    assert main([*command, "--quick", "--jobs", "1"]) == 0
    assert "in the world, 95 %: between" in capsys.readouterr().out
    (row,) = csv.DictReader((tmp_path / "out" / "coverage.csv").open())
    assert (row["sequence"], row["frames"], row["lost"]) == ("desk", "40", "0")
    # a short film has few keyframes, and the error of one is that of all frames after it
    assert 50 <= float(row["95 % in the world"]) <= 100 and 60 <= float(row["95 % against the keyframe"]) <= 100
    assert 0.02 < float(row["NEES/6 in the world"]) < 3
    for suffix in ("png", "svg", "pdf", "tex", "md"):
        assert (tmp_path / "out" / f"coverage.{suffix}").stat().st_size > 500
    make_recording("data2/without", groundtruth=False)
    assert main(["experiment", "coverage", "--data", str(tmp_path / "data2"), "--out", str(tmp_path / "out2")]) == 1
    assert "has no reference poses" in capsys.readouterr().err
