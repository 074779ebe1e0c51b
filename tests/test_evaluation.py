"""The metrics: closed forms, the TUM tools' published numbers, and evo as an outside check."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import torch

from idrgbdo_torch.definitions.se3 import exp, inverse
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.evaluation import Measurement, absolute_error, evaluate, keyframe_error, relative_error
from idrgbdo_torch.trajectory import Trajectory, read_tum

PUBLISHED = [
    ("freiburg1_desk", "tdist", "no cublas with weigths"),
    ("freiburg1_desk", "gdist", "no cublas no weigths"),
    ("freiburg1_desk2", "tdist", "no cublas with weigths"),
]


def wavy(count: int = 91, rate: float = 30.0) -> Trajectory:
    """A hand-held-like path of `count` poses."""
    time = torch.arange(count, dtype=torch.float64) / rate
    xi = torch.stack([(k + 1) * 0.1 * torch.sin((0.7 + 0.3 * k) * time) for k in range(6)], dim=1)
    return Trajectory(time, exp(xi))


@pytest.mark.parametrize(("sequence", "variant", "title"), PUBLISHED)
def test_ate_and_rpe_are_the_tum_tools_to_the_last_published_digit(
    data_dir: Path, sequence: str, variant: str, title: str
) -> None:
    folder = data_dir / "trajectories"
    estimate = read_tum(folder / "estimates" / f"{sequence}__dvo_like_{variant}_nocublas_trajectory.txt")
    reference = read_tum(folder / "groundtruth" / f"{sequence}.txt")
    published = (folder / "estimates" / f"{sequence}__dvo_like_run_all_output.txt").read_text()

    def number(metric: str, name: str) -> float:
        found = re.search(rf"^{title} {metric}:.*?{name} ([\d.]+)", published, flags=re.DOTALL | re.MULTILINE)
        assert found is not None
        return float(found[1])

    result = evaluate(estimate, reference)
    assert result.matched_poses == number("ATE", "compared_pose_pairs")
    assert result.ate.rmse_m == pytest.approx(number("ATE", "rmse"), abs=1e-6)
    assert float(result.ate.errors_m.max()) == pytest.approx(number("ATE", r"translational_error\.max"), abs=1e-6)
    assert result.rpe is not None
    assert len(result.rpe.errors_m) == number("RPE", "compared_pose_pairs")
    assert result.rpe.rmse_m_per_s == pytest.approx(number("RPE", r"translational_error\.rmse"), abs=1e-6)
    in_degrees = number("RPE", r"rotational_error\.rmse")
    assert result.rpe.rmse_deg_per_s == pytest.approx(in_degrees, abs=2e-6)
    assert float(result.rpe.errors_m.mean()) == pytest.approx(number("RPE", r"translational_error\.mean"), abs=1e-6)


def test_ate_is_evos(data_dir: Path) -> None:
    from evo.core import metrics, sync
    from evo.tools import file_interface

    name = "freiburg1_desk"
    paths = (
        data_dir / "trajectories" / "groundtruth" / f"{name}.txt",
        data_dir / "trajectories" / "estimates" / f"{name}__dvo_like_gdist_nocublas_trajectory.txt",
    )
    reference, estimate = (file_interface.read_tum_trajectory_file(str(path)) for path in paths)
    reference, estimate = sync.associate_trajectories(reference, estimate, max_diff=0.02)
    estimate.align(reference)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, estimate))
    ours = absolute_error(read_tum(paths[1]), read_tum(paths[0]))
    assert ours.rmse_m == pytest.approx(ape.get_statistic(metrics.StatisticsType.rmse), rel=1e-9)


def test_a_rigidly_moved_copy_has_no_error() -> None:
    truth = wavy()
    T = exp(torch.tensor([1.0, -2.0, 3.0, 0.5, 1.5, -1.0], dtype=torch.float64))
    result = evaluate(Trajectory(truth.timestamps, T @ truth.T_world_cam), truth)
    assert result.matched_poses == len(truth)
    assert result.ate.rmse_m < 1e-12
    assert result.rpe is not None
    assert result.rpe.rmse_m_per_s < 1e-12
    torch.testing.assert_close(result.ate.T_reference_estimate, inverse(T), rtol=0, atol=1e-12)


def test_scale_is_not_aligned_away() -> None:
    truth = wavy()
    scaled = truth.T_world_cam.clone()
    scaled[:, :3, 3] *= 1.1
    centred = truth.positions - truth.positions.mean(dim=0)
    expected = 0.1 * float(centred.square().sum(dim=1).mean().sqrt())
    assert absolute_error(Trajectory(truth.timestamps, scaled), truth).rmse_m == pytest.approx(expected, rel=1e-9)


def test_rpe_of_a_steady_drift_is_the_drift() -> None:
    truth = wavy()
    drift = torch.zeros(len(truth), 6, dtype=torch.float64)
    drift[:, 0] = 0.013 * truth.timestamps  # m/s along the camera's x axis, in a world that only translates
    still = Trajectory(truth.timestamps, torch.eye(4, dtype=torch.float64).repeat(len(truth), 1, 1))
    result = relative_error(Trajectory(truth.timestamps, exp(drift)), still)
    assert result is not None
    assert result.rmse_m_per_s == pytest.approx(0.013, rel=1e-9)
    assert len(result.errors_m) == len(truth) - 31  # a pair needs a pose 1 s later, which is not the last one


def test_rpe_of_less_than_a_second_is_none() -> None:
    short = wavy(count=20)
    result = evaluate(short, short)
    assert result.rpe is None
    assert result.ate.rmse_m < 1e-12


def test_k2fe_is_the_error_of_the_measured_relative_pose() -> None:
    truth = wavy()
    T_kf_world = inverse(truth.T_world_cam[10])
    shift = torch.eye(4, dtype=torch.float64)
    shift[0, 3] = 0.004
    measured = [
        Measurement(float(truth.timestamps[i]), float(truth.timestamps[10]), T_kf_world @ truth.T_world_cam[i] @ T)
        for i, T in ((12, torch.eye(4, dtype=torch.float64)), (15, shift), (20, shift), (10, shift))
    ]
    result = keyframe_error(measured, truth)
    assert result is not None
    assert result.errors_m.tolist() == pytest.approx([0, 0.004, 0.004], abs=1e-12)  # a keyframe itself does not count
    assert result.sum_m == pytest.approx(0.008)
    assert result.mean_m == pytest.approx(0.008 / 3)
    assert keyframe_error([], truth) is None


def test_two_clocks_that_never_meet_are_an_error_that_says_how_far() -> None:
    truth = wavy()
    with pytest.raises(IdRgbdoError, match=r"from 10\.000 to 13\.000 s, the reference from 0\.000 to 3\.000 s"):
        evaluate(Trajectory(truth.timestamps + 10, truth.T_world_cam), truth)
    between = Trajectory(truth.timestamps[:-1] + 0.5 / 30, truth.T_world_cam[:-1])
    with pytest.raises(IdRgbdoError, match=r"closest two are 0\.017 s apart.*raise the limit"):
        evaluate(between, truth, max_difference_s=0.01)
    with pytest.raises(IdRgbdoError, match="the reference has only 1"):
        evaluate(truth, truth.at(torch.tensor([3])))


def noisy(truth: Trajectory, seed: int = 0) -> Trajectory:
    generator = torch.Generator().manual_seed(seed)
    xi = 0.01 * torch.randn(len(truth), 6, generator=generator, dtype=torch.float64)
    return Trajectory(truth.timestamps, exp(xi) @ truth.T_world_cam)


@pytest.mark.parametrize("relation", ["translation_part", "rotation_angle_deg"])
def test_rpe_from_begin_to_end_is_evos(relation: str) -> None:
    from evo.core import metrics
    from evo.core.trajectory import PoseTrajectory3D

    truth = wavy(count=120)
    estimate = noisy(truth)
    ours = relative_error(estimate, truth)
    assert ours is not None
    # evo knows no seconds: 30 frames at 30 Hz; it keeps the pair that ends at the last pose, the TUM tool does not
    theirs = [
        PoseTrajectory3D(poses_se3=[T.numpy() for T in t.T_world_cam[:-1]], timestamps=t.timestamps[:-1].numpy())
        for t in (truth, estimate)
    ]
    rpe = metrics.RPE(metrics.PoseRelation[relation], delta=30, delta_unit=metrics.Unit.frames, all_pairs=True)
    rpe.process_data(theirs)
    assert len(ours.errors_m) == len(rpe.error) == 120 - 31
    value = ours.rmse_evo_m_per_s if relation == "translation_part" else ours.rmse_deg_per_s
    assert value == pytest.approx(rpe.get_statistic(metrics.StatisticsType.rmse), rel=1e-9)
    assert ours.rmse_m_per_s != pytest.approx(ours.rmse_evo_m_per_s, rel=1e-3)  # another question


def test_rpe_takes_only_poses_about_a_second_apart() -> None:
    circle = torch.arange(0, 60, 0.01, dtype=torch.float64)

    def at(times: torch.Tensor, scale: float) -> Trajectory:
        poses = torch.eye(4, dtype=torch.float64).repeat(len(times), 1, 1)
        poses[:, :2, 3] = scale * torch.stack([torch.cos(0.3 * times), torch.sin(0.3 * times)], dim=1)
        return Trajectory(times, poses)

    truth = at(circle, 1.0)
    every = torch.arange(0, 60, 1 / 30, dtype=torch.float64)
    dense = relative_error(at(every, 1.1), truth)
    assert dense is not None
    for times in (torch.arange(0, 60, 3.0), torch.arange(0, 60, 2.5), torch.arange(0, 60, 0.4)):
        result = evaluate(at(times.double(), 1.1), truth)
        assert result.rpe is None and "about 1 s apart" in result.no_rpe
    mixed = torch.cat([every[:900], torch.arange(30, 60, 3.0, dtype=torch.float64)])
    partly = relative_error(at(mixed, 1.1), truth)
    assert partly is not None and len(partly.errors_m) < 900
    assert partly.rmse_m_per_s == pytest.approx(dense.rmse_m_per_s, rel=0.01)


def test_rpe_of_an_exact_estimate_is_nothing_where_the_reference_is_sparse() -> None:
    truth = wavy(count=151)
    sparse = truth.at(torch.arange(0, 151, 6))
    result = evaluate(truth, sparse)
    assert result.rpe is not None and result.rpe.rmse_m_per_s < 1e-9
    assert len(result.rpe.errors_m) == 20  # every sixth begins where there is a reference pose, one ends at the last
    assert (result.matched_poses, result.poses) == (26, 151)
    gap = truth.at(torch.cat([torch.arange(10), torch.arange(140, 151)]))
    result = evaluate(truth, gap)
    assert result.rpe is None and "reference pose within 0.02 s" in result.no_rpe


def test_a_reference_of_positions_only_gives_ate_but_neither_rpe_nor_k2fe() -> None:
    truth = wavy()
    bare = truth.T_world_cam.clone()
    bare[:, :3, :3] = torch.eye(3, dtype=torch.float64)
    positions = Trajectory(truth.timestamps, bare)
    measured = [Measurement(0.5, 0.2, torch.eye(4, dtype=torch.float64))]
    result = evaluate(truth, positions, measured)
    assert result.ate.rmse_m < 1e-12
    assert result.rpe is None and "the reference has positions only" in result.no_rpe
    assert result.k2fe is None
    swapped = evaluate(positions, truth)
    assert swapped.rpe is None and "the estimate has positions only" in swapped.no_rpe
    assert evaluate(positions, positions).rpe is not None  # a camera that does not turn


def test_angles_near_nothing_are_exact() -> None:
    truth = wavy()
    turned = truth.T_world_cam.clone()
    drift = torch.zeros(len(truth), 6, dtype=torch.float64)
    drift[:, 4] = 1e-7 * truth.timestamps
    still = Trajectory(truth.timestamps, torch.eye(4, dtype=torch.float64).expand_as(turned))
    result = relative_error(Trajectory(truth.timestamps, exp(drift)), still)
    assert result is not None
    assert result.errors_rad.tolist() == pytest.approx([1e-7] * len(result.errors_rad), rel=1e-6)
