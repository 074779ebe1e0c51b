"""Beside something in front poses far apart explain the few points left: motion and the last frames say which."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fuzz import stress
from fuzz.stress import something, tally
from rendered import Film

from idrgbdo_torch.frame import prepare
from idrgbdo_torch.kernels.se3 import retract
from idrgbdo_torch.synthetic.disturbance import thing
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo
from idrgbdo_torch.tracker.motion import Motion
from idrgbdo_torch.tracker.recovery import Found
from idrgbdo_torch.tracker.verification import LIMITS, Verdict

DT = 1.0 / 30.0  # s


def at(x: float) -> np.ndarray:
    """T_cam_world of a camera x m along its way."""
    return retract(np.array([-x, 0.0, 0.0, 0.0, 0.0, 0.0]), np.eye(4))


def moved_along(desk: Film, places: list[float]) -> Motion:
    motion, frame = Motion.at(at(0.0)), prepare(desk.frames[0])
    for n, x in enumerate(places):
        motion.move(at(x), replace(frame, timestamp=n * DT), DT if n else 0.0)
    return motion


def test_a_leap_is_what_no_hand_does(desk: Film) -> None:
    motion = moved_along(desk, [0.0, 0.02, 0.04, 0.06])
    assert not motion.leaps(at(0.08), 4 * DT) and not motion.leaps(at(0.09), 4 * DT)  # 9 m/s^2
    assert motion.leaps(at(0.14), 4 * DT) and motion.leaps(at(0.02), 4 * DT)
    assert not motion.leaps(at(0.14), 6 * DT)  # after more time
    assert not moved_along(desk, [0.0]).leaps(at(0.2), DT)  # nothing is known of its velocity


def test_who_comes_back_from_a_leap_does_not_leap(desk: Film) -> None:
    motion = moved_along(desk, [0.0, 0.02, 0.04, 0.14])
    assert not motion.leaps(at(0.08), 4 * DT)
    assert motion.leaps(at(0.02), 4 * DT)


@pytest.mark.parametrize(("seed", "stride", "share"), [(6, 2, 0.7), (1, 1, 0.8)])
def test_no_pose_far_off_is_ok_beside_what_fills_most_of_the_view(
    desk: Film, seed: int, stride: int, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stress, "OFF_M", 0.07)  # m: poses that leap are further off than what ten points drift by
    rng, tracker, shown = np.random.default_rng(seed), IdRgbdo(), []
    what, left, top = something(desk.frames[0], share**0.5, share**0.5, rng)
    left, top = (round(place * rng.uniform(0, 2)) for place in (left, top))
    for k, frame in enumerate(desk.frames[::stride]):
        shown.append((k * stride, tracker.track(replace(what.before(frame, left, top), timestamp=k * DT))))
    counted = tally(shown, desk.groundtruth.T_world_cam.numpy())
    assert not counted.off and counted.ok >= 4, str(counted)


def test_what_is_found_again_beside_a_thing_is_held_against_the_last_frames(desk: Film) -> None:
    tracker, what = IdRgbdo(), thing(150, 300, 3)
    for n in range(24):
        tracker.track(what.before(desk.frames[n], 220, -30) if n > 8 else desk.frames[n])
    assert tracker.motion.contested and tracker.reference is not None and tracker.last is not None
    frame, number = prepare(what.before(desk.frames[24], 220, -30)), len(tracker.history.keyframe_poses) - 1
    sure, tracked = Verdict(0.9, 0.8, 0.85, points=100, depths=100), tracker.last[1]
    right = desk.T(24, 0).numpy() @ np.linalg.inv(tracker.history.keyframe_poses[number])
    found = Found(number, replace(tracked, T_frame_kf=right), sure)
    confirmed = tracker._found(frame, found)
    assert confirmed is not None and LIMITS.weak + LIMITS.lately_above < confirmed.verdict.lately < 1.0
    away = retract(np.array([0.06, 0.0, 0.0, 0.0, 0.0, 0.0]), right)
    assert tracker._found(frame, Found(number, replace(tracked, T_frame_kf=away), sure)) is None
    whole = Found(number, replace(tracked, T_frame_kf=away), Verdict(0.9, 0.95, 0.95, points=200, depths=200))
    assert tracker._found(frame, whole) is whole  # the same view: nobody else is asked


def test_nothing_that_is_astray_becomes_a_keyframe_or_is_kept(desk: Film) -> None:
    tracker = IdRgbdo()
    for frame in desk.frames[:3]:
        tracker.track(frame)
    keyframes, glances = len(tracker.history.keyframe_poses), list(tracker.motion.glances.kept)
    tracker.motion.contested = tracker.motion.astray = True  # and no older keyframe can say that it is not
    for frame in desk.frames[3:8]:
        assert not tracker.track(frame).keyframe and tracker.motion.astray
    assert len(tracker.history.keyframe_poses) == keyframes and tracker.motion.glances.kept == glances
