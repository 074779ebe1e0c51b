"""What the odometry does with broken images, jumps, gaps and clocks: says so, never raises, goes on."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
import torch
from rendered import SMALL, Film, film, later

from idrgbdo_torch.config import Config, KeyframeConfig, WindowConfig
from idrgbdo_torch.definitions import se3
from idrgbdo_torch.evaluation import evaluate
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.odometry import Status, run
from idrgbdo_torch.synthetic import RenderedSequence
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo
from idrgbdo_torch.tracker.motion import PATIENCE

BREAK = 15  # number of the frame where something goes wrong

Spoil = Callable[[RgbdFrame], RgbdFrame]


def depthless(frame: RgbdFrame) -> RgbdFrame:
    return replace(frame, depth=torch.zeros_like(frame.depth))


def even(level: float) -> Spoil:
    return lambda frame: replace(frame, gray=torch.full_like(frame.gray, level))


def noise(frame: RgbdFrame) -> RgbdFrame:
    return replace(frame, gray=255 * torch.rand(frame.gray.shape, generator=torch.Generator().manual_seed(0)))


def blank(frame: RgbdFrame) -> RgbdFrame:
    return even(0.0)(depthless(frame))


def not_a_number(frame: RgbdFrame) -> RgbdFrame:
    return replace(frame, gray=frame.gray * torch.nan)


def depth_not_a_number(frame: RgbdFrame) -> RgbdFrame:
    return replace(frame, depth=frame.depth * torch.nan)


def spoiled(desk: Film, spoil: Spoil, frames: Iterable[int]) -> list[RgbdFrame]:
    return [spoil(frame) if n in frames else frame for n, frame in enumerate(desk.frames)]


def off(odometry: IdRgbdo, desk: Film, a: int, b: int) -> float:
    """Metres by which the motion between two frames is wrong in the trajectory."""
    poses = odometry.trajectory().T_world_cam
    return float((se3.inverse(poses[b]) @ poses[a] @ se3.inverse(desk.T(b, a)))[:3, 3].norm())


SPOILS: dict[str, Spoil] = {
    "depthless": depthless,
    "black": even(0.0),
    "white": even(255.0),
    "gray": even(128.0),
    "noise": noise,
    "blank": blank,
    "nan": not_a_number,
    "nan depth": depth_not_a_number,
}


@pytest.mark.parametrize("name", list(SPOILS))
@pytest.mark.parametrize("length", [1, PATIENCE - 1])
def test_a_broken_image_is_lost_and_tracking_goes_on(desk: Film, name: str, length: int) -> None:
    bad = range(BREAK, BREAK + length)
    odometry = IdRgbdo()
    done = run(odometry, spoiled(desk, SPOILS[name], bad))
    held = done.records[BREAK - 1].result.T_world_cam
    for n in bad:
        result = done.records[n].result
        assert result.status is Status.LOST and result.reason and "\n" not in result.reason
        assert torch.equal(result.T_world_cam, held) and result.information is None and not result.keyframe
    after = done.records[BREAK + length].result
    assert after.status is Status.WEAK and "lost" in after.reason
    assert done.statuses[BREAK + length + 1 :] == (Status.OK,) * (39 - BREAK - length)
    assert done.records[-1].result.segment == 0
    assert off(odometry, desk, BREAK - 1, BREAK + length) < 0.004 and off(odometry, desk, 0, 39) < 0.01
    assert len(odometry.trajectory()) == 40


@pytest.mark.parametrize("length", [PATIENCE, 2 * PATIENCE])
def test_after_a_longer_loss_the_keyframe_is_still_tried_first(desk: Film, length: int) -> None:
    """A lens covered for a fifth of a second: the view that comes back is the old one."""
    odometry = IdRgbdo()
    done = run(odometry, spoiled(desk, blank, range(BREAK, BREAK + length)))
    assert done.statuses[BREAK : BREAK + length] == (Status.LOST,) * length
    assert done.records[-1].result.segment == 0
    assert off(odometry, desk, 0, 39) < 0.01


@pytest.mark.parametrize("name", ["depthless", "blank"])
def test_a_sequence_may_begin_with_broken_images(desk: Film, name: str) -> None:
    odometry = IdRgbdo()
    done = run(odometry, spoiled(desk, SPOILS[name], range(5)))
    assert done.statuses == (Status.LOST,) * 5 + (Status.OK,) * 35
    assert done.records[0].result.reason.startswith("too few points")
    assert done.records[5].result.segment == 0 and done.records[5].result.keyframe
    assert off(odometry, desk, 5, 39) < 0.01
    trajectory = odometry.trajectory().T_world_cam
    assert trajectory.shape == (40, 4, 4) and torch.isfinite(trajectory).all()


def test_nothing_but_broken_images(desk: Film) -> None:
    odometry = IdRgbdo()
    done = run(odometry, [blank(frame) for frame in desk.frames[:8]])
    assert done.statuses == (Status.LOST,) * 8
    assert torch.equal(odometry.trajectory().T_world_cam, torch.eye(4).double().expand(8, 4, 4))
    assert len(IdRgbdo().trajectory()) == 0


@pytest.fixture(scope="module")
def elsewhere() -> Film:
    """Another room."""
    return film(replace(SMALL, kind="nostructure_texture", seed=9, frames=12))


def test_a_jump_to_another_place_starts_a_new_segment(desk: Film, elsewhere: Film) -> None:
    frames = [*desk.frames[:BREAK], *(later(frame, 0.5) for frame in elsewhere.frames)]
    odometry = IdRgbdo()
    done = run(odometry, frames)
    assert done.statuses[:BREAK] == (Status.OK,) * BREAK
    assert Status.OK not in done.statuses[BREAK : BREAK + PATIENCE]
    assert done.statuses[BREAK : BREAK + PATIENCE + 1].count(Status.LOST) == PATIENCE + 1
    start = done.records[BREAK + PATIENCE].result
    assert start.keyframe and start.segment == 1 and "new segment" in start.reason
    held = done.records[BREAK - 1].result.T_world_cam
    torch.testing.assert_close(start.T_world_cam, held, rtol=0, atol=1e-12)
    rest = done.records[BREAK + PATIENCE + 1 :]
    assert [record.result.status for record in rest] == [Status.OK] * len(rest)
    assert all(record.result.segment == 1 for record in rest)
    # inside the new segment the motion is right again
    poses = odometry.trajectory().T_world_cam
    n = len(frames) - 1
    E = se3.inverse(poses[n]) @ poses[BREAK + PATIENCE] @ se3.inverse(elsewhere.T(n - BREAK, PATIENCE))
    assert len(poses) == len(frames) and E[:3, 3].norm() < 0.01


def test_a_turned_image_is_not_believed(desk: Film) -> None:
    """The camera seems to have rolled by half a turn within a frame."""

    def turned(frame: RgbdFrame) -> RgbdFrame:
        return replace(frame, gray=frame.gray.flip(0, 1), depth=frame.depth.flip(0, 1))

    done = run(IdRgbdo(), spoiled(desk, turned, [BREAK]))
    assert done.statuses[BREAK] is Status.LOST
    assert done.statuses[BREAK + 2 :] == (Status.OK,) * (38 - BREAK)


def test_skipped_frames_are_no_loss(desk: Film) -> None:
    frames = [frame for n, frame in enumerate(desk.frames) if n % 3 == 0]
    odometry = IdRgbdo()
    done = run(odometry, frames)
    assert Status.LOST not in done.statuses
    assert evaluate(odometry.trajectory(), desk.groundtruth).ate.rmse_m < 0.004


@pytest.mark.parametrize("tick_s", [0.0, -1 / 30])
def test_a_clock_that_stands_still_or_runs_backwards_does_not_freeze_the_pose(desk: Film, tick_s: float) -> None:
    """The motion prior must not take every motion for an impossible one."""
    frames = [replace(frame, timestamp=n * tick_s) for n, frame in enumerate(desk.frames[:20])]
    for n, record in enumerate(run(IdRgbdo(), frames).records):
        assert record.result.status is not Status.LOST
        E = record.result.T_world_cam @ desk.T(n, 0)
        assert E[:3, 3].norm() < (0.002 if n < 5 else 0.008)


def test_pixels_that_are_no_numbers_stay_out_of_the_window(desk: Film) -> None:
    odometry = IdRgbdo(Config(keyframe=KeyframeConfig(threshold_bits=1e-3), window=WindowConfig(keyframes=3)))
    for number, frame in enumerate(desk.frames[:8]):
        gray = frame.gray.clone()
        gray[60:80, 10 * number : 10 * number + 20] = torch.nan
        assert odometry.track(replace(frame, gray=gray)).status is Status.OK
    assert np.isfinite(odometry.window.solved.reduced).all()
    assert off(odometry, desk, 0, 7) < 0.005


def test_far_steps_over_little_texture_are_searched_for_again() -> None:
    """Another minimum of the search looks as if much of the keyframe had come to lie behind something else."""
    sequence = RenderedSequence(replace(SMALL, kind="poor", frames=14, rate=2.0, seed=4))
    shots = Film(tuple(islice(sequence, 4)), sequence.groundtruth)
    odometry = IdRgbdo()
    assert [odometry.track(frame).status for frame in shots.frames] == [Status.OK] * 4
    assert max(off(odometry, shots, n, n + 1) for n in range(3)) < 0.01  # 0.2 and more where it is not
