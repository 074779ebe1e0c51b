"""The common interface: the null baseline, pairwise methods chained, and run() with its clock."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
import torch

from idrgbdo_torch.definitions.camera import Pinhole
from idrgbdo_torch.definitions.se3 import exp, inverse
from idrgbdo_torch.frame import BrokenFrame, RgbdFrame
from idrgbdo_torch.odometry import (
    Alignment,
    ConstantVelocity,
    FrameToFrame,
    Record,
    Status,
    TrackResult,
    found_again,
    lost_because,
    run,
)
from idrgbdo_torch.trajectory import Trajectory

CAMERA = Pinhole(width=8, height=6, fx=8, fy=8, cx=3.5, cy=2.5)
EYE = torch.eye(4, dtype=torch.float64)


def frame(timestamp: float) -> RgbdFrame:
    return RgbdFrame(timestamp, torch.zeros(6, 8), torch.ones(6, 8), CAMERA)


def path(timestamp: float) -> torch.Tensor:
    """T_world_cam of a known motion."""
    return exp(timestamp * torch.tensor([0.3, -0.1, 0.2, 0.4, 0.5, -0.3], dtype=torch.float64))


def align_truly(source: RgbdFrame, target: RgbdFrame, guess: torch.Tensor) -> Alignment:
    return Alignment(inverse(path(target.timestamp)) @ path(source.timestamp), Status.OK, information=torch.eye(6))


def failing_at(bad: Callable[[float, float], bool]) -> Callable[[RgbdFrame, RgbdFrame, torch.Tensor], Alignment]:
    """True alignment, but LOST for the pairs of times (source, target) that are bad."""

    def align(source: RgbdFrame, target: RgbdFrame, guess: torch.Tensor) -> Alignment:
        if bad(source.timestamp, target.timestamp):
            return Alignment(guess, Status.LOST, "no overlap")
        return align_truly(source, target, guess)

    return align


def assert_close(actual: torch.Tensor, expected: torch.Tensor) -> None:
    torch.testing.assert_close(actual, expected, rtol=0, atol=1e-12)


def test_constant_velocity_moves_on_from_where_it_was_reset() -> None:
    velocity = torch.tensor([0.1, 0.2, -0.3, 0.5, -0.2, 0.1], dtype=torch.float64)
    odometry = ConstantVelocity(velocity)
    odometry.reset(path(2.0))
    done = run(odometry, [frame(t) for t in (5.0, 5.5, 7.0)])
    assert done.statuses == (Status.WEAK,) * 3
    assert_close(done.records[0].result.T_world_cam, path(2.0))
    assert_close(done.records[2].result.T_world_cam, path(2.0) @ exp(2.0 * velocity))
    assert_close(odometry.trajectory().T_world_cam, done.trajectory().T_world_cam)


def test_frame_to_frame_chains_the_motions() -> None:
    odometry = FrameToFrame(align_truly, name="truth")
    times = [0.0, 0.1, 0.3, 0.35]
    done = run(odometry, [frame(t) for t in times])
    assert done.name == "truth"
    assert done.statuses == (Status.OK,) * 4
    for record in done.records:
        assert_close(record.result.T_world_cam, path(record.timestamp))
    last = done.records[-1].result
    assert last.reference_time == 0.3
    assert last.T_ref_cam is not None
    assert_close(last.T_ref_cam, inverse(path(0.3)) @ path(0.35))
    assert last.information is not None
    assert_close(odometry.trajectory().T_world_cam, done.trajectory().T_world_cam)


def test_frame_to_frame_guesses_the_previous_motion_if_it_predicts() -> None:
    guesses: list[torch.Tensor] = []

    def align(source: RgbdFrame, target: RgbdFrame, guess: torch.Tensor) -> Alignment:
        guesses.append(guess)
        return align_truly(source, target, guess)

    frames = [frame(t) for t in (0.0, 0.1, 0.2)]
    run(FrameToFrame(align), frames)
    assert_close(guesses[0], EYE)
    assert_close(guesses[1], inverse(path(0.1)))
    guesses.clear()
    run(FrameToFrame(align, predict=False), frames)
    assert all(torch.equal(guess, EYE) for guess in guesses)


def test_one_bad_image_is_bridged_from_the_last_good_one() -> None:
    odometry = FrameToFrame(failing_at(lambda source, target: 2.0 in (source, target)))
    done = run(odometry, [frame(float(t)) for t in range(5)])
    assert [status.value for status in done.statuses] == ["ok", "ok", "lost", "ok", "ok"]
    lost = done.records[2].result
    assert lost.reason == "no overlap"
    assert_close(lost.T_world_cam, path(1.0))
    assert_close(done.records[4].result.T_world_cam, path(4.0))
    assert {record.result.segment for record in done.records} == {0}


def test_a_jump_starts_a_new_segment_at_the_pose_that_was_held() -> None:
    odometry = FrameToFrame(failing_at(lambda source, target: source < 2.0 <= target))
    done = run(odometry, [frame(float(t)) for t in range(5)])
    assert [status.value for status in done.statuses] == ["ok", "ok", "lost", "ok", "ok"]
    assert [record.result.segment for record in done.records] == [0, 0, 0, 1, 1]
    assert_close(done.records[4].result.T_world_cam, path(1.0) @ inverse(path(2.0)) @ path(4.0))


def test_reset_forgets_everything() -> None:
    odometry = FrameToFrame(align_truly)
    first = run(odometry, [frame(t) for t in (0.0, 0.1)])
    odometry.reset()
    again = run(odometry, [frame(t) for t in (0.0, 0.1)])
    assert torch.equal(first.trajectory().T_world_cam, again.trajectory().T_world_cam)
    assert len(odometry.trajectory()) == 2


def test_a_broken_frame_is_lost_at_the_last_pose_and_never_reaches_the_odometry() -> None:
    frames = [frame(0.0), frame(1.0), BrokenFrame(2.0, "truncated PNG"), frame(3.0)]
    odometry = FrameToFrame(align_truly)
    done = run(odometry, frames)
    assert done.statuses == (Status.OK, Status.OK, Status.LOST, Status.OK)
    broken = done.records[2]
    assert (broken.timestamp, broken.result.reason, broken.track_ms) == (2.0, "truncated PNG", None)
    assert_close(broken.result.T_world_cam, path(1.0))
    assert_close(done.records[3].result.T_world_cam, path(3.0))
    assert done.trajectory().timestamps.tolist() == [0, 1, 2, 3]
    assert odometry.trajectory().timestamps.tolist() == [0, 1, 3]


class Clock:
    """A clock that stands still unless somebody works, in nanoseconds."""

    def __init__(self) -> None:
        self.now = 0

    def __call__(self) -> int:
        return self.now

    def frames(self, count: int) -> Iterator[RgbdFrame]:
        for timestamp in range(count):
            self.now += 10_000_000
            yield frame(float(timestamp))


class Worker:
    """An odometry that takes 30 ms a frame, and is interrupted at one."""

    name = "worker"

    def __init__(self, clock: Clock, interrupted_at: float = -1) -> None:
        self.clock, self.interrupted_at = clock, interrupted_at

    def reset(self, T_world_cam: torch.Tensor | None = None) -> None: ...

    def track(self, frame: RgbdFrame) -> TrackResult:
        if frame.timestamp == self.interrupted_at:
            raise KeyboardInterrupt
        self.clock.now += 30_000_000
        return TrackResult(EYE, Status.OK)

    def trajectory(self) -> Trajectory:
        raise NotImplementedError


def test_the_clock_runs_around_track_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()
    monkeypatch.setattr("idrgbdo_torch.odometry.perf_counter_ns", clock)
    done = run(Worker(clock), clock.frames(3))
    assert [(record.track_ms, record.decode_ms) for record in done.records] == [(30.0, 10.0)] * 3


def test_records_reach_the_callback_as_they_come() -> None:
    seen: list[Record] = []
    clock = Clock()
    with pytest.raises(KeyboardInterrupt):
        run(Worker(clock, interrupted_at=2.0), clock.frames(4), seen.append)
    assert [record.timestamp for record in seen] == [0, 1]


def test_every_frame_has_a_covariance() -> None:
    odometry = FrameToFrame(failing_at(lambda source, target: target == 2.0))
    results = [odometry.track(frame(float(t))) for t in range(4)]
    assert bool((results[0].covariance == 0).all())  # it is where the world begins
    assert_close(results[1].covariance, torch.eye(6, dtype=torch.float64))
    assert bool(results[2].covariance.diagonal().isinf().all())
    skewed = torch.diag(torch.tensor([1e8, 1e8, 1e6, 1e10, 1e10, 1e9], dtype=torch.float64))
    skewed[0, 4] = skewed[4, 0] = 5e8
    measured = TrackResult(EYE, Status.OK, T_ref_cam=EYE, information=skewed)
    torch.testing.assert_close(measured.covariance @ skewed, torch.eye(6, dtype=torch.float64), rtol=0, atol=1e-9)
    nothing = TrackResult(EYE, Status.WEAK, T_ref_cam=EYE, information=0 * skewed)
    assert bool(nothing.covariance.diagonal().isinf().all())
    assert bool(ConstantVelocity().track(frame(0.0)).covariance.isnan().all())  # it does not say


def test_reasons_for_losses_are_grouped_by_kind() -> None:
    def lost(reason: str) -> Record:
        return Record(0.0, TrackResult(EYE, Status.LOST, reason), 0.0, None)

    missing = [lost(f"colour: cannot read '/a/rgb/{k:06d}.png': no such file") for k in range(98)]
    others = [lost("only 34% of the points agree"), lost("only 7% of the points agree"), lost("no depth at all")]
    weak = Record(0.0, TrackResult(EYE, Status.WEAK, "dim"), 0.0, 1.0)
    assert lost_because([*others, *missing, weak]) == {
        "colour: cannot read '...': no such file": 98,
        "only ...% of the points agree": 2,
        "no depth at all": 1,
    }
    assert lost_because(missing[:1]) == {"colour: cannot read '/a/rgb/000000.png': no such file": 1}


def test_a_track_that_goes_on_in_the_same_segment_was_found_again() -> None:
    def records(*said: tuple[Status, int]) -> list[Record]:
        pose = torch.eye(4, dtype=torch.float64)
        return [Record(float(n), TrackResult(pose, status, segment=s), 0.0, 0.0) for n, (status, s) in enumerate(said)]

    ok, weak, lost = Status.OK, Status.WEAK, Status.LOST
    assert found_again(records((ok, 0), (ok, 0))) == (0, 0)
    assert found_again(records((lost, 0), (ok, 0), (lost, 0), (weak, 0), (lost, 0), (lost, 1), (ok, 1))) == (1, 2)
    assert found_again(records((ok, 0), (lost, 0))) == (0, 0)
