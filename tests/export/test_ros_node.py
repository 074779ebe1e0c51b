"""The ROS 2 node: pairs are tracked as a recording of them is; with rclpy, from a real publisher to a subscriber."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from idrgbdo_torch.commands.node import Follower, NodeCommand
from idrgbdo_torch.datasets.builder import FrameBuilder
from idrgbdo_torch.datasets.calibration import Calibration
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.odometry import Record
from idrgbdo_torch.runs.certainty import Certainty
from idrgbdo_torch.synthetic import RenderedSequence, SynthConfig
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo

ROOT = Path(__file__).parents[2]
FILM = SynthConfig(kind="desk", frames=12, width=160, height=120, fx=131.0, fy=131.0, cx=79.5, cy=59.5, samples=1)


class Shot:
    """A rendered frame as a camera publishes it: colour, and depth in millimetres 3 ms later."""

    def __init__(self, frame: RgbdFrame) -> None:
        assert frame.color is not None
        self.rgb = frame.color.numpy()
        self.millimetres = (1000 * frame.depth.numpy()).round().astype(np.uint16)
        self.nanoseconds = round(1e9 * frame.timestamp)

    def frame(self) -> RgbdFrame:
        calibration = Calibration(FILM.fx, FILM.fy, FILM.cx, FILM.cy)
        bgr = np.ascontiguousarray(self.rgb[..., ::-1])
        return FrameBuilder(calibration, bgr, 1000).frame(self.nanoseconds / 1e9, bgr, self.millimetres)

    def fill(self, color: Any, depth: Any) -> tuple[Any, Any]:
        """Two sensor_msgs/Image."""
        for message, image, encoding, late in ((color, self.rgb, "rgb8", 0), (depth, self.millimetres, "16UC1", 3)):
            stamp = self.nanoseconds + late * 1_000_000
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
            message.height, message.width, message.encoding = *image.shape[:2], encoding
            message.step, message.is_bigendian, message.data = image.strides[0], 0, image.tobytes()
        return color, depth


@pytest.fixture(scope="module")
def shots() -> list[Shot]:
    return [Shot(frame) for frame in RenderedSequence(FILM) if isinstance(frame, RgbdFrame)]


def plain_message() -> Any:
    return SimpleNamespace(header=SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0)))


def info(message: Any) -> Any:
    message.width, message.height = FILM.width, FILM.height
    message.k = [FILM.fx, 0.0, FILM.cx, 0.0, FILM.fy, FILM.cy, 0.0, 0.0, 1.0]
    message.d, message.p, message.distortion_model = [0.0] * 5, [0.0] * 12, "plumb_bob"
    return message


def tracked(shots: list[Shot]) -> list[tuple[torch.Tensor, np.ndarray | None]]:
    """Poses and world covariances without ROS."""
    odometry, certainty = IdRgbdo(), Certainty()
    results = [(shot.nanoseconds / 1e9, odometry.track(shot.frame())) for shot in shots]
    return [(r.T_world_cam, certainty.follow(Record(time, r, 0.0, None))[0]) for time, r in results]


def test_pairs_in_any_order_are_tracked_as_their_recording_is(shots: list[Shot]) -> None:
    follower, found = Follower(IdRgbdo(), NodeCommand()), []
    color, depth = shots[0].fill(plain_message(), plain_message())
    assert follower.on_color(color) is None and follower.on_depth(depth) is None  # the camera is not known yet
    follower = Follower(IdRgbdo(), NodeCommand())
    follower.on_info(info(plain_message()))
    for number, shot in enumerate(shots):
        color, depth = shot.fill(plain_message(), plain_message())
        first, second = (follower.on_color, color), (follower.on_depth, depth)
        for call, message in (first, second) if number % 2 else (second, first):
            found += [pose] if (pose := call(message)) is not None else []
        if number == 4:
            lone, _ = shot.fill(plain_message(), plain_message())
            lone.header.stamp.nanosec += 12_000_000  # colour whose depth was lost on the way
            assert follower.on_color(lone) is None
    assert len(found) == len(shots)
    for pose, (T, covariance) in zip(found, tracked(shots), strict=True):
        torch.testing.assert_close(torch.from_numpy(pose.motion.T_world_child), T, rtol=0, atol=1e-12)
        assert covariance is not None
        np.testing.assert_allclose(pose.motion.pose_covariance, covariance, rtol=1e-6, atol=1e-15)
    assert np.linalg.norm(found[5].motion.twist[:3]) > 0.01
    color, depth = shots[0].fill(plain_message(), plain_message())
    color.header.stamp.sec = depth.header.stamp.sec = 10**6
    color.data = color.data[:100]  # one that is broken costs that frame
    assert follower.on_color(color) is None and follower.on_depth(depth) is None
    assert (follower.frames, follower.lost) == (len(shots) + 1, 1)


def test_a_published_film_comes_back_as_odometry(shots: list[Shot], tmp_path: Path) -> None:
    rclpy = pytest.importorskip("rclpy", reason="ROS 2's Python packages are not installed; docs/robots.md")
    from nav_msgs.msg import Odometry
    from sensor_msgs.msg import CameraInfo, Image

    environment = {**os.environ, "ROS_DOMAIN_ID": str(40 + os.getpid() % 60)}
    environment["PYTHONPATH"] = os.pathsep.join([str(ROOT), *filter(None, sys.path)])
    os.environ["ROS_DOMAIN_ID"] = environment["ROS_DOMAIN_ID"]
    command = [sys.executable, "-m", "idrgbdo_torch", "node", "--max-frames", str(len(shots)), "--color", "/c"]
    process = subprocess.Popen([*command, "--depth", "/d", "--info", "/i"], env=environment, cwd=tmp_path)
    rclpy.init(args=[])
    ros, came = rclpy.create_node("camera"), list[Any]()
    ros.create_subscription(Odometry, "/odom", came.append, 10)
    publishers = [
        ros.create_publisher(kind, topic, 10) for kind, topic in ((CameraInfo, "/i"), (Image, "/c"), (Image, "/d"))
    ]

    def until(done: Callable[[], bool], seconds: float) -> None:
        end = time.monotonic() + seconds
        while not done():
            assert time.monotonic() < end and process.poll() in (None, 0)
            rclpy.spin_once(ros, timeout_sec=0.02)

    try:
        until(lambda: all(p.get_subscription_count() == 1 for p in publishers), 300)
        until(lambda: ros.count_publishers("/odom") == 1, 10)
        time.sleep(1.0)
        for number, shot in enumerate(shots):
            messages = (info(CameraInfo()), *shot.fill(Image(), Image()))
            for publisher, message in zip(publishers, messages, strict=True):
                publisher.publish(message)
            until(lambda number=number: len(came) > number, 30)  # type: ignore[misc]
        assert process.wait(30) == 0
    finally:
        process.kill()
        ros.destroy_node()
        rclpy.try_shutdown()
    for message, shot, (T, covariance) in zip(came, shots, tracked(shots), strict=True):
        stamp = message.header.stamp
        assert stamp.sec * 10**9 + stamp.nanosec == shot.nanoseconds
        assert (message.header.frame_id, message.child_frame_id) == ("odom", "camera_optical_frame")
        p = message.pose.pose.position
        np.testing.assert_allclose([p.x, p.y, p.z], T[:3, 3], rtol=0, atol=1e-9)
        np.testing.assert_allclose(np.reshape(message.pose.covariance, (6, 6)), covariance, rtol=1e-6, atol=1e-15)
