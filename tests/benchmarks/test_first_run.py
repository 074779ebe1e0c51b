"""The first run after an installation: compiled before its first frame, and the same bits as every later run."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

SCRIPT = """
import hashlib, time
from idrgbdo_torch import IdRgbdo
from idrgbdo_torch.synthetic import RenderedSequence, SynthConfig

begin = time.perf_counter()
odometry = IdRgbdo()
ready = time.perf_counter() - begin
film = RenderedSequence(SynthConfig(frames=60, width=160, height=120, fx=131.0, fy=131.0, cx=79.5, cy=59.5))
times, digest = [], hashlib.sha256()
for frame in film:
    begin = time.perf_counter()
    result = odometry.track(frame)
    times.append(time.perf_counter() - begin)
    digest.update(result.T_world_cam.numpy().tobytes())
digest.update(odometry.trajectory().T_world_cam.numpy().tobytes())
print(digest.hexdigest(), ready, max(times))
"""


def test_the_first_run_has_the_bits_of_the_later_ones(full: bool, tmp_path: Path, show: Callable[[str], None]) -> None:
    if not full:
        pytest.skip("compiles all kernels anew, some half minute; with --benchmark-enable")
    runs = []
    for _ in range(3):
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
        done = subprocess.run(
            [sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, check=True
        )
        bits, ready, longest = done.stdout.split()
        runs.append((bits, done.stderr.count("compiling the kernels")))
        show(f"ready after {float(ready):.1f} s, the longest frame {1e3 * float(longest):.0f} ms")
    assert [notices for _, notices in runs] == [1, 0, 0]
    assert len({bits for bits, _ in runs}) == 1
