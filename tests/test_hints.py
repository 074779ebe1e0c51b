"""What is wrong with a pair of trajectories is named where the poses show it, and nothing is named where it is not."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from idrgbdo_torch.definitions.se3 import exp, inverse
from idrgbdo_torch.evaluation import absolute_error, hints
from idrgbdo_torch.trajectory import Trajectory, quaternion_from_rotation, read_tum, rotation_from_quaternion

REAL = [
    ("freiburg1_desk__dvo_like_tdist_nocublas_trajectory", "freiburg1_desk"),
    ("freiburg1_desk__dvo_like_gjgjh", "freiburg1_desk"),
    ("freiburg1_desk2__dvo_like_tdist_nocublas_trajectory", "freiburg1_desk2"),
    ("freiburg1_xyz__rgbdslam", "freiburg1_xyz"),
]


def walk(count: int = 150, rate: float = 30.0) -> Trajectory:
    """A hand-held path; its speeds come back nowhere."""
    time = torch.arange(count, dtype=torch.float64) / rate
    xi = torch.stack(
        [(0.3 + 0.1 * k) * torch.sin((0.9 + 0.37 * k) * time + 0.05 * time**2 + k) for k in range(6)], dim=1
    )
    return Trajectory(time, exp(xi))


def drifting(truth: Trajectory) -> Trajectory:
    """An honest estimate of it: a random walk of 1 mm and 1 mrad a frame, in another world."""
    generator = torch.Generator().manual_seed(1)
    steps = 0.001 * torch.randn(len(truth), 6, generator=generator, dtype=torch.float64)
    elsewhere = exp(torch.tensor([1.0, 2, 3, 0.4, -0.5, 0.6], dtype=torch.float64))
    return Trajectory(truth.timestamps, elsewhere @ truth.T_world_cam @ exp(steps.cumsum(0)))


def swapped(trajectory: Trajectory) -> Trajectory:
    """As a file in the order w x y z is read."""
    poses = trajectory.T_world_cam.clone()
    poses[:, :3, :3] = rotation_from_quaternion(quaternion_from_rotation(poses[:, :3, :3])[:, [3, 0, 1, 2]])
    return Trajectory(trajectory.timestamps, poses)


def scaled(trajectory: Trajectory, factor: float) -> Trajectory:
    poses = trajectory.T_world_cam.clone()
    poses[:, :3, 3] *= factor
    return Trajectory(trajectory.timestamps, poses)


def later(trajectory: Trajectory, seconds: float) -> Trajectory:
    return Trajectory(trajectory.timestamps + seconds, trajectory.T_world_cam)


def inverted(trajectory: Trajectory) -> Trajectory:
    return Trajectory(trajectory.timestamps, inverse(trajectory.T_world_cam))


def test_an_honest_estimate_gets_none() -> None:
    truth = walk()
    assert hints(truth, truth) == ()
    assert hints(drifting(truth), truth) == ()


@pytest.mark.parametrize(("estimate", "reference"), REAL)
def test_real_estimates_get_none(data_dir: Path, estimate: str, reference: str) -> None:
    folder = data_dir / "trajectories"
    real = read_tum(folder / "estimates" / f"{estimate}.txt"), read_tum(folder / "groundtruth" / f"{reference}.txt")
    assert hints(*real) == ()


def test_faults_of_real_files_are_found(data_dir: Path) -> None:
    folder = data_dir / "trajectories"
    estimate = read_tum(folder / "estimates" / f"{REAL[0][0]}.txt")
    reference = read_tum(folder / "groundtruth" / "freiburg1_desk.txt")
    for wrong, word in (
        (swapped(reference), "quaternions of the reference look like w x y z"),
        (inverted(reference), "look inverted"),
        (scaled(reference, 1000), "positions of the reference look like millimetres"),
    ):
        (said,) = hints(estimate, wrong)
        assert word in said
    best = read_tum(folder / "estimates" / "freiburg1_xyz__rgbdslam.txt")
    (said,) = hints(best, later(read_tum(folder / "groundtruth" / "freiburg1_xyz.txt"), 0.25))
    assert abs(float(said.partition("with ")[2].split()[0]) + 0.25) < 0.02


@pytest.mark.parametrize("which", ["estimate", "reference"])
def test_quaternions_in_the_other_order(which: str) -> None:
    truth, estimate = walk(), drifting(walk())
    pair = (swapped(estimate), truth) if which == "estimate" else (estimate, swapped(truth))
    (said,) = hints(*pair)
    assert f"the quaternions of the {which} look like w x y z" in said


def planar(count: int = 300) -> Trajectory:
    """A robot's path in a plane, which turns about the camera's y axis."""
    time = torch.arange(count, dtype=torch.float64) / 30
    xi = torch.zeros(count, 6, dtype=torch.float64)
    xi[:, 4] = 0.7 * torch.sin(0.5 * time)
    poses = exp(xi)
    poses[:, 0, 3], poses[:, 2, 3] = 0.5 * torch.sin(0.8 * time + 0.05 * time**2), 0.03 * time**2
    return Trajectory(time, poses)


@pytest.mark.parametrize("which", ["estimate", "reference"])
def test_the_other_order_of_a_planar_path_shows_in_its_way(which: str) -> None:
    truth = planar()
    assert hints(drifting(truth), truth) == ()
    pair = (swapped(drifting(truth)), truth) if which == "estimate" else (drifting(truth), swapped(truth))
    plain = (swapped(truth), truth) if which == "estimate" else (truth, swapped(truth))
    for estimate, reference in (pair, plain):
        (said,) = hints(estimate, reference)
        assert f"the quaternions of the {which} look like w x y z" in said


def test_inverted_poses() -> None:
    truth = walk()
    (said,) = hints(drifting(truth), inverted(truth))
    assert "the poses of the reference look inverted" in said
    (said,) = hints(inverted(truth), truth)
    assert "the poses of the estimate or of the reference look inverted" in said


@pytest.mark.parametrize(
    ("factor", "word"),
    [(1000, "reference look like millimetres"), (100, "centimetres"), (0.001, "estimate look like millimetres"),
     (1 / 0.3048, "feet"), (1.2, "reference are 1.20")],
)  # fmt: skip
def test_another_unit(factor: float, word: str) -> None:
    truth = walk()
    (said,) = hints(drifting(truth), scaled(truth, factor))
    assert word in said


@pytest.mark.parametrize("offset", [0.2, -0.35, 0.05, 100.0, -1612345678.5])
def test_another_clock(offset: float) -> None:
    truth = walk()
    estimate = drifting(truth)
    (said,) = hints(estimate, later(truth, offset))
    found = float(said.partition("with ")[2].split()[0])
    assert found == pytest.approx(-offset, abs=0.005)
    ate = float(said.partition("ATE is ")[2].split()[0])
    assert ate == pytest.approx(absolute_error(estimate, truth).rmse_m, abs=0.002)


@pytest.mark.parametrize("which", ["estimate", "reference"])
@pytest.mark.parametrize(("step", "guess"), [(1, "numbers of frames"), (33, "milliseconds")])
@pytest.mark.parametrize("start", [0.0, 1612345678.5])
def test_numbers_of_frames_are_no_times(which: str, step: int, guess: str, start: float) -> None:
    truth = later(walk(), start)
    counted = Trajectory(step * torch.arange(len(truth), dtype=torch.float64), truth.T_world_cam)
    (said,) = hints(*((counted, truth) if which == "estimate" else (truth, counted)))
    assert f"the times of the {which} are whole numbers {step} apart and are taken as seconds" in said
    assert f"if they are {guess}, write seconds" in said


def test_whole_seconds_that_match_are_times() -> None:
    truth = walk(300)
    assert hints(truth, truth.at(torch.arange(0, 300, 30))) == ()
    both = Trajectory(torch.arange(300, dtype=torch.float64), truth.T_world_cam)
    assert hints(both, both) == ()


def test_few_common_times_are_said() -> None:
    truth = walk(300)
    estimate = Trajectory(truth.timestamps + 9.8, truth.T_world_cam)
    strangers = Trajectory(truth.timestamps, walk(900).at(torch.arange(600, 900)).T_world_cam)
    (said,) = hints(estimate, strangers)
    assert said.startswith("only 6 of 300 estimated and 300 reference poses are within 0.02 s of each other")


def test_two_recordings_are_not_taken_for_one() -> None:
    other = walk(count=400).at(torch.arange(230, 380))
    assert hints(walk(), later(other, 1000.0)) == ()


def test_another_frame_of_the_body() -> None:
    truth = walk()
    arm = exp(torch.tensor([0.0, 0, 0, 0.9, 0.5, -0.4], dtype=torch.float64))
    arm[:3, 3] = torch.tensor([0.12, 0.0, -0.05])
    (said,) = hints(drifting(truth), Trajectory(truth.timestamps, truth.T_world_cam @ arm))
    angle = float(torch.tensor([0.9, 0.5, -0.4]).norm().rad2deg())
    assert f"turned by {angle:.0f} degrees against the camera and 0.1" in said


def test_positions_only_are_no_fault_of_the_order_or_the_body() -> None:
    truth = walk()
    bare = truth.T_world_cam.clone()
    bare[:, :3, :3] = torch.eye(3, dtype=torch.float64)
    assert hints(drifting(truth), Trajectory(truth.timestamps, bare)) == ()


def test_what_was_said_of_the_files_comes_first_and_few_poses_are_no_error() -> None:
    truth = walk()
    noted = Trajectory(truth.timestamps, truth.T_world_cam, ("read as nanoseconds",))
    assert hints(drifting(truth), noted) == ("read as nanoseconds",)
    for count in (0, 1, 2, 3):
        assert hints(truth.at(torch.arange(count)), noted) == ("read as nanoseconds",)
        assert hints(noted, truth.at(torch.arange(count))) == ("read as nanoseconds",)
