"""The intrinsics row is as uncertain as the parts of a recording disagree."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from faults import Recording
from rendered import Film

from idrgbdo_torch.check import Verdict, check
from idrgbdo_torch.check.calibration import _disagreement, _Fit
from idrgbdo_torch.datasets import open_sequence


def fit(focal: float, sigma: float, center: float = 0.0) -> _Fit:
    return _Fit(np.array([focal, center, 0.0]), np.array([sigma, sigma, sigma]), 0.5, np.zeros((1, 6)))


def test_parts_that_disagree_widen_the_deviations() -> None:
    assert _disagreement([fit(0.01, 0.01), fit(-0.01, 0.01), fit(0.0, 0.01)]) == 1.0
    assert _disagreement([fit(0.1, 0.01), fit(-0.1, 0.01)]) == pytest.approx(np.sqrt(200 / 3))
    assert _disagreement([fit(0.0, 0.01, 0.1), fit(0.0, 0.01, -0.1)]) == pytest.approx(np.sqrt(200 / 3))
    assert _disagreement([fit(0.0, 0.01), fit(-6.0, 0.01), fit(0.4, 0.9)]) == 1.0  # two that tell nothing


def test_a_good_film_stays_as_certain(desk: Film) -> None:
    calibration = check(Recording(list(desk.frames))).measured.calibration
    assert calibration is not None
    assert calibration.focal_sigma < 0.02
    assert abs(calibration.focal_factor - 1) < 4 * calibration.focal_sigma


@pytest.mark.parametrize(("name", "start"), [("azure_arm_61", 0), ("d435_desk_200", 0), ("d435_desk_200", 100)])
def test_factory_intrinsics_are_no_fault(data_dir: Path, name: str, start: int) -> None:
    report = check(open_sequence(data_dir / name, start=start))
    (row,) = (finding for finding in report.findings if finding.name == "intrinsics")
    assert row.verdict is not Verdict.FAULT
