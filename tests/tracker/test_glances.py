"""What comes in as fast as the view turns hides nothing that is known: the last frames tell it from the world."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rendered import Film

from idrgbdo_torch.frame import Frame, RgbdFrame, prepare
from idrgbdo_torch.kernels.se3 import inverse, retract
from idrgbdo_torch.synthetic.disturbance import thing
from idrgbdo_torch.tracker.glances import KEPT, STEP, STRIDE, Glance, Glances, Sight, moved, sight
from idrgbdo_torch.tracker.intruder import agreement, looks, outlined

BORDER = 250  # px, to the right of which something stands


def seen_from(glance: Glance, T_frame_world: np.ndarray) -> list[Sight]:
    glances = Glances()
    glances.add(glance)
    return glances.sights(T_frame_world)


def grid(frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    v, u = (x.ravel() for x in np.mgrid[4:236:STEP, 4:316:STEP])
    z = frame.depth[v, u].astype(np.float64)
    return np.column_stack([u, v]).astype(np.float64), np.divide(1.0, z, out=np.zeros_like(z), where=z > 0)


def two(desk: Film, shift_px: int) -> tuple[Frame, Glance, np.ndarray]:
    """A frame with a thing at its right border, a frame before with the thing so far beside, and the frame's pose."""
    what = thing(200, 280, 3)
    later, before = (
        prepare(what.before(desk.frames[n], left, -20)) for n, left in ((14, BORDER), (10, BORDER + shift_px))
    )
    T_later, T_before = desk.T(14, 0).numpy(), desk.T(10, 0).numpy()
    return later, Glance.of(before, T_before), T_later


@pytest.mark.parametrize("gain", [1.0, 0.7])
def test_the_world_looks_as_it_did(desk: Film, gain: float) -> None:
    rgbd = desk.frames[10]
    darker = RgbdFrame(rgbd.timestamp, gain * rgbd.gray + 4.0, rgbd.depth, rgbd.camera)
    frame, T = prepare(desk.frames[14]), desk.T(14, 0).numpy()
    uv, inv_depth = grid(frame)
    others = seen_from(Glance.of(prepare(darker), desk.T(10, 0).numpy()), T)
    unlike, judged = moved(uv, frame, looks(uv, inv_depth, frame.intrinsics[0], others), np.ones(len(uv), np.bool_))
    assert judged.mean() > 0.6 and not (unlike & ~judged).any()
    assert unlike.sum() < 0.05 * judged.sum()


def test_what_moves_by_itself_looks_otherwise_and_is_outlined(desk: Film) -> None:
    frame, glance, T = two(desk, 20)
    uv, inv_depth = grid(frame)
    its, others = uv[:, 0] > BORDER + 8, seen_from(glance, T)
    unlike, judged = moved(uv, frame, looks(uv, inv_depth, frame.intrinsics[0], others), ~its)
    assert (judged & its).sum() > 50 and unlike[judged & its].mean() > 0.4
    assert unlike[judged & ~its].mean() < 0.05
    keyframe = prepare(desk.frames[8])
    depth = keyframe.depth.copy()
    depth[:, BORDER - 20 :] = 0.0  # it has not looked there
    known = sight(replace(keyframe, depth=depth), desk.T(8, 0).numpy() @ inverse(T))
    outline = outlined(frame, [known, *others])
    assert outline[20:220, BORDER + 12 : 310].mean() > 0.9 and outline[:, : BORDER - 8].mean() < 0.02


def test_glances_are_few_marked_and_follow_the_world(desk: Film) -> None:
    frame, _, T = two(desk, 20)
    foreign = np.zeros(frame.depth.shape, np.uint8)
    foreign[:, BORDER:] = 1
    marked = Glance.of(frame, T, foreign)
    assert marked.depth.shape == (60, 80) and (marked.depth[10:50, 65:] < 0).all() and (marked.depth[:, :62] >= 0).all()
    glances = Glances()
    kept = 0
    for _ in range(STRIDE * (KEPT + 2)):
        if glances.is_due():
            glances.add(marked)
            kept += 1
    assert kept == KEPT + 2 and len(glances.kept) == KEPT
    T_old_new = np.eye(4)
    T_old_new[:3, 3] = (0.1, 0.2, 0.3)
    before = glances.sights(T)[0].T_sight_frame
    glances.move_world(T_old_new)
    np.testing.assert_allclose(glances.sights(T @ T_old_new)[0].T_sight_frame, before, atol=1e-12)
    np.testing.assert_allclose(glances.kept[0].T_cam_world @ inverse(T_old_new), T, atol=1e-12)
    glances.forget()
    assert not glances.sights(T)


def test_the_last_frames_tell_a_pose_that_is_off(desk: Film) -> None:
    frame, keyframe, T = prepare(desk.frames[14]), prepare(desk.frames[8]), desk.T(14, 0).numpy()
    glance, T_keyframe = Glance.of(prepare(desk.frames[10]), desk.T(10, 0).numpy()), desk.T(8, 0).numpy()

    def share(T_frame_world: np.ndarray) -> float:
        known = sight(keyframe, T_keyframe @ inverse(T_frame_world))
        return agreement(frame, [known, *seen_from(glance, T_frame_world)])

    turned = retract(np.array([0.0, 0.0, 0.0, 0.0, 0.05, 0.0]), T)
    assert share(T) > 0.85 and share(turned) < 0.65
    assert agreement(frame, seen_from(glance, turned)) == 1.0  # nothing is known of it
