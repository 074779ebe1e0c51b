"""What moves with the camera from the first frame on, and what comes into view, are told from the world."""

from __future__ import annotations

import numpy as np
import pytest
from fuzz.stress import Film as Stressed
from fuzz.stress import error, something, tally
from rendered import Film

from idrgbdo_torch.frame import prepare
from idrgbdo_torch.kernels.se3 import inverse
from idrgbdo_torch.odometry import Status
from idrgbdo_torch.synthetic.disturbance import thing
from idrgbdo_torch.tracker.carried import in_front
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo

SHARE = 0.3  # of the image that the thing takes


@pytest.fixture
def odometry(desk: Film) -> IdRgbdo:
    """After a film in which a thing hangs before the camera from the first frame on."""
    what = thing(round(320 * SHARE**0.5), round(240 * SHARE**0.5), 8)
    tracker = IdRgbdo()
    film = Stressed("desk", [what.before(f, 70, 50) for f in desk.frames], desk.groundtruth.T_world_cam.numpy())
    counted = tally([(n, tracker.track(frame)) for n, frame in enumerate(film.frames)], film.T_world_cam)
    assert not counted.off and counted.good >= 36 and counted.doubted <= 2, str(counted)
    return tracker


def test_what_moves_with_the_camera_is_left_out_and_stays_known(odometry: IdRgbdo) -> None:
    carried, reference = odometry.motion.carried, odometry.reference
    assert carried is not None and carried.settled and carried.thing is not None and reference is not None
    assert (carried.thing[60:170, 85:230] > 0).mean() > 0.95 and (carried.thing > 0).mean() < 0.45
    u, v = reference.keyframe.points.uv.astype(int).T
    assert not ((u > 80) & (u < 235) & (v > 60) & (v < 170)).any()
    assert odometry.window_keyframes() and not odometry.motion.doubt
    assert all(place.keyframe.intruded for place in odometry.history.places.kept)  # none of before it was known


def test_what_moves_with_the_camera_is_told_before_the_pose_is_far_off(desk: Film) -> None:
    rng = np.random.default_rng(3)
    what, left, top = something(desk.frames[0], SHARE**0.5, SHARE**0.5, rng)
    left, top = (round(place * rng.uniform(0, 2)) for place in (left, top))
    tracker = IdRgbdo()
    results = [tracker.track(what.before(frame, left, top)) for frame in desk.frames[:6]]
    away = [error(r.T_world_cam.numpy(), inverse(desk.T(n, 0).numpy()))[0] for n, r in enumerate(results)]
    assert max(x for x, r in zip(away, results, strict=True) if r.status is Status.OK) < 0.03, away
    assert max(away[4:]) < 0.005 and results[5].status is Status.OK


def test_a_camera_that_moves_freely_carries_nothing(desk: Film) -> None:
    tracker = IdRgbdo()
    statuses = [tracker.track(frame).status for frame in desk.frames]
    assert set(statuses) == {Status.OK} and tracker.motion.carried is None


def test_who_walks_before_a_camera_at_rest_does_not_make_the_room_a_thing(desk: Film) -> None:
    what, tracker = thing(100, 280, 7), IdRgbdo()
    for n in range(20):
        tracker.track(what.before(desk.frames[0], 40 + 9 * n, -20))
        assert tracker.motion.carried is None or tracker.motion.carried.thing is None


def test_a_thing_is_nearer_than_what_is_around_it(desk: Film) -> None:
    frame = thing(160, 120, 3).before(desk.frames[0], 80, 60)
    tracker = IdRgbdo()
    tracker.track(frame)
    carried = tracker.motion.carried
    assert carried is not None
    first, step = carried.keyframe.frame, 320 // carried.texture.shape[1]
    depth = first.depth[step // 2 :: step, step // 2 :: step]
    mask = (depth > 0.0) & (depth < 0.65)
    assert mask.mean() > 0.2
    assert in_front(mask, first, first) and not in_front(~mask, first, first)


def test_a_frame_without_the_thing_keeps_the_rest(odometry: IdRgbdo, desk: Film) -> None:
    carried = odometry.motion.carried
    assert carried is not None
    frame = prepare(thing(round(320 * SHARE**0.5), round(240 * SHARE**0.5), 8).before(desk.frames[-1], 70, 50))
    depth = carried.beside(frame).depth
    assert (depth[60:170, 85:230] < 0).mean() > 0.95 and (depth[:25] >= 0).mean() > 0.9
    gone = prepare(desk.frames[-1])
    assert carried.beside(gone) is gone
    last = odometry.motion.glances.kept[-1].depth  # in which the rest of its surroundings is not taken for it
    assert (last[16:42, 22:57] < 0).mean() > 0.95 and (last[:6] >= 0).mean() > 0.9
