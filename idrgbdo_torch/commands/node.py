"""`idrgbdo node`: a ROS 2 node that tracks images as they are published."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import arg

from ..config import Config
from ..errors import IdRgbdoError
from ..text.configfile import Count, NonNegative, Positive
from .input import Settings
from .output import Output, answer

if TYPE_CHECKING:
    from ..datasets.builder import FrameBuilder
    from ..datasets.calibration import Calibration
    from ..export.axes import Motion
    from ..frame import BrokenFrame, RgbdFrame
    from ..odometry import Odometry, TrackResult

AxesName = Literal["optical", "body"]
LAST_S = 5.0  # that the last message may take to arrive
WAITING = 10  # images of either kind that wait for their partner


@dataclass(frozen=True)
class NodeCommand:
    """Track what a ROS 2 camera publishes, and publish nav_msgs/Odometry. Needs rclpy: docs/robots.md."""

    color: str = "/camera/color/image_raw"  # topics: colour; undistorted here unless its name says rect
    depth: str = "/camera/aligned_depth_to_color/image_raw"  # depth as the colour camera sees it
    info: str = "/camera/color/camera_info"  # of the colour camera
    odometry: str = "/odom"  # what is published; where tf2_msgs is installed /tf too
    axes: AxesName = "optical"  # z forward and y down, or x forward and z up
    depth_scale: Positive = 1000.0  # of 16-bit depth, values per metre
    limit: NonNegative = 0.02  # s, between the two images of a pair
    max_frames: Count | None = None  # stop after so many; else Ctrl-C ends it
    config: Path | None = None  # TOML, or fast, accurate, paper; its values are the defaults of the flags
    output: Annotated[Output, arg(name="")] = field(default_factory=Output)
    settings: Settings = field(default_factory=Config)


def node(command: NodeCommand) -> int:
    """Track until Ctrl-C or max_frames; what became of the frames."""
    from ..report.terminal import show_table
    from .track import make_odometry

    try:
        import rclpy
        from nav_msgs.msg import Odometry as OdometryMessage
        from rclpy.duration import Duration
        from rclpy.qos import qos_profile_sensor_data
        from sensor_msgs.msg import CameraInfo, Image
    except ImportError as error:
        raise IdRgbdoError(f"node: needs ROS 2's Python packages ({error}); docs/robots.md says where from") from error
    follower = Follower(make_odometry(command.settings), command)
    rclpy.init(args=[])
    ros = rclpy.create_node("idrgbdo")
    odometry = ros.create_publisher(OdometryMessage, command.odometry, 10)
    transforms = _transforms(ros)

    def publish(found: Pose) -> None:
        odometry.publish(odometry_message(found, command.axes))
        if transforms is not None:
            transforms(found, command.axes)

    for kind, topic, on_message in (
        (CameraInfo, command.info, follower.on_info),
        (Image, command.color, follower.on_color),
        (Image, command.depth, follower.on_depth),
    ):
        ros.create_subscription(kind, topic, _then(on_message, publish), qos_profile_sensor_data)
    print(f"waiting for {command.color} and {command.depth}", flush=True)
    try:
        while rclpy.ok() and (command.max_frames is None or follower.frames < command.max_frames):
            rclpy.spin_once(ros, timeout_sec=0.1)
        odometry.wait_for_all_acked(Duration(seconds=LAST_S))
    finally:
        ros.destroy_node()
        rclpy.try_shutdown()
    show_table("tracked", [("frames", str(follower.frames)), ("lost", str(follower.lost))])
    answer(frames=follower.frames, lost=follower.lost)
    return 0


@dataclass(frozen=True)
class Pose:
    """What is published of a frame."""

    stamp: Any  # builtin_interfaces/Time of the colour image
    result: TrackResult
    motion: Motion


class Follower:
    """Pairs images by their stamps and tracks them; it knows messages by their fields alone."""

    def __init__(self, odometry: Odometry, command: NodeCommand) -> None:
        from ..runs.certainty import Certainty

        self.odometry, self._command = odometry, command
        self.frames = self.lost = 0
        self._calibration: Calibration | None = None
        self._builder: FrameBuilder | None = None
        self._color: deque[Any] = deque(maxlen=WAITING)
        self._depth: deque[Any] = deque(maxlen=WAITING)
        self._certainty = Certainty()
        self._before: tuple[float, dict[str, str], Any] | None = None  # time, row and pose of the last frame

    def on_info(self, message: Any) -> None:
        """sensor_msgs/CameraInfo of the colour camera; the first counts."""
        from ..datasets.ros_camera import calibration_of_info

        if self._calibration is None:
            self._calibration = calibration_of_info(message, "rect" in self._command.color, self._command.info)

    def on_color(self, message: Any) -> Pose | None:
        """sensor_msgs/Image; the pose where its depth is there already."""
        self._color.append(message)
        return self._paired()

    def on_depth(self, message: Any) -> Pose | None:
        """sensor_msgs/Image; the pose where its colour is there already."""
        self._depth.append(message)
        return self._paired()

    def _paired(self) -> Pose | None:
        """Track the oldest colour image that has depth; what is older than the two is dropped."""
        if self._calibration is None:
            return None
        for color in self._color:
            time = _seconds(color)
            depth = min(self._depth, key=lambda message: abs(_seconds(message) - time), default=None)
            if depth is not None and abs(_seconds(depth) - time) <= self._command.limit:
                self._color = _later(self._color, color)
                self._depth = _later(self._depth, depth)
                return self._track(color, self._frame(self._calibration, color, depth))
        return None

    def _frame(self, calibration: Calibration, color: Any, depth: Any) -> RgbdFrame | BrokenFrame:
        """The frame of two messages; where one of them is not what it should be, why."""
        import numpy as np

        from ..datasets.builder import FrameBuilder
        from ..datasets.ros_images import color_image, depth_image
        from ..frame import BrokenFrame

        try:
            images = color_image(_as_recorded(color), "colour"), depth_image(_as_recorded(depth), "depth")
            if self._builder is None:
                scale = self._command.depth_scale if images[1].dtype == np.uint16 else 1.0  # floats are metres
                self._builder = FrameBuilder(calibration, images[0], scale)
            return self._builder.frame(_seconds(color), *images)
        except IdRgbdoError as error:
            return BrokenFrame(_seconds(color), str(error))

    def _track(self, color: Any, frame: RgbdFrame | BrokenFrame) -> Pose | None:
        """None for a lost frame: what is not known is not published."""
        from ..export.axes import in_axes, motion_between
        from ..frame import BrokenFrame
        from ..odometry import Record, Status
        from ..runs.folder import row_of

        self.frames += 1
        if isinstance(frame, BrokenFrame):
            self.lost += 1
            self._before = None
            return None
        result = self.odometry.track(frame)
        row = row_of(Record(frame.timestamp, result, 0.0, None), self._certainty)
        before, self._before = self._before, None
        if result.status is Status.LOST:
            self.lost += 1
            return None
        T = result.T_world_cam.numpy()
        self._before = frame.timestamp, row, T
        return Pose(color.header.stamp, result, in_axes(motion_between(before, self._before), self._command.axes))


def odometry_message(pose: Pose, axes: AxesName) -> Any:
    """nav_msgs/Odometry, as `idrgbdo export` writes it."""
    from nav_msgs.msg import Odometry as OdometryMessage

    from ..export.bag import Names

    names, motion = Names(axes), pose.motion
    message = OdometryMessage()
    message.header.stamp, message.header.frame_id, message.child_frame_id = pose.stamp, names.world, names.moving
    place = message.pose.pose
    place.position.x, place.position.y, place.position.z = motion.T_world_child[:3, 3].tolist()
    _turn(place.orientation, motion)
    message.pose.covariance = motion.pose_covariance.ravel()
    linear, angular = message.twist.twist.linear, message.twist.twist.angular
    linear.x, linear.y, linear.z, angular.x, angular.y, angular.z = motion.twist.tolist()
    message.twist.covariance = motion.twist_covariance.ravel()
    return message


def _transforms(ros: Any) -> Callable[[Pose, AxesName], None] | None:
    """What publishes /tf; None where tf2_msgs is not installed."""
    try:
        from tf2_msgs.msg import TFMessage
    except ImportError:
        return None
    from geometry_msgs.msg import TransformStamped

    from ..export.bag import Names

    publisher = ros.create_publisher(TFMessage, "/tf", 100)

    def publish(pose: Pose, axes: AxesName) -> None:
        names, given = Names(axes), TransformStamped()
        given.header.stamp, given.header.frame_id, given.child_frame_id = pose.stamp, names.world, names.moving
        moved = given.transform.translation
        moved.x, moved.y, moved.z = pose.motion.T_world_child[:3, 3].tolist()
        _turn(given.transform.rotation, pose.motion)
        publisher.publish(TFMessage(transforms=[given]))

    return publish


def _turn(quaternion: Any, motion: Motion) -> None:
    import torch

    from ..trajectory import quaternion_from_rotation

    rotation = torch.from_numpy(motion.T_world_child[:3, :3].copy())
    quaternion.x, quaternion.y, quaternion.z, quaternion.w = quaternion_from_rotation(rotation).tolist()


def _then(on_message: Callable[[Any], Pose | None], publish: Callable[[Pose], None]) -> Callable[[Any], None]:
    def call(message: Any) -> None:
        if (found := on_message(message)) is not None:
            publish(found)

    return call


def _later(waiting: deque[Any], than: Any) -> deque[Any]:
    return deque((message for message in waiting if _seconds(message) > _seconds(than)), WAITING)


def _as_recorded(message: Any) -> Any:
    """An image message with its bytes as numpy has them."""
    import numpy as np

    names = ("encoding", "width", "height", "step", "is_bigendian")
    return SimpleNamespace(data=np.frombuffer(message.data, np.uint8), **{n: getattr(message, n) for n in names})


def _seconds(message: Any) -> float:
    return float(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)
