"""Configuration files: differences over defaults, round trips, and errors that say what to do."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import pytest

from idrgbdo_torch.config import Config
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.text import configfile
from idrgbdo_torch.text.configfile import Count, Fraction, NonNegative, Positive


@dataclass(frozen=True)
class Inner:
    mode: Literal["rand", "inf+grid"] = "inf+grid"
    points: Count = 24
    share: Fraction = 0.5
    sigma: Positive = 4.0
    levels: tuple[int, ...] = (3, 2, 1)
    enabled: bool = True


@dataclass(frozen=True)
class Outer:
    name: str = 'a "b" \\ c'
    limit: NonNegative | None = None
    file: Path | None = None
    inner: Inner = field(default_factory=Inner)


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "some.toml"
    path.write_text(text)
    return path


def test_a_file_holds_only_differences(tmp_path: Path) -> None:
    loaded = configfile.load(write(tmp_path, "limit = 2\n[inner]\npoints = 256\nlevels = [1, 0]"), Outer())
    assert loaded == Outer(limit=2.0, inner=Inner(points=256, levels=(1, 0)))
    assert isinstance(loaded.limit, float)


@pytest.mark.parametrize("config", [Outer(), Outer(limit=1e-8, file=Path("a/b"), inner=Inner(enabled=False)), Config()])
def test_dump_and_load_round_trip(tmp_path: Path, config: Outer | Config) -> None:
    text = configfile.dump(config)
    tomllib.loads(text)
    assert configfile.load(write(tmp_path, text), type(config)()) == config


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("[inner]\npints = 3", "inner.pints: no such key; did you mean 'points'?"),
        ("[iner]\npoints = 3", "iner: no such key; did you mean 'inner'?"),
        ("zzz = 3", "zzz: no such key; the keys here are name, limit, file, inner"),
        ("[inner]\npoints = 0", "inner.points: expected a whole number at least 1, got 0"),
        ("[inner]\npoints = 2.5", "inner.points: expected a whole number"),
        ("[inner]\npoints = true", "inner.points: expected a whole number at least 1, got True"),
        ("[inner]\nshare = 1.5", "inner.share: expected a number at least 0 and at most 1, got 1.5"),
        ("[inner]\nsigma = 0", "inner.sigma: expected a number above 0, got 0"),
        ("[inner]\nsigma = nan", "inner.sigma: expected a number above 0, got nan"),
        ("[inner]\nmode = 'inf+gird'", "inner.mode: expected one of 'rand', 'inf+grid', got 'inf+gird'"),
        ("[inner]\nenabled = 1", "inner.enabled: expected true or false, got 1"),
        ("[inner]\nlevels = [1, 'a']", "inner.levels: expected a list, each a whole number"),
        ("limit = -1", "limit: expected a number at least 0, got -1"),
        ("inner = 3", "inner: expected a table, got 3"),
        ("name = ", "is not TOML"),
    ],
)
def test_errors_name_file_key_and_remedy(tmp_path: Path, text: str, complaint: str) -> None:
    with pytest.raises(IdRgbdoError) as caught:
        configfile.load(write(tmp_path, text), Outer())
    assert "some.toml" in str(caught.value)
    assert complaint in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(IdRgbdoError, match=r"cannot read .*none\.toml"):
        configfile.load(tmp_path / "none.toml", Outer())


def test_check_finds_what_a_constructor_let_through() -> None:
    configfile.check(Outer())
    configfile.check(Config())
    with pytest.raises(IdRgbdoError, match=r"^inner\.points: expected a whole number at least 1, got -3"):
        configfile.check(Outer(inner=Inner(points=-3)))


def test_shipped_configurations_load() -> None:
    for path in sorted((Path(__file__).parents[2] / "configs").glob("*.toml")):
        configfile.check(configfile.load(path, Config()))
