"""Kernels are compiled before the first frame, said so, kept, and compiled anew when what they call has changed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from numba import njit
from numba.core.event import install_listener
from torch import Tensor

from idrgbdo_torch import kernels
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.odometry import Status, TrackResult
from idrgbdo_torch.tracker import warmup
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo
from idrgbdo_torch.trajectory import Trajectory

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


class Calling:
    """An odometry that calls a kernel with every frame."""

    name = "calling"

    def __init__(self, kernel: Callable[[int], int]) -> None:
        self.kernel = kernel

    def reset(self, T_world_cam: Tensor | None = None) -> None: ...

    def track(self, frame: RgbdFrame) -> TrackResult:
        self.kernel(1)
        return TrackResult(torch.eye(4, dtype=torch.float64), Status.OK)

    def trajectory(self) -> Trajectory:
        raise NotImplementedError


def test_what_is_missing_is_found_without_compiling_it() -> None:
    kernel = njit(lambda x: x + 1)
    assert "lambda" in warmup.first_missing(lambda config: Calling(kernel)) and not kernel.signatures
    other = threading.Thread(target=njit(lambda x: x + 2), args=(1,))
    with install_listener("numba:compile", warmup.Refusal()):
        other.start()
        other.join()  # whatever other threads compile is theirs
    assert kernel(1) == 2
    assert warmup.first_missing(lambda config: Calling(kernel)) == ""


def test_the_process_that_helps_to_compile_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Once for all configurations: asking a second time for its output raised, and all was begun again."""
    python_of, kernel = warmup.python, njit(lambda x: x + 3)
    monkeypatch.setattr(warmup, "python", lambda script: python_of("pass"))
    warmup.compile_all(lambda config: Calling(kernel))
    assert kernel.signatures


def test_a_process_has_the_modules_of_this_one(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "only_here.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    process = warmup.python("import only_here, idrgbdo_torch")
    assert process is not None and process.wait() == 0
    monkeypatch.setattr(sys, "executable", "")
    assert warmup.python("pass") is None


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
from idrgbdo_torch.config import Config, KeyframeConfig, WindowConfig
from idrgbdo_torch.definitions.camera import Pinhole
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo
from idrgbdo_torch.synthetic import RenderedSequence, SynthConfig

modules = [importlib.import_module(f"{kernels.__name__}.{m.name}") for m in pkgutil.iter_modules(kernels.__path__)]

def variants():
    return {f"{m.__name__}.{k}": len(v.signatures) for m in modules for k, v in vars(m).items() if hasattr(v, "stats")}

IdRgbdo()
before = variants()
film = list(RenderedSequence(SynthConfig(frames=20, width=240, height=180, fx=197.0, fy=197.0, cx=119.5, cy=89.5)))
dark = [replace(f, gray=0 * f.gray, depth=0 * f.depth) for f in film[:5]]  # until a new segment starts,
turned = [replace(f, gray=f.gray.flip(1), depth=f.depth.flip(1)) for f in film[:6]]  # with another view,
story = [*film[:12], dark[0], *film[13:16], *dark, *turned, *film[6:16]]  # from which the earlier one is found again
story = [replace(f, timestamp=n / 30, camera=Pinhole(width=240, height=180, fx=197, fy=197, cx=119.5, cy=90))
         for n, f in enumerate(story)]
base = Config(keyframe=KeyframeConfig(threshold_bits=0.1), window=WindowConfig(keyframes=3))
changes = [  # together every option that may lead to another kernel, and numbers without a decimal point
    {},
    {"selection": {"mode": "rand", "distance": 5, "spread": 0, "margin": 9}, "window": {"removal": "information"},
     "noise": {"variance": "paper", "blur": 0, "huber": 8, "c_h": 1}, "tracking": {"blur": 0, "sigma_turn": 1}},
    {"selection": {"mode": "grid", "per_frame": False}, "noise": {"depth_residual": False},
     "tracking": {"slant": True, "levels": 6}, "keyframe": {"criterion": "ratio"}, "window": {"removal": "oldest"}},
    {"selection": {"mode": "inf"}, "tracking": {"levels": 1, "patch": 1},
     "window": {"points": 50, "first_estimates": False}},
    {"selection": {"points": 100}, "window": {"enabled": False}},
]
seen = set()
for change in changes:
    odometry = IdRgbdo(replace(base, **{part: replace(getattr(base, part), **new) for part, new in change.items()}))
    seen |= {r.reason.split(" ")[0] + r.status.value for r in map(odometry.track, story)}
    for look in ("last_points", "last_candidates", "map_points", "trajectory", "window_keyframes"):
        getattr(odometry, look)()
assert {"ok", "foundweak", "alost"} <= seen, seen  # a new segment starts, and the first one is found again
print({name: count for name, count in variants().items() if count != before[name]})
"""


def test_nothing_is_left_to_compile_after_it() -> None:
    assert python(AFTER) == "{}"
