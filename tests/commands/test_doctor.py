"""The doctor tells what is installed, tests tracking, and says what is wrong in lines one can act on."""

from __future__ import annotations

import sys
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import pytest
import torch

from idrgbdo_torch import __version__
from idrgbdo_torch.commands import doctor
from idrgbdo_torch.commands.cli import main


def test_everything_is_in_order_here(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor"]) == 0
    out = capsys.readouterr().out
    assert out.rstrip().endswith("all in order")
    for word in (__version__, torch.__version__, "open3d", "viewer", "ros", "cluster", "cores", "self-test", "ATE"):
        assert word in out
    assert "BAD" not in out


def test_the_self_test_can_be_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--no-self-test"]) == 0
    assert "ATE" not in capsys.readouterr().out


def test_a_missing_package_is_named_with_the_way_to_get_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(doctor.NEEDED, "no-such-package", "no_such_package")
    assert main(["doctor", "--no-self-test"]) == 1
    out = capsys.readouterr().out
    assert "BAD  no-such-package" in out
    assert "pip install no-such-package" in out
    assert "not in order: no-such-package" in out


def test_a_missing_extra_is_no_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(doctor.EXTRAS, "ros", {"no-such-package": "no_such_package"})
    item = next(item for item in doctor.extras() if item.name == "extra ros")
    assert item.good
    assert 'pip install "idrgbdo_torch[ros]"' in item.value


def test_what_decodes_is_named_and_a_missing_library_is_no_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    png, jpeg = doctor.decoders()
    assert png.value == f"libdeflate, by deflate {version('deflate')}; OpenCV for unusual files"
    assert jpeg.value == f"libjpeg-turbo, by simplejpeg {version('simplejpeg')}; OpenCV for unusual files"
    monkeypatch.setitem(sys.modules, "deflate", None)
    png, _ = doctor.decoders()
    assert png.good
    assert png.value == "OpenCV; faster with libdeflate: pip install deflate"


def test_bad_tracking_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "FILM", replace(doctor.FILM, kind="poor", frames=12))
    item = doctor.self_test()
    assert not item.good
    assert "expected no lost frame" in item.advice


def test_a_cache_that_cannot_be_written_is_noticed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(doctor.os, "access", lambda path, mode: tmp_path not in (path, *Path(path).parents))
    demos, kernels = doctor.caches()
    assert not demos.good
    assert str(tmp_path) in demos.advice
    assert kernels.good
