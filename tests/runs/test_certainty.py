"""The covariance of a pose in the world, against the errors of poses that were really disturbed; velocity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from idrgbdo_torch.definitions.se3 import exp, inverse
from idrgbdo_torch.odometry import Record, Status, TrackResult
from idrgbdo_torch.runs.certainty import COLUMNS, POSE, RECENT, SHARE, UPPER, Certainty, in_world, inverted

SIGMA = torch.tensor([0.03, 0.01, 0.002, 0.001, 0.004, 0.02], dtype=torch.float64)  # m and rad, of every measurement


def twist(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


STEPS = (twist(0.5, 0.1, 0.2, 0.1, 0.7, -0.3), twist(0.1, -0.4, 0.3, -0.2, 0.5, 0.4), twist(0, 0.2, 0.1, 0.3, 0, 0.1))


def record(time: float, T_world_cam: Tensor, T_ref_cam: Tensor | None, reference: float | None) -> Record:
    """A keyframe at an integral time."""
    result = TrackResult(
        T_world_cam, Status.OK, reference_time=reference, T_ref_cam=T_ref_cam, keyframe=time == int(time),
        information=None if T_ref_cam is None else torch.diag(SIGMA**-2),
    )  # fmt: skip
    return Record(time, result, 0.0, 1.0)


def chain() -> list[Record]:
    """A start, two keyframes and a frame, each measured against the keyframe before."""
    pose = torch.eye(4, dtype=torch.float64)
    records = [record(0.0, pose, None, None)]
    for number, step in enumerate(STEPS):
        pose = pose @ exp(step)
        records.append(record(number + 1.0 if number < 2 else 2.5, pose, exp(step), float(number)))
    return records


def cells(records: list[Record]) -> list[dict[str, str]]:
    certainty = Certainty()
    return [dict(zip(COLUMNS, certainty.cells(one), strict=True)) for one in records]


def covariance(row: dict[str, str]) -> np.ndarray:
    out = np.zeros((6, 6))
    for i, j in UPPER:
        out[i, j] = out[j, i] = float(row[f"covariance_{POSE[i]}_{POSE[j]}"])
    return out


def test_the_covariance_is_that_of_disturbed_chains() -> None:
    said = covariance(cells(chain())[-1])
    true, rng = chain()[-1].result.T_world_cam, np.random.default_rng(0)
    found = torch.eye(4, dtype=torch.float64)
    for step in STEPS:
        error = 0.1 * SIGMA * torch.from_numpy(rng.normal(size=(20_000, 6)))
        found = found @ inverse(exp(error) @ inverse(exp(step)))
    R = (found[:, :3, :3] @ true[:3, :3].T).numpy()  # about fixed axes
    turned = 0.5 * np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    errors = np.concatenate([(found - true)[:, :3, 3].numpy(), turned], axis=1)
    measured = 100 * np.cov(np.transpose(errors))
    scale = np.sqrt(np.outer(np.diag(said), np.diag(said)))
    np.testing.assert_allclose(measured / scale, said / scale, atol=0.04)
    assert np.diag(said)[:3].max() / np.diag(said)[:3].min() > 1.5  # it has directions that could be mixed up


def test_a_camera_turned_by_a_right_angle_carries_its_uncertainty_along() -> None:
    T_world_cam = exp(twist(0, 0, 0, 0, np.pi / 2, 0))  # looks along the world's x: z of the camera is x, x is -z
    world = in_world(np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), T_world_cam.numpy())
    np.testing.assert_allclose(world, np.diag([3.0, 2.0, 1.0, 6.0, 5.0, 4.0]), atol=1e-12)


def test_the_first_frame_is_certain_and_what_follows_a_break_is_unknown() -> None:
    records = chain()
    broken = replace(records[2].result, status=Status.LOST, reference_time=None, T_ref_cam=None, information=None)
    records[2] = replace(records[2], result=broken)
    rows = cells(records)
    np.testing.assert_array_equal(covariance(rows[0]), 0.0)
    assert covariance(rows[1])[0, 0] > 0
    assert rows[2]["covariance_x_x"] == rows[3]["covariance_x_x"] == ""
    assert rows[2]["T_ref_cam_tx"] == "" and float(rows[3]["T_ref_cam_qw"]) > 0
    assert rows[3]["velocity_vx"] == ""


def test_a_velocity_is_in_the_cameras_own_axes() -> None:
    rows = cells(chain())
    names = [name for name in COLUMNS if name.startswith("velocity_")]
    assert [rows[0][name] for name in names] == [""] * 6
    assert [float(rows[1][name]) for name in names] == pytest.approx(STEPS[0].tolist(), abs=1e-7)
    assert [float(rows[3][name]) for name in names] == pytest.approx((STEPS[2] / 0.5).tolist(), abs=1e-7)


def test_a_jump_to_another_segment_is_no_velocity() -> None:
    records = chain()
    records[2] = replace(records[2], result=replace(records[2].result, segment=1))
    rows = cells(records)
    assert rows[1]["velocity_vx"] and rows[2]["velocity_vx"] == rows[3]["velocity_vx"] == ""


def test_a_frame_found_again_in_an_old_keyframe_is_as_certain_as_that_one() -> None:
    records = chain()
    T_ref_cam = exp(STEPS[1])
    again = record(4.0, records[1].result.T_world_cam @ T_ref_cam, T_ref_cam, 1.0)
    rows = cells([*records, again])
    np.testing.assert_allclose(covariance(rows[4]), covariance(rows[2]), rtol=1e-6)


def test_a_direction_that_nothing_measures_has_no_covariance() -> None:
    assert inverted(np.diag([1.0, 1, 1, 1, 1, 0])) is None
    np.testing.assert_allclose(inverted(np.diag([4.0, 1, 1, 1, 1, 2])), np.diag([0.25, 1, 1, 1, 1, 0.5]))


def refined(size: float, links: int) -> list[Record]:
    """A start and so many keyframes, each moved by `size` standard deviations of its measurement by the window."""
    pose = torch.eye(4, dtype=torch.float64)
    records = [record(0.0, pose, None, None)]
    for number in range(links):
        moved = size * SIGMA * torch.tensor([1.0, -1, 1, 1, -1, 1], dtype=torch.float64)
        pose = pose @ exp(STEPS[number % 3]) @ exp(moved)
        records.append(record(number + 1.0, pose, exp(STEPS[number % 3]), float(number)))
    return records


def test_of_a_keyframe_that_the_window_refined_a_share_of_its_variance_is_left() -> None:
    tracked, kept = covariance(cells(refined(0.0, 1))[1]), covariance(cells(refined(0.5, 1))[1])
    np.testing.assert_allclose(np.linalg.eigvalsh(kept), SHARE * np.linalg.eigvalsh(tracked), rtol=1e-3)


def test_variances_grow_where_the_window_moves_keyframes_further_than_they_should_be_off() -> None:
    records = refined(3.0, RECENT)
    frame = record(RECENT + 0.5, records[-1].result.T_world_cam @ exp(STEPS[0]), exp(STEPS[0]), float(RECENT))
    last = covariance(cells([*records, frame])[-1]) - covariance(cells(records)[-1])
    calm = refined(0.1, RECENT)
    frame = record(RECENT + 0.5, calm[-1].result.T_world_cam @ exp(STEPS[0]), exp(STEPS[0]), float(RECENT))
    first = covariance(cells([*calm, frame])[-1]) - covariance(cells(calm)[-1])
    assert last[0, 0] > 9.0 * first[0, 0]  # by 9^1.5 of its own, less what turning the keyframe's adds
