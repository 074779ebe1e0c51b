"""Frames of a camera as they come: RealSense and Azure Kinect through Open3D's sensors."""

from __future__ import annotations

import ctypes
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, Literal, Protocol

from ..definitions.camera import Pinhole
from ..errors import IdRgbdoError
from ..frame import BrokenFrame, RgbdFrame
from ..tracker.open3d_loader import load_open3d
from ..trajectory import Trajectory
from .builder import FrameBuilder
from .calibration import Calibration
from .depth_scale import depth_warnings
from .open3d_images import calibration_of, open3d_speaks, raw_pair

MISSED = 3  # images in a row that may fail to come before the camera counts as gone
AZURE_DEPTH_SCALE = 1000.0
K4A = {"linux": "libk4a.so", "win32": "k4a.dll"}  # Azure Kinect's own library, by platform


class Sensor(Protocol):
    """A camera that is running, depth registered to colour."""

    name: str
    calibration: Calibration
    depth_scale: float  # values per metre

    def capture(self) -> tuple[float, Any] | None:
        """Time (s) and RGBDImage of Open3D; None where no image came in time."""

    def stop(self) -> None:
        """Let go of the camera."""


class RealSense:
    """An Intel RealSense camera."""

    name = "realsense"

    def __init__(self, camera: Path | None = None, record: Path | None = None, sensor: Any = None) -> None:
        """Start it. camera: intrinsics instead of the camera's own. record: .bag file to write everything into.

        sensor: an object like Open3D's RealSenseSensor, for tests. Raises IdRgbdoError where there is no camera.
        """
        with open3d_speaks("the RealSense camera"):
            self._sensor = load_open3d().t.io.RealSenseSensor() if sensor is None else sensor
            if not self._sensor.enumerate_devices():
                raise IdRgbdoError(
                    "sensor: expected a RealSense camera, found none; connect one to a USB 3 port, "
                    "or choose --sensor azure"
                )
            self._sensor.init_sensor(filename=str(record or ""))
            self._sensor.start_capture(record is not None)
            metadata = self._sensor.get_metadata()
        self.calibration = calibration_of(metadata.intrinsics, camera)
        self.depth_scale = float(metadata.depth_scale)

    def capture(self) -> tuple[float, Any] | None:
        """The next image, with the camera's own time; None where none came within some seconds."""
        with open3d_speaks("the RealSense camera"):
            image = self._sensor.capture_frame(wait=True, align_depth_to_color=True)
            return None if image.is_empty() else (self._sensor.get_timestamp() * 1e-6, image)

    def stop(self) -> None:
        """Stop capturing, and recording."""
        with open3d_speaks("the RealSense camera"):
            self._sensor.stop_capture()


class AzureKinect:
    """A Microsoft Azure Kinect. Open3D tells neither its intrinsics nor its times: a file and the clock do."""

    name = "azure"
    depth_scale = AZURE_DEPTH_SCALE

    def __init__(self, camera: Path | None = None, sensor: Any = None) -> None:
        """Start it. camera: its intrinsics. sensor: an object like Open3D's AzureKinectSensor, for tests.

        Raises IdRgbdoError without intrinsics, Microsoft's library or a camera.
        """
        if camera is None:
            raise IdRgbdoError(
                "camera: expected the intrinsics of the Azure Kinect's colour camera, got none; pass --camera F.toml"
            )
        self.calibration = calibration_of(None, camera)
        with open3d_speaks("the Azure Kinect"):
            self._sensor = _azure_sensor() if sensor is None else sensor
            if not self._sensor.connect(0):
                raise IdRgbdoError("sensor: expected an Azure Kinect, found none; connect one to a USB 3 port")

    def capture(self) -> tuple[float, Any] | None:
        """The next image at the time it was there; None where none came."""
        with open3d_speaks("the Azure Kinect"):
            image = self._sensor.capture_frame(True)
        return None if image is None else (time.time(), image)

    def stop(self) -> None:
        """Let go of the camera."""
        with open3d_speaks("the Azure Kinect"):
            self._sensor.disconnect()


