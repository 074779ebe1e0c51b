"""The scenarios of stress on a short film; the whole of them is `python -m tests.fuzz --stress`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fuzz import stress
from rendered import Film

from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo

SHORT = ("plain", "exposure", "flip", "moving 30%", "fixed 30%", "mounted 30%", "mounted 60%", "holes 30%")


@pytest.mark.parametrize("name", SHORT)
def test_no_pose_that_is_off_is_called_ok(desk: Film, name: str) -> None:
    film = stress.Film("desk", desk.frames, desk.groundtruth.T_world_cam.numpy())
    counted = stress.stressed(film, name, 0)
    assert not counted.off, str(counted)
    assert counted.ok >= 20, str(counted)


def test_what_comes_in_as_fast_as_the_view_turns_is_no_part_of_the_world() -> None:
    film = stress.rendered(0, 70)  # the thing covers the right border while that sees more and more of the desk
    counted = stress.stressed(film, "moving 60%", 0)
    assert not counted.off, str(counted)
    assert counted.ok >= 45, str(counted)


@pytest.mark.parametrize(("seed", "share", "px"), [(0, 0.3, 7), (3, 0.3, 7), (4, 0.45, 5)])
def test_what_the_newest_keyframe_shows_itself_is_told_by_those_before(
    desk: Film, seed: int, share: float, px: int
) -> None:
    what, _, top = stress.something(desk.frames[0], share, 1.2, np.random.default_rng(seed))
    shown = []  # a fast camera, and somebody who comes in from the right: before any pose can tell, part of a keyframe
    for k, frame in enumerate(desk.frames[::2]):
        rgbd = frame if k <= 3 else what.before(frame, 320 - px * (k - 3), top)
        shown.append((2 * k, replace(rgbd, timestamp=k / 30.0)))
    tracker = IdRgbdo()
    counted = stress.tally([(n, tracker.track(rgbd)) for n, rgbd in shown], desk.groundtruth.T_world_cam.numpy())
    assert not counted.off and counted.good == 20 and not counted.doubted, str(counted)
    assert tracker.reference is not None and tracker.reference.keyframe.intruded


def test_what_is_off_is_counted(desk: Film) -> None:
    film = stress.Film("desk", desk.frames, desk.groundtruth.T_world_cam.numpy().copy())
    film.T_world_cam[30:, :3, 3] += 0.1
    counted = stress.stressed(film, "plain", 0)
    assert counted.off == list(range(30, 40)) and counted.good == 30 and counted.doubted == 0
    metres, degrees = stress.error(np.eye(4), np.diag([-1.0, -1.0, 1.0, 1.0]))
    assert metres == 0 and degrees == pytest.approx(180)
