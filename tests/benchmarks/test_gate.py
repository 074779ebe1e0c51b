"""The gate fails where a ratio is outside its range, and has a range for every ratio that is measured."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

from gate import RANGES, outside, wanted

HERE = Path(__file__).parent


def test_a_ratio_outside_its_range_is_named_with_what_was_wanted() -> None:
    both, most, least = (
        next(name for name, ends in RANGES.items() if tuple(end is None for end in ends) == kind)
        for kind in ((False, False), (True, False), (False, True))
    )
    for name, (low, high) in RANGES.items():
        for end, way in ((low, -1.0), (high, 1.0)):
            if end is not None:
                assert not outside(name, end) and name in outside(name, end + way * 0.01)
    assert outside(both, float("nan"))
    assert " to " in wanted(both) and "at most" in wanted(most) and "at least" in wanted(least)


def test_every_range_belongs_to_a_ratio_and_every_ratio_has_a_range() -> None:
    text = " ".join(path.read_text() for path in HERE.glob("test_*_cost.py"))
    text += (HERE / "test_targets.py").read_text() + (HERE / "test_latency.py").read_text()
    measured = [
        re.sub(r"\{\w+\}", "(.+)", re.escape(name).replace(r"\{", "{").replace(r"\}", "}"))
        for name in re.findall(r'ratio\(f?"([^"]+)"', text)
    ]
    assert len(measured) > 10
    for name in RANGES:
        assert any(re.fullmatch(pattern, name) for pattern in measured), f"nothing measures {name}"
    for pattern in measured:
        assert any(re.fullmatch(pattern, name) for name in RANGES), f"no range for {pattern}"


MEASURED = """
import pytest

@pytest.mark.parametrize("value", [30.0, 1.0])
def test_measured(value, ratio):
    ratio("batch: the definition over the kernels, 24 points", value)

def test_only_timed(benchmark):
    raise AssertionError("times have no range")
"""


def test_the_gate_measures_ratios_alone_and_fails_outside_their_ranges(tmp_path: Path) -> None:
    (tmp_path / "conftest.py").write_text((HERE / "conftest.py").read_text())
    (tmp_path / "test_measured.py").write_text(MEASURED)
    paths = os.pathsep.join(str(path) for path in (HERE, HERE.parent, HERE.parent.parent))
    command = [sys.executable, "-m", "pytest", "--gate", "-p", "no:dash", "-p", "no:cacheprovider", "."]
    done = subprocess.run(
        command, cwd=tmp_path, env=os.environ | {"PYTHONPATH": paths}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1 and "1 failed, 1 passed, 1 deselected" in done.stdout, done.stdout
    assert "24 points: 1, at least 20 wanted" in done.stdout