class LiveSequence:
    """The frames of a running camera, once, in order; as many as asked for unless it stops before."""

    groundtruth: Trajectory | None = None

    def __init__(self, sensor: Sensor, max_frames: int, depth_scale: float | None = None) -> None:
        """Wait for the first image, which tells the size. Raises IdRgbdoError where none comes."""
        self._sensor = sensor
        self._max_frames = max_frames
        self.name = sensor.name
        self.timestamps: list[float] = []  # s, of the frames so far
        self._first = self._capture()
        if self._first is None:
            sensor.stop()
            raise IdRgbdoError(f"sensor: no image came from the {sensor.name} camera; check its cable and port")
        color, depth = raw_pair(self._first[1])
        scale = depth_scale or sensor.calibration.depth_scale or sensor.depth_scale
        self._builder = FrameBuilder(sensor.calibration, color, scale)
        self.camera: Pinhole = self._builder.camera
        self.warnings = depth_warnings(depth, scale)

    @property
    def recognised(self) -> str:
        """What is read, in one line."""
        c = self.camera
        return f"{self.name} camera: {c.width}x{c.height}, at most {self._max_frames} frames, Ctrl-C ends it before"

    def __len__(self) -> int:
        return self._max_frames

    def __iter__(self) -> Iterator[RgbdFrame | BrokenFrame]:
        try:
            shot = self._first
            while shot is not None and len(self.timestamps) < self._max_frames:
                timestamp, image = shot
                self.timestamps.append(timestamp)
                yield self._builder.frame_or_reason(timestamp, partial(raw_pair, image))
                shot = self._capture() if len(self.timestamps) < self._max_frames else None
        finally:
            self._sensor.stop()

    def __getitem__(self, index: int) -> RgbdFrame | BrokenFrame:
        """Frame number `index`, from the end where it is negative."""
        return self.read(range(len(self))[index])

    def read(self, index: int) -> RgbdFrame | BrokenFrame:
        """Not possible: a camera cannot be asked for a frame by its number. Raises IdRgbdoError."""
        raise IdRgbdoError(
            f"sensor: frame {index} of a live camera cannot be read apart; record it and read the recording"
        )

    def _capture(self) -> tuple[float, Any] | None:
        """The next image whose time is new; None where the camera is silent or gives the same one again."""
        for _ in range(MISSED):
            shot = self._sensor.capture()
            if shot is not None and (not self.timestamps or shot[0] > self.timestamps[-1]):
                return shot
        return None


def open_camera(
    kind: Literal["realsense", "azure"],
    *,
    camera: Path | None = None,
    record: Path | None = None,
    depth_scale: float | None = None,
    max_frames: int,
) -> LiveSequence:
    """The frames of a camera that is connected. Raises IdRgbdoError where there is none, or it cannot be started."""
    if kind == "realsense":
        return LiveSequence(RealSense(camera, record), max_frames, depth_scale)
    if record is not None:
        raise IdRgbdoError(
            "record: expected no file, as only a RealSense camera records while it is tracked; leave it out"
        )
    return LiveSequence(AzureKinect(camera), max_frames, depth_scale)


def _azure_sensor() -> Any:
    """Open3D's sensor. Without Microsoft's library its destructor ends the process, so that is looked for before."""
    library = K4A.get(sys.platform, "")
    try:
        if not library:
            raise OSError(f"there is none for {sys.platform}")
        ctypes.CDLL(library)
    except OSError as error:
        raise IdRgbdoError(
            f"sensor: an Azure Kinect needs Microsoft's Sensor SDK 1.4 ({error}); install libk4a1.4-dev"
        ) from error
    io = load_open3d().io
    return io.AzureKinectSensor(io.AzureKinectSensorConfig())
