"""The configurations that come along: they load, hold only differences, say why, and track."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from rendered import Film

from idrgbdo_torch import IdRgbdo, Status
from idrgbdo_torch.config import Config
from idrgbdo_torch.evaluation import absolute_error
from idrgbdo_torch.text import configfile

CONFIGS = sorted((Path(__file__).parents[2] / "configs").glob("*.toml"))
by_name = pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)


def test_there_are_three() -> None:
    assert [path.stem for path in CONFIGS] == ["accurate", "fast", "paper"]


@by_name
def test_it_holds_only_differences_each_with_its_reason(path: Path) -> None:
    config = configfile.load(path, Config())
    for table, values in tomllib.loads(path.read_text()).items():
        for key in values:
            default = getattr(getattr(Config(), table), key)
            assert getattr(getattr(config, table), key) != default, f"{table}.{key} is the default"
    for line in path.read_text().splitlines():
        if line and line[0] not in "#[":
            assert "  # " in line, f"no reason given: {line}"


@by_name
def test_it_tracks_a_rendered_desk(path: Path, desk: Film) -> None:
    odometry = IdRgbdo(configfile.load(path, Config()))
    results = [odometry.track(frame) for frame in desk.frames]
    assert all(result.status is not Status.LOST for result in results)
    assert absolute_error(odometry.trajectory(), desk.groundtruth).rmse_m < 0.005
    assert len(odometry.map_points()[0]) > 100


def test_the_papers_method_has_no_term_beyond_the_paper() -> None:
    config = configfile.load(CONFIGS[-1], Config())
    assert (config.noise.variance, config.selection.objective, config.keyframe.criterion) == ("paper", "paper", "ratio")
    assert not config.noise.depth_residual
    assert (config.noise.sigma_pixel, config.noise.gradient_blend) == (0.0, 0.0)
    assert (config.selection.points, config.window_points, config.window.keyframes) == (24, 24, 8)
