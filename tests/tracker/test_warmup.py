"""Kernels are compiled before the first frame, said so, kept, and compiled anew when what they call has changed."""

from __future__ import annotations

import logging
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from numba import njit
from numba.core.event import install_listener

from idrgbdo_torch import kernels
from idrgbdo_torch.odometry import Status
from idrgbdo_torch.tracker import warmup
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo

INNER = "from .compiled import kernel\n@kernel\ndef inner(x):\n    return x + {}\n"
OUTER = "from .compiled import kernel\nfrom .inner import inner\n@kernel\ndef outer(x):\n    return 2 * inner(x)\n"


def python(script: str, *, path: Path | None = None, **environment: str) -> str:
    """What a script prints in a process of its own."""
    command = [sys.executable, "-c", script]
    out = subprocess.run(
        command, env={**os.environ, **environment}, cwd=path, capture_output=True, text=True, check=True
    )
    return out.stdout.strip()


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A folder with a package of two kernels, one of which calls the other."""
    folder = tmp_path / "two"
    folder.mkdir()
    (folder / "__init__.py").touch()
    shutil.copy(Path(kernels.__file__).parent / "compiled.py", folder)
    (folder / "inner.py").write_text(INNER.format(1))
    (folder / "outer.py").write_text(OUTER)
    return tmp_path


CALL = "from two.outer import outer; print(outer(1), sum(outer.stats.cache_hits.values()))"


def test_a_kernel_is_kept_and_follows_those_it_calls(package: Path) -> None:
    cache = str(package / "cache")
    assert python(CALL, path=package, NUMBA_CACHE_DIR=cache) == "4 0"
    assert python(CALL, path=package, NUMBA_CACHE_DIR=cache) == "4 1"
    (package / "two" / "inner.py").write_text(INNER.format(100))
    assert python(CALL, path=package, NUMBA_CACHE_DIR=cache) == "202 0"


def test_kernels_work_where_nothing_can_be_kept(package: Path) -> None:
    nowhere = {"NUMBA_CACHE_LOCATOR_CLASSES": "ZipCacheLocator", "NUMBA_CACHE_DIR": ""}  # numba finds no folder
    assert python(CALL, path=package, **nowhere) == "4 0"


def test_the_notice_comes_once_and_only_where_something_is_compiled(caplog: pytest.LogCaptureFixture) -> None:
    first, second = njit(lambda x: x + 1), njit(lambda x: x + 2)
    with caplog.at_level(logging.WARNING), install_listener("numba:compile", warmup.Notice()):
        assert first(1) + second(1) == 5
    assert [record.getMessage() for record in caplog.records] == [warmup.NOTICE]
    caplog.clear()
    with install_listener("numba:compile", warmup.Notice()):
        assert first(1) == 2
    assert not caplog.records


def test_the_tiny_film_can_be_tracked() -> None:
    odometry = IdRgbdo()
    results = [odometry.track(frame) for frame in warmup.tiny_film()]
    assert {result.status for result in results} <= {Status.OK, Status.WEAK}
    assert sum(result.keyframe for result in results) > 1  # so that the window has something to do
    moved = results[-1].T_world_cam[0, 3].item()
    assert moved == pytest.approx((len(results) - 1) * warmup.STEP * warmup.DEPTH_M / 140.0, rel=0.02)


AFTER = """
import importlib, pkgutil
from dataclasses import replace
from idrgbdo_torch import kernels
from idrgbdo_torch.config import Config
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo
from idrgbdo_torch.synthetic import RenderedSequence, SynthConfig
from idrgbdo_torch.tracker.warmup import warm_up

modules = [importlib.import_module(f"{kernels.__name__}.{m.name}") for m in pkgutil.iter_modules(kernels.__path__)]

def variants():
    return {f"{m.__name__}.{k}": len(v.signatures) for m in modules for k, v in vars(m).items() if hasattr(v, "stats")}

warm_up(lambda: IdRgbdo(compile_ahead=False))
before = variants()
film = list(RenderedSequence(SynthConfig(frames=12, width=160, height=120, fx=131.0, fy=131.0, cx=79.5, cy=59.5)))
config = Config()
once = replace(config, selection=replace(config.selection, per_frame=False))
lone = replace(config, window=replace(config.window, enabled=False))
for config in (config, once, lone):
    odometry = IdRgbdo(config)
    for frame in film:
        odometry.track(frame)
    odometry.last_points()
    odometry.map_points()
print({name: count for name, count in variants().items() if count != before[name]})
"""


def test_nothing_is_left_to_compile_after_it() -> None:
    assert python(AFTER) == "{}"
