"""The whole odometry on a short rendered sequence: accuracy, certainty, determinism, every option."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from rendered import Film, rotation_deg
from torch import Tensor

from idrgbdo_torch.config import Config, KeyframeConfig, NoiseConfig, SelectionConfig, WindowConfig
from idrgbdo_torch.definitions import se3
from idrgbdo_torch.definitions.information import freedom_entropies_bits
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.evaluation import Evaluation, Measurement, evaluate
from idrgbdo_torch.odometry import Run, Status, TrackResult, run
from idrgbdo_torch.text.configfile import load
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo

ROOT = Path(__file__).parents[2]


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


def test_the_velocity_survives_the_refinement_of_the_pose(desk: Film) -> None:
    """The window moves the newest pose; the motion since the frame before stays the measured one."""
    odometry = IdRgbdo()
    keyframes = 0
    for frame in desk.frames:
        T_before_world = torch.from_numpy(odometry.motion.T_cam_world.copy())
        T_kf_world = (
            T_before_world if odometry.reference is None else torch.from_numpy(odometry.reference.T_kf_world.copy())
        )
        result = odometry.track(frame)
        if result.keyframe and result.T_ref_cam is not None:
            keyframes += 1
            measured = se3.inverse(result.T_ref_cam) @ T_kf_world @ se3.inverse(T_before_world)
            motion = torch.from_numpy(odometry.motion.T_cam_world) @ se3.inverse(
                torch.from_numpy(odometry.motion.T_previous)
            )
            torch.testing.assert_close(motion, measured, rtol=0, atol=1e-12)
            refined = se3.inverse(torch.from_numpy(odometry.motion.T_cam_world))
            torch.testing.assert_close(result.T_world_cam, refined)
    assert keyframes > 1


def test_reset_forgets_everything_and_starts_where_it_is_told(plain: tuple[IdRgbdo, Run], desk: Film) -> None:
    odometry = IdRgbdo()
    run(odometry, [*desk.frames[:12], *(replace(frame, gray=0 * frame.gray) for frame in desk.frames[12:17])])
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


def test_slow_changes_of_exposure_are_no_motion(desk: Film) -> None:
    gain = lambda n: 1 + 0.25 * np.sin(n / 6)
    frames = [replace(frame, gray=gain(n) * frame.gray + 5 * np.cos(n / 4)) for n, frame in enumerate(desk.frames)]
    frames = [replace(frame, gray=frame.gray.float()) for frame in frames]
    odometry = IdRgbdo()
    done = run(odometry, frames)
    assert done.statuses == (Status.OK,) * 40
    assert evaluate(odometry.trajectory(), desk.groundtruth).ate.rmse_m < 0.003


def test_the_brightness_of_the_frame_before_is_where_the_next_begins(desk: Film) -> None:
    odometry = IdRgbdo(config(keyframe=KeyframeConfig(threshold_bits=50.0)))
    for n, frame in enumerate(desk.frames[:6]):
        odometry.track(replace(frame, gray=1.3 * frame.gray + 5) if n >= 2 else frame)
        assert odometry.reference is not None
        a, b = odometry.reference.affine
        expected = 135 if n >= 2 else 100  # of gray level 100
        assert np.exp(a) * 100 + b == pytest.approx(expected, abs=3)


def config(**parts: object) -> Config:
    return replace(Config(), **parts)  # type: ignore[arg-type]


VARIANTS = {
    "rand": (config(selection=SelectionConfig(mode="rand")), 0.006),
    "grid": (config(selection=SelectionConfig(mode="grid")), 0.003),
    "inf": (config(selection=SelectionConfig(mode="inf")), 0.003),
    "wanted entropy": (config(selection=SelectionConfig(bits=-13.0), window=WindowConfig(points=40)), 0.002),
    "once a keyframe": (config(selection=SelectionConfig(per_frame=False)), 0.005),
    "objective as printed": (config(selection=SelectionConfig(objective="paper")), 0.003),
    "variance as printed": (config(noise=NoiseConfig(variance="paper")), 0.003),
    "no depth residual": (config(noise=NoiseConfig(depth_residual=False)), 0.005),
    "coarse levels forgotten": (config(noise=NoiseConfig(coarse=0.0)), 0.003),
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
    assert keyframes == 1 if name == "one keyframe" else keyframes > 1 or len(frames) < 30
    assert keyframes >= 10 or name != "many keyframes"
    points = [record.result.points for record in done.records if record.result.points]
    assert max(points) > 60 if name == "wanted entropy" else max(points) <= config.selection.points


@pytest.mark.parametrize("name", ["no window", "small window", "rand", "once a keyframe"])
def test_every_option_bears_depth_with_outliers(desk: Film, name: str) -> None:
    """Patches that stand behind their surface by a third of its distance: all that asks what is in front is asked."""
    odometry, rng = IdRgbdo(VARIANTS[name][0]), np.random.default_rng(0)
    for frame in desk.frames[:20]:
        depth = frame.depth.numpy().copy()
        for _ in range(depth.size // 1000):  # a tenth of the image
            v, u = rng.integers(0, depth.shape[0] - 10), rng.integers(0, depth.shape[1] - 10)
            depth[v : v + 10, u : u + 10] *= 1.3
        result = odometry.track(replace(frame, depth=torch.from_numpy(depth)))
        assert result.T_world_cam.isfinite().all()
    assert len(odometry.trajectory().timestamps) == 20


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
