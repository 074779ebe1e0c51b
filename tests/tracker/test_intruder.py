"""Something moves in front of the view: it is not taken for the world, and nothing begins on it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from rendered import Film, rotation_deg

from idrgbdo_torch.definitions.se3 import inverse
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.odometry import Run, Status, run
from idrgbdo_torch.synthetic.disturbance import Thing, thing
from idrgbdo_torch.tracker.glances import look, sight
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo
from idrgbdo_torch.tracker.intruder import blocked, some_views, without_intruder

Place = Callable[[int], tuple[int, int]]


def with_thing(frames: Sequence[RgbdFrame], what: Thing, during: range, place: Place) -> list[RgbdFrame]:
    """The frames with a thing in front of the view for a while, at a place (px) by the frame's number."""
    return [what.before(f, *place(n)) if n in during else f for n, f in enumerate(frames)]


def worst_ok(done: Run, desk: Film) -> tuple[float, float]:
    """The largest error among ok frames: metres, degrees."""
    off = [
        inverse(desk.T(0, n)) @ record.result.T_world_cam
        for n, record in enumerate(done.records)
        if record.result.status is Status.OK
    ]
    return max(float(E[:3, 3].norm()) for E in off), max(rotation_deg(E) for E in off)


@pytest.mark.parametrize(("share", "least"), [(0.3, 36), (0.6, 20)])
def test_a_thing_fixed_to_the_camera_hides_what_it_hides_and_no_more(desk: Film, share: float, least: int) -> None:
    what = thing(round(320 * share**0.5), round(240 * share**0.5), 8)
    frames = with_thing(desk.frames, what, range(10, 30), lambda n: (40, 30))
    done = run(IdRgbdo(), frames)
    metres, degrees = worst_ok(done, desk)
    assert metres < 0.02 and degrees < 1.0
    assert done.statuses.count(Status.OK) >= least


def test_a_passer_by_who_fills_the_view_is_waited_for(desk: Film) -> None:
    what = thing(500, 340, 7)
    frames = with_thing(desk.frames, what, range(6, 40), lambda n: (min(-500 + 30 * (n - 6), -50), -50))
    odometry = IdRgbdo()
    done = run(odometry, frames)
    metres, degrees = worst_ok(done, desk)
    assert metres < 0.05 and degrees < 2.0
    assert {record.result.segment for record in done.records} == {0}
    assert done.statuses[-1] is Status.LOST and "blocks the view" in done.records[-1].result.reason


def test_a_keyframe_leaves_out_what_stands_where_nothing_was(desk: Film) -> None:
    odometry = IdRgbdo()
    run(odometry, desk.frames[:2])
    assert odometry.reference is not None
    before = odometry.reference.keyframe
    frame = odometry.motion.frame
    assert frame is not None
    known = some_views({0: (before, np.eye(4))}, desk.T(1, 0).numpy())
    plain = odometry._keyframe(frame)
    assert plain is not None and without_intruder(plain, known) is plain
    assert not blocked(frame, known)
    what = thing(160, 240, 3)
    other = IdRgbdo()
    run(other, [desk.frames[0], what.before(desk.frames[1], 0, 0)])
    spoilt = other.motion.frame
    assert spoilt is not None
    whole = odometry._keyframe(spoilt)
    assert whole is not None
    kept = without_intruder(whole, known)
    assert kept is not None and blocked(spoilt, known)
    assert kept.points.uv[:, 0].min() > 155 and (whole.points.uv[:, 0] < 150).sum() > 100
    assert (kept.frame.depth[20:220, 10:150] < 0).mean() > 0.95  # which the next keyframe knows as the thing
    assert len(kept.coarse) == len(np.unique(kept.coarse)) and kept.coarse.max() < len(kept.points.uv)
    again = look(whole.points.uv, whole.points.inv_depth, whole.frame.intrinsics[0], sight(kept.frame, np.eye(4)))
    assert again.foreign[whole.points.uv[:, 0] < 140].mean() > 0.8
