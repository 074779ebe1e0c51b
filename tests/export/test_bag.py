"""A recording of poses read back: numbers, order of the covariances, axes, velocity."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bag_writer
import numpy as np
import pytest
import torch
from rendered import Film
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from idrgbdo_torch.commands.cli import main
from idrgbdo_torch.definitions.se3 import exp, log
from idrgbdo_torch.export.axes import R_BODY_OPTICAL, UNKNOWN, Motion, in_axes
from idrgbdo_torch.export.tracked import load_run
from idrgbdo_torch.trajectory import rotation_from_quaternion

SUFFIX = {1: ".bag", 2: ".mcap"}


def read(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """Time of recording (ns) and message, by topic."""
    out: dict[str, list[tuple[int, Any]]] = {}
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        for connection, recorded, data in reader.messages():
            out.setdefault(connection.topic, []).append((recorded, reader.deserialize(data, connection.msgtype)))
    return out


def matrix(position: Any, rotation: Any) -> np.ndarray:
    """(4, 4) of a pose or a transform."""
    T = np.eye(4)
    quaternion = torch.tensor([rotation.x, rotation.y, rotation.z, rotation.w], dtype=torch.float64)
    T[:3, :3] = rotation_from_quaternion(quaternion).numpy()
    T[:3, 3] = [position.x, position.y, position.z]
    return T


def vector(v: Any) -> list[float]:
    return [v.x, v.y, v.z]


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("axes", ["optical", "body"])
def test_poses_come_back_in_the_axes_that_were_asked_for(
    tracked: Path, tmp_path: Path, version: int, axes: str
) -> None:
    out = tmp_path / f"poses{SUFFIX[version]}"
    assert main(["export", str(tracked), "--to", f"ros{version}", "--out", str(out), "--axes", axes]) == 0
    assert out.is_file()
    run, topics = load_run(tracked), read(out)
    C = np.eye(4)
    if axes == "body":  # a camera that looks along z with y down, as a body that looks along x with z up
        C[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    assert sorted(topics) == ["/odom", "/path", "/tf"]
    assert [len(topics[topic]) for topic in ("/odom", "/path", "/tf")] == [40, 1, 40]
    (_, path), child = topics["/path"][0], {"optical": "camera_optical_frame", "body": "base_link"}[axes]
    for number, (recorded, odometry) in enumerate(topics["/odom"]):
        expected = C @ run.T_world_cam[number] @ C.T
        stamp = odometry.header.stamp
        assert recorded == stamp.sec * 10**9 + stamp.nanosec == round(run.times[number] * 1e6) * 1000
        assert (odometry.header.frame_id, odometry.child_frame_id) == ("odom", child)
        pose = odometry.pose.pose
        np.testing.assert_allclose(matrix(pose.position, pose.orientation), expected, rtol=0, atol=1e-9)
        pose = path.poses[number].pose
        np.testing.assert_allclose(matrix(pose.position, pose.orientation), expected, rtol=0, atol=1e-9)
        transforms = topics["/tf"][number][1].transforms
        assert (transforms[0].header.frame_id, transforms[0].child_frame_id) == ("odom", child)
        moving = transforms[0].transform
        np.testing.assert_allclose(matrix(moving.translation, moving.rotation), expected, rtol=0, atol=1e-9)
        if axes == "body":  # through both, the camera is where it was
            camera = transforms[1].transform
            T = matrix(moving.translation, moving.rotation) @ matrix(camera.translation, camera.rotation)
            np.testing.assert_allclose(T, C @ run.T_world_cam[number], atol=1e-9)
            assert transforms[1].child_frame_id == "camera_optical_frame"


def test_a_velocity_moves_each_pose_to_the_next(tracked: Path, tmp_path: Path) -> None:
    out = tmp_path / "poses.mcap"
    assert main(["export", str(tracked), "--to", "ros2", "--out", str(out), "--axes", "body"]) == 0
    odometry = [message for _, message in read(out)["/odom"]]
    times, before = load_run(tracked).times, None
    for number, message in enumerate(odometry):
        pose, twist = message.pose.pose, message.twist.twist
        T = torch.from_numpy(matrix(pose.position, pose.orientation))
        covariance = np.reshape(message.twist.covariance, (6, 6))
        if before is None:
            np.testing.assert_array_equal(covariance, UNKNOWN * np.eye(6))
        else:
            xi = torch.tensor(vector(twist.linear) + vector(twist.angular), dtype=torch.float64)
            moved = before @ exp(xi * (times[number] - times[number - 1]))
            np.testing.assert_allclose(moved, T, atol=1e-8)
            assert np.linalg.eigvalsh(covariance).min() > 0 and covariance.max() < 1.0
        before = T
    assert np.abs([vector(m.twist.twist.linear) for m in odometry]).max() > 0.1  # m/s


def test_covariances_keep_their_order_and_turn_with_the_axes(tracked: Path, tmp_path: Path) -> None:
    """What is uncertain along the camera's axis is so along x for a body, in the message's order and nowhere else."""
    T = np.eye(4)
    T[:3, 3] = [1.0, 2.0, 3.0]
    variances = np.array([1.0, 2.0, 3.0, 0.1, 0.2, 0.3])  # x right, y down, z forward
    covariance = np.diag(variances)
    covariance[0, 4] = covariance[4, 0] = 0.05  # x with rotation about y
    body = in_axes(Motion(T, covariance, np.arange(6.0), covariance), "body")
    expected = np.diag([3.0, 1.0, 2.0, 0.3, 0.1, 0.2])  # x forward, y left, z up
    expected[1, 5] = expected[5, 1] = 0.05  # left is -x, up is -y
    np.testing.assert_allclose(body.pose_covariance, expected)
    np.testing.assert_allclose(body.twist_covariance, expected)
    np.testing.assert_allclose(body.twist, [2, 0, -1, 5, -3, -4])
    np.testing.assert_allclose(body.T_world_child[:3, 3], [3, -1, -2])
    out = tmp_path / "poses.bag"
    assert main(["export", str(tracked), "--to", "ros1", "--out", str(out)]) == 0
    row, (_, message) = load_run(tracked).rows[20], read(out)["/odom"][20]
    assert message.pose.covariance[0] == float(row["covariance_x_x"]) > 0
    assert message.pose.covariance[5] == message.pose.covariance[30] == float(row["covariance_x_rz"])
    assert message.pose.covariance[28] == float(row["covariance_ry_ry"])


def test_a_run_leaves_its_odometry_in_a_bag(tracked: Path, tmp_path: Path) -> None:
    bag, film = tmp_path / "odometry.mcap", tracked.parent / "film"
    flags = ["--max-frames", "6", "--out", str(tmp_path / "run"), "--odom-axes", "body", "--map", "none"]
    assert main(["run", str(film), *flags, "--odom-bag", str(bag)]) == 0
    odometry = read(bag)["/odom"]
    assert len(odometry) == 6 and odometry[0][1].child_frame_id == "base_link"


def test_a_folder_of_ros_2_is_replaced_and_another_is_not(tracked: Path, tmp_path: Path) -> None:
    out = tmp_path / "poses"
    for _ in range(2):
        assert main(["export", str(tracked), "--to", "ros2", "--out", str(out), "--every", "20"]) == 0
        assert len(read(out)["/odom"]) == 2 and (out / "metadata.yaml").exists()
    for _ in range(2):  # of ROS 1, a file
        assert main(["export", str(tracked), "--to", "ros1", "--out", str(tmp_path / "p.bag")]) == 0
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    assert main(["export", str(tracked), "--to", "ros2", "--out", str(tmp_path / "mine")]) == 1
    assert (tmp_path / "mine" / "notes.txt").exists()


@pytest.mark.parametrize("version", [1, 2])
def test_a_recording_of_a_camera_is_never_replaced(
    tracked: Path, desk: Film, tmp_path: Path, version: int, capsys: pytest.CaptureFixture[str]
) -> None:
    camera = bag_writer.write_bag(Film(desk.frames[:3], desk.groundtruth), tmp_path / f"c{SUFFIX[version]}", version)
    before = {file: file.read_bytes() for file in ([camera] if camera.is_file() else camera.iterdir())}
    places = [camera, *(file for file in before if file.suffix == ".mcap")]
    for place in places:  # the folder of ROS 2, and the file in it
        run = ["run", str(tracked.parent / "film"), "--out", str(tmp_path / "run"), "--odom-bag", str(place)]
        assert main(run) == 1 and not (tmp_path / "run").exists()  # before anything was tracked
        assert main(["export", str(tracked), "--to", f"ros{version}", "--out", str(place)]) == 1
        errors = capsys.readouterr().err.splitlines()
        assert len(errors) == 2 and errors[0].startswith("error: odom_bag: expected a new path")
    assert {file: file.read_bytes() for file in before} == before


def test_what_a_user_put_beside_the_poses_stays(tracked: Path, tmp_path: Path) -> None:
    export = ["export", str(tracked), "--to", "ros2", "--out", str(tmp_path / "poses")]
    assert main(export) == 0
    (tmp_path / "poses" / "notes.txt").write_text("mine")
    assert main(export) == 1
    assert (tmp_path / "poses" / "notes.txt").exists()


def test_the_axes_of_a_body_are_a_rotation() -> None:
    np.testing.assert_allclose(R_BODY_OPTICAL @ R_BODY_OPTICAL.T, np.eye(3))
    assert np.linalg.det(R_BODY_OPTICAL) == pytest.approx(1)
    T = exp(torch.tensor([0.3, -0.2, 0.5, 0.1, 0.4, -0.3], dtype=torch.float64))
    there = in_axes(Motion(T.numpy(), np.eye(6), np.zeros(6), np.eye(6)), "body").T_world_child
    assert log(torch.from_numpy(there)).norm() == pytest.approx(float(log(T).norm()))
