"""The scenarios of stress on a short film; the whole of them is `python -m tests.fuzz --stress`."""

from __future__ import annotations

import numpy as np
import pytest
from fuzz import stress
from rendered import Film

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


def test_what_is_off_is_counted(desk: Film) -> None:
    film = stress.Film("desk", desk.frames, desk.groundtruth.T_world_cam.numpy().copy())
    film.T_world_cam[30:, :3, 3] += 0.1
    counted = stress.stressed(film, "plain", 0)
    assert counted.off == list(range(30, 40)) and counted.good == 30 and counted.doubted == 0
    metres, degrees = stress.error(np.eye(4), np.diag([-1.0, -1.0, 1.0, 1.0]))
    assert metres == 0 and degrees == pytest.approx(180)
