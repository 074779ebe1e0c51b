"""Verification believes true poses and doubts wrong ones; recovery reaches further than tracking."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from rendered import Film
from tracking_cases import NO_CHANGE, Case, make_cases

from idrgbdo_torch.definitions import se3
from idrgbdo_torch.definitions.photometric import warp
from idrgbdo_torch.frame import prepare
from idrgbdo_torch.tracker.alignment import recover
from idrgbdo_torch.tracker.tracking import Tracked
from idrgbdo_torch.tracker.verification import LIMITS, verify


@pytest.fixture(scope="module")
def cases(desk: Film) -> list[Case]:
    return make_cases(desk)


def moved(tracked: Tracked, change: Callable[[np.ndarray], np.ndarray]) -> Tracked:
    return replace(tracked, T_frame_kf=change(tracked.T_frame_kf))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_good_pose_is_believed_and_one_10_cm_off_is_doubted(cases: list[Case], axis: int) -> None:
    shift = np.zeros((4, 4))
    shift[axis, 3] = 0.1
    for case in cases:
        tracked = case.track()
        good = verify(case.pair(), tracked)
        assert good.doubt(LIMITS.weak) == "" and good.visible > 0.85 and min(good.bright, good.near) > 0.95
        off = verify(case.pair(), moved(tracked, lambda T: T + shift))
        assert off.score < 0.6 * good.score
        assert "of the points agree in" in off.doubt(LIMITS.weak)


def test_a_pose_that_sees_nothing_is_doubted(cases: list[Case]) -> None:
    case = cases[0]
    tracked = case.track()
    away = se3.exp(torch.tensor([0, 0, 0, 0, 1.5, 0], dtype=torch.float64)).numpy()
    seeing_little = verify(case.pair(), moved(tracked, lambda T: away @ T))
    assert "is in view" in seeing_little.doubt(LIMITS.weak)
    few = verify(case.pair(), replace(tracked, points=3))
    assert few.score == 0 and few.doubt(LIMITS.weak) == "only 3 points could be used"
    assert verify(case.pair(), moved(tracked, lambda T: T * np.nan)).doubt(0.1)


def test_a_frame_with_little_depth_is_judged_by_its_brightness_and_one_with_none_is_doubted(cases: list[Case]) -> None:
    case = cases[0]
    tracked = case.track()
    uv = case.keyframe.points.uv[case.keyframe.coarse]
    T = torch.from_numpy(tracked.T_frame_kf)
    d = torch.from_numpy(case.keyframe.points.inv_depth[case.keyframe.coarse])
    u, v = warp(case.frame.camera, torch.from_numpy(uv), d, T).centre[100].long().tolist()
    little = np.zeros_like(case.frame.depth)
    little[v - 2 : v + 4, u - 2 : u + 4] = 9.0  # wrong, but too little to tell
    verdict = verify(case.pair(replace(case.frame, depth=little)), tracked)
    assert verdict.near == 1 and verdict.doubt(LIMITS.weak) == ""
    blind = verify(case.pair(replace(case.frame, depth=np.zeros_like(little))), tracked)
    assert blind.near == 0 and "agree in depth" in blind.doubt(LIMITS.lost)


@pytest.mark.parametrize("level", [0.0, 128.0, 255.0])
def test_an_even_image_explains_nothing(cases: list[Case], desk: Film, level: float) -> None:
    """Its brightness can be fitted to anything, with a gain of nearly zero."""
    case = cases[0]
    even = prepare(replace(desk.frames[3], gray=torch.full_like(desk.frames[3].gray, level)))
    tracked = case.track(frame=even)
    assert tracked.affine[0] < -1
    assert "agree in brightness" in verify(case.pair(even), tracked).doubt(LIMITS.lost)


def turned(case: Case, degrees: float, seed: int) -> np.ndarray:
    """The true pose with this rotation about some axis on top."""
    axis = torch.randn(3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    xi = torch.zeros(6, dtype=torch.float64)
    xi[3:] = torch.nn.functional.normalize(axis, dim=0) * np.radians(degrees)
    return se3.retract(xi, case.T).numpy()


def test_recovery_brings_back_a_guess_that_is_8_degrees_off(cases: list[Case]) -> None:
    for case in cases:
        for seed in range(3):
            guess = turned(case, 8, seed)
            tracked, verdict = recover(case.pair(), [guess], NO_CHANGE, case.choose(24))
            assert case.error(tracked)[0] < 0.002 and verdict.doubt(LIMITS.weak) == ""


def test_recovery_reaches_further_than_tracking(cases: list[Case]) -> None:
    found = {"recover": 0, "track": 0}
    for case in cases:
        for seed in range(4):
            guess = turned(case, 12, seed)
            tracked, verdict = recover(case.pair(), [guess], NO_CHANGE, case.choose(24))
            good = case.error(tracked)[0] < 0.002
            found["recover"] += good
            assert good == (verdict.doubt(LIMITS.weak) == "")  # and it knows
            found["track"] += case.error(case.track(guess=guess))[0] < 0.002
    assert found["recover"] >= 14 and found["recover"] > found["track"]


def test_recovery_takes_the_better_of_its_guesses(cases: list[Case]) -> None:
    case = cases[0]
    nonsense = se3.exp(torch.tensor([0.5, 0, 1.0, 0, 1.0, 0], dtype=torch.float64)).numpy()
    for guesses in ([nonsense, turned(case, 4, 0)], [turned(case, 4, 0), nonsense]):
        tracked, verdict = recover(case.pair(), guesses, NO_CHANGE, case.choose(24))
        assert case.error(tracked)[0] < 0.002 and verdict.doubt(LIMITS.weak) == ""
