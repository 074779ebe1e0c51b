"""A second of blur: what is measured by blurred keyframes is in doubt until something from before is seen again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from rendered import Film

from idrgbdo_torch.frame import RgbdFrame, prepare
from idrgbdo_torch.kernels.se3 import retract
from idrgbdo_torch.odometry import Status, TrackResult
from idrgbdo_torch.synthetic.disturbance import black, smeared
from idrgbdo_torch.tracker import id_rgbdo, loss
from idrgbdo_torch.tracker.doubt import BLURRED, SETTLED, align_blurred, sharpness
from idrgbdo_torch.tracker.history import History
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo
from idrgbdo_torch.tracker.mapping import NOTHING
from idrgbdo_torch.tracker.tracking import Pair, Tracked


def blurred(film: Film, numbers: Sequence[int], which: Sequence[int]) -> list[RgbdFrame]:
    """These frames, 1/30 s apart, some places of which are smeared over 32 px in changing directions."""
    frames = [replace(film.frames[k], timestamp=n / 30) for n, k in enumerate(numbers)]
    return [smeared(f, 32.0, 0.7 * n) if n in which else f for n, f in enumerate(frames)]


def off_m(film: Film, results: Sequence[TrackResult], numbers: Sequence[int]) -> np.ndarray:
    """Distance of every pose from the truth."""
    pairs = zip(results, numbers, strict=True)
    return np.array([float((r.T_world_cam[:3, 3] - film.T(0, k)[:3, 3]).norm()) for r, k in pairs])


def pair_of(film: Film, frame: RgbdFrame) -> Pair:
    """A frame against the first one as a keyframe."""
    odometry = IdRgbdo()
    odometry.track(film.frames[0])
    assert odometry.reference is not None
    return Pair(prepare(frame, 0.8), odometry.reference.keyframe, odometry.noise, odometry.backend)


def test_a_blurred_frame_is_told_from_a_sharp_one(desk: Film) -> None:
    T = desk.T(2, 0).numpy()
    aside = retract(np.array([0.0, 0, 0, 0, 0.03, 0]), T)  # 8 px off
    assert sharpness(pair_of(desk, desk.frames[2]), T) > 0.9
    assert sharpness(pair_of(desk, desk.frames[2]), aside) > BLURRED
    for angle in (0.0, 1.0, 2.0):
        assert sharpness(pair_of(desk, smeared(desk.frames[2], 20.0, angle)), T) < BLURRED
    away = np.diag([1.0, 1.0, -1.0, 1.0])
    assert sharpness(pair_of(desk, desk.frames[2]), away) == 1.0  # nothing to compare


def test_a_blurred_pose_is_supported_by_what_is_alike_from_afar_and_a_black_one_is_not(desk: Film) -> None:
    T, prior = desk.T(2, 0).numpy(), np.eye(6)
    start = Tracked(T, np.zeros(2), np.zeros((6, 6)), 24, 0, np.arange(24), np.zeros(24))
    _, verdict = align_blurred(pair_of(desk, smeared(desk.frames[2], 32.0, 0.5)), start, prior)
    assert verdict.supported or verdict.bright > 0.61
    without_light = replace(desk.frames[2], gray=black(desk.frames[2]).gray)
    _, verdict = align_blurred(pair_of(desk, without_light), start, prior)
    assert not verdict.supported and verdict.bright < 0.1


def test_what_is_measured_by_blurred_keyframes_is_weak_until_an_earlier_one_is_found(
    desk: Film, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half a second of blur while the camera goes on, and back."""
    monkeypatch.setattr(id_rgbdo, "KEPT_IN_VIEW", 1.0)
    numbers = [*range(12), *range(12, 40, 2), *range(38, 4, -1)]
    odometry, results, doubted, window = IdRgbdo(), [], [], []
    for frame in blurred(desk, numbers, range(12, 26)):
        results.append(odometry.track(frame))
        doubted.append(odometry.history.doubted is not None)
        window.append([keyframe.sharp for keyframe, _ in odometry.window_keyframes().values()])
    off = off_m(desk, results, numbers)
    assert any(doubted[12:26]) and not doubted[11] and not doubted[-1]
    assert Status.LOST not in [result.status for result in results] and {r.segment for r in results} == {0}
    for n in range(1, len(numbers)):
        if doubted[n - 1] and doubted[n]:
            assert results[n].status is Status.WEAK
    assert all(result.status is not Status.OK or error < 0.02 for result, error in zip(results, off, strict=True))
    assert all(sharp == [1.0] * len(sharp) for sharp in window)
    assert off[-5:].max() < 0.005
    assert any("found again in the keyframe of" in result.reason for result in results[26:])


def test_a_doubt_that_lasts_is_taken_as_it_is(desk: Film, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(id_rgbdo, "KEPT_IN_VIEW", 1.0)
    monkeypatch.setattr(loss, "find_near", lambda *_: None)
    monkeypatch.setattr(loss, "find_in_window", lambda *_: None)
    monkeypatch.setattr(loss, "find_in_places", lambda *_: None)
    numbers = [*range(12), *range(12, 40, 2), *[39 - n % 2 for n in range(SETTLED + 12)]]
    odometry, doubted = IdRgbdo(), []
    for frame in blurred(desk, numbers, range(12, 26)):
        odometry.track(frame)
        doubted.append(odometry.history.doubted is not None)
    assert doubted[25] and not doubted[-1]
    assert 25 + SETTLED <= len(doubted) - doubted[::-1].index(True) <= 37 + SETTLED
    assert odometry.window_keyframes()


def test_keyframes_in_doubt_take_their_share_of_what_was_off() -> None:
    history, shift = History(), np.eye(4)
    shift[0, 3] = 0.3
    for n in range(4):
        history.add_keyframe(float(n), np.eye(4), None, NOTHING)
        if n == 1:
            history.doubted = 2
    assert history.known(1) and not history.known(2) and "2.000 s" in history.doubt_reason
    history.settle(4.0, np.eye(4), shift)
    assert [round(float(pose[0, 3]), 6) for pose in history.keyframe_poses] == [0.0, 0.0, 0.1, 0.2]
    assert history.known(3) and not history.doubt_reason


@pytest.mark.parametrize("times", [(7.0, 7.0, 7.0, 7.0, 7.0), (10.0, 10.1, 10.2, 10.3, 2.0), (5.0, 6.0, 0.0, 7.0, 6.5)])
def test_keyframes_move_no_further_than_they_were_off_whatever_the_clock_does(times: tuple[float, ...]) -> None:
    history, shift = History(), np.eye(4)
    shift[0, 3] = 0.3
    for n in range(4):
        history.add_keyframe(times[n], np.eye(4), None, NOTHING)
        if n == 1:
            history.doubted = 2
    history.settle(times[4], np.eye(4), shift)
    assert all(0.0 <= pose[0, 3] <= 0.3 + 1e-9 for pose in history.keyframe_poses)
