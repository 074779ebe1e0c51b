"""The whole odometry on a short rendered sequence: accuracy, certainty, honesty, recovery, determinism, variants."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from rendered import SMALL, Film, film, later, rotation_deg
from torch import Tensor

from idrgbdo_torch import se3
from idrgbdo_torch.config import Config, KeyframeConfig, NoiseConfig, SelectionConfig, WindowConfig
from idrgbdo_torch.configfile import load
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.evaluation import Evaluation, Measurement, evaluate
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.id_rgbdo import PATIENCE, IdRgbdo
from idrgbdo_torch.keyframe import freedom_entropies_bits
from idrgbdo_torch.odometry import Run, Status, TrackResult, run

ROOT = Path(__file__).parent.parent
BREAK = 15  # number of the frame where something goes wrong


def tracked(done: Run) -> list[tuple[float, TrackResult]]:
    """Times and results of the frames that were measured against a keyframe."""
    return [(r.timestamp, r.result) for r in done.records if r.result.T_ref_cam is not None]


def evaluated(odometry: IdRgbdo, done: Run, desk: Film) -> Evaluation:
    measurements = [
        Measurement(time, result.reference_time, result.T_ref_cam)  # type: ignore[arg-type]
        for time, result in tracked(done)
    ]
    return evaluate(odometry.trajectory(), desk.groundtruth, measurements)


def nees(done: Run, desk: Film) -> np.ndarray:
    """Normalised squared error of every frame against its keyframe, over its six degrees of freedom."""
    index = {time: n for n, time in enumerate(desk.groundtruth.timestamps.tolist())}
    out = []
    for time, result in tracked(done):
        assert result.T_ref_cam is not None and result.reference_time is not None
        T_cam_ref = desk.T(index[time], index[result.reference_time])
        xi = se3.log(T_cam_ref @ result.T_ref_cam)  # a left increment of T_cam_ref
        out.append(float(xi @ result.information @ xi) / 6)
    return np.array(out)


@pytest.fixture(scope="module")
def plain(desk: Film) -> tuple[IdRgbdo, Run]:
    odometry = IdRgbdo()
    return odometry, run(odometry, desk.frames)


def test_every_frame_is_tracked_and_said_to_be(plain: tuple[IdRgbdo, Run]) -> None:
    _, done = plain
    assert done.statuses == (Status.OK,) * 40
    assert {record.result.segment for record in done.records} == {0}
    assert all(record.result.reason == "" for record in done.records)
    first, *rest = (record.result for record in done.records)
    assert first.keyframe and first.T_ref_cam is None and torch.equal(first.T_world_cam, torch.eye(4).double())
    assert 2 <= sum(result.keyframe for result in rest) <= 15
    for result in rest:
        assert 16 <= result.points <= 24 and result.iterations > 0 and len(result.entropy_bits) == 6


def test_it_is_accurate(plain: tuple[IdRgbdo, Run], desk: Film) -> None:
    odometry, done = plain
    found = evaluated(odometry, done, desk)
    assert found.matched_poses == 40
    assert found.ate.rmse_m < 0.002
    assert found.k2fe is not None and found.k2fe.mean_m < 0.002
    causal = evaluate(done.trajectory(), desk.groundtruth)
    assert causal.ate.rmse_m < 0.003
    last = se3.inverse(done.records[-1].result.T_world_cam) @ desk.T(0, 39)
    assert rotation_deg(last) < 0.3 and last[:3, 3].norm() < 0.008  # after 0.6 m and 26 degrees


def test_more_points_are_more_accurate_and_surer(plain: tuple[IdRgbdo, Run], desk: Film) -> None:
    odometry = IdRgbdo(replace(Config(), selection=SelectionConfig(points=256)))
    done = run(odometry, desk.frames)
    few, many = evaluated(*plain, desk), evaluated(odometry, done, desk)
    assert few.k2fe is not None and many.k2fe is not None
    assert many.k2fe.mean_m < 0.9 * few.k2fe.mean_m and many.ate.rmse_m < 0.001
    bits = lambda run: np.mean([sum(result.entropy_bits) for _, result in tracked(run)])
    assert bits(done) < bits(plain[1]) - 3


def test_results_belong_together(plain: tuple[IdRgbdo, Run], desk: Film) -> None:
    _, done = plain
    poses = {record.timestamp: record.result.T_world_cam for record in done.records}
    reference = 0.0
    for time, result in tracked(done):
        assert result.reference_time == reference
        assert result.T_ref_cam is not None and result.information is not None
        if result.keyframe:  # refined at once, together with the window
            reference = time
        else:
            expected = poses[result.reference_time] @ result.T_ref_cam
            torch.testing.assert_close(result.T_world_cam, expected, rtol=0, atol=1e-12)
        information = result.information
        assert information.shape == (6, 6) and torch.equal(information, information.mT)
        assert torch.linalg.eigvalsh(information).min() > 0
        torch.testing.assert_close(torch.tensor(result.entropy_bits).double(), freedom_entropies_bits(information))
        R = result.T_world_cam[:3, :3]
        assert (R @ R.mT - torch.eye(3)).abs().max() < 1e-12


def test_the_certainty_means_something(plain: tuple[IdRgbdo, Run], desk: Film) -> None:
    values = nees(plain[1], desk)
    assert len(values) == 39
    assert 0.2 < values.mean() < 3


def test_the_trajectory_has_every_frame_and_knows_better(plain: tuple[IdRgbdo, Run], desk: Film) -> None:
    odometry, done = plain
    trajectory = odometry.trajectory()
    assert trajectory.timestamps.tolist() == [frame.timestamp for frame in desk.frames]
    causal = done.trajectory().T_world_cam
    assert (trajectory.T_world_cam - causal).abs().max() > 1e-5  # refined after the fact
    assert (trajectory.T_world_cam - causal).abs().max() < 0.01
    assert (
        torch.equal(trajectory.T_world_cam[0], causal[0]) or (trajectory.T_world_cam[0] - causal[0]).abs().max() < 1e-6
    )


def test_reset_forgets_everything_and_starts_where_it_is_told(plain: tuple[IdRgbdo, Run], desk: Film) -> None:
    odometry = IdRgbdo()
    run(odometry, [*desk.frames[:12], *(blank(frame) for frame in desk.frames[12:17])])
    odometry.reset()
    assert len(odometry.trajectory()) == 0
    again = run(odometry, desk.frames[:20])
    assert all(
        torch.equal(a.result.T_world_cam, b.result.T_world_cam)
        for a, b in zip(again.records, plain[1].records[:20], strict=True)
    )
    start = se3.exp(torch.tensor([1.0, 2.0, 3.0, 0.1, 0.2, 0.3], dtype=torch.float64))
    odometry.reset(start)
    moved = run(odometry, desk.frames[:20])
    for a, b in zip(moved.records, again.records, strict=True):
        torch.testing.assert_close(a.result.T_world_cam, start @ b.result.T_world_cam, rtol=0, atol=1e-5)
    assert (odometry.trajectory().T_world_cam[0] - start).abs().max() < 1e-6


@pytest.mark.parametrize("mode", ["rand", "inf+grid"])
def test_the_same_bits_every_time_on_any_number_of_threads(desk: Film, mode: str) -> None:
    config = replace(Config(), selection=SelectionConfig(mode=mode))  # type: ignore[arg-type]
    poses, threads = [], torch.get_num_threads()
    try:
        for count in (1, 1, 2):
            torch.set_num_threads(count)
            odometry = IdRgbdo(config)
            done = run(odometry, desk.frames[:16])
            poses.append(torch.stack([done.trajectory().T_world_cam, odometry.trajectory().T_world_cam]))
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(poses[0], poses[1]) and torch.equal(poses[0], poses[2])
    other = run(IdRgbdo(replace(config, seed=1)), desk.frames[:16]).trajectory().T_world_cam
    assert torch.equal(other, poses[0][0]) == (mode != "rand")


def test_frames_are_left_as_they_are(desk: Film) -> None:
    copies = [(frame.gray.clone(), frame.depth.clone()) for frame in desk.frames[:15]]
    run(IdRgbdo(), desk.frames[:15])
    for frame, (gray, depth) in zip(desk.frames[:15], copies, strict=True):
        assert torch.equal(frame.gray, gray) and torch.equal(frame.depth, depth)


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
    done = run(IdRgbdo(), frames)
    assert Status.LOST not in done.statuses
    first, last = done.records[0].result.T_world_cam, done.records[19].result.T_world_cam
    assert (se3.inverse(last) @ first @ se3.inverse(desk.T(19, 0)))[:3, 3].norm() < 0.008


def test_slow_changes_of_exposure_are_no_motion(desk: Film) -> None:
    gain = lambda n: 1 + 0.25 * np.sin(n / 6)
    frames = [replace(frame, gray=gain(n) * frame.gray + 5 * np.cos(n / 4)) for n, frame in enumerate(desk.frames)]
    frames = [replace(frame, gray=frame.gray.float()) for frame in frames]
    odometry = IdRgbdo()
    done = run(odometry, frames)
    assert done.statuses == (Status.OK,) * 40
    assert evaluate(odometry.trajectory(), desk.groundtruth).ate.rmse_m < 0.003


def config(**parts: object) -> Config:
    return replace(Config(), **parts)  # type: ignore[arg-type]


VARIANTS = {
    "rand": (config(selection=SelectionConfig(mode="rand")), 0.006),
    "grid": (config(selection=SelectionConfig(mode="grid")), 0.003),
    "inf": (config(selection=SelectionConfig(mode="inf")), 0.003),
    "once a keyframe": (config(selection=SelectionConfig(per_frame=False)), 0.005),
    "objective as printed": (config(selection=SelectionConfig(objective="paper")), 0.003),
    "variance as printed": (config(noise=NoiseConfig(variance="paper")), 0.003),
    "no depth residual": (config(noise=NoiseConfig(depth_residual=False)), 0.005),
    "frame gradients": (config(noise=NoiseConfig(gradient_blend=0.0)), 0.003),
    "keyframe gradients": (config(noise=NoiseConfig(gradient_blend=1.0)), 0.003),
    "no window": (config(window=WindowConfig(enabled=False)), 0.005),
    "small window": (config(window=WindowConfig(keyframes=3)), 0.003),
    "oldest goes": (config(window=WindowConfig(keyframes=3, removal="oldest")), 0.003),
    "relinearised": (config(window=WindowConfig(keyframes=3, first_estimates=False)), 0.003),
    "more in the window": (config(window=WindowConfig(points=60)), 0.003),
    "ratio": (config(keyframe=KeyframeConfig(criterion="ratio")), 0.003),
    "many keyframes": (config(keyframe=KeyframeConfig(threshold_bits=0.05), window=WindowConfig(keyframes=4)), 0.005),
    "one keyframe": (config(keyframe=KeyframeConfig(threshold_bits=50.0)), 0.02),
}


@pytest.mark.parametrize("name", list(VARIANTS))
def test_every_option_works(desk: Film, name: str) -> None:
    config, limit = VARIANTS[name]
    frames = desk.frames[:12] if config.selection.objective == "paper" else desk.frames[:30]
    odometry = IdRgbdo(config)
    done = run(odometry, frames)
    assert Status.LOST not in done.statuses and done.statuses.count(Status.WEAK) <= 2
    assert evaluate(odometry.trajectory(), desk.groundtruth).ate.rmse_m < limit
    keyframes = sum(record.result.keyframe for record in done.records)
    assert (keyframes == 1) == (name == "one keyframe")
    assert keyframes >= 10 or name != "many keyframes"


@pytest.mark.parametrize(("name", "limit"), [("paper", 0.01), ("fast", 0.004), ("accurate", 0.001)])
def test_shipped_configurations_run(desk: Film, name: str, limit: float) -> None:
    odometry = IdRgbdo(load(ROOT / "configs" / f"{name}.toml", Config()))
    done = run(odometry, desk.frames[:20])
    assert Status.LOST not in done.statuses
    assert evaluate(odometry.trajectory(), desk.groundtruth).ate.rmse_m < limit


def test_a_bad_configuration_is_refused_at_once() -> None:
    with pytest.raises(IdRgbdoError, match="points"):
        IdRgbdo(config(selection=SelectionConfig(points=0)))


def test_a_large_start_pose_costs_no_accuracy(desk: Film, plain: tuple[IdRgbdo, Run]) -> None:
    start = torch.eye(4, dtype=torch.float64)
    start[:3, 3] = torch.tensor([4e5, -5e6, 100.0])  # metres of a map projection
    odometry = IdRgbdo()
    odometry.reset(start)
    done = run(odometry, desk.frames[:20])

    def position(result: Run) -> Tensor:
        return result.trajectory().T_world_cam[:20, :3, 3]

    assert (position(done) - start[:3, 3] - position(plain[1])).abs().max() < 0.002
