"""Cameras through Open3D's sensors: RealSense and Azure Kinect."""

from __future__ import annotations

import ctypes
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

from ...errors import IdRgbdoError
from ...tracker.open3d_loader import load_open3d
from ..open3d_images import calibration_of, open3d_speaks, raw_pair
from .sequence import Shot

AZURE_DEPTH_SCALE = 1000.0
K4A = {"linux": "libk4a.so", "win32": "k4a.dll"}  # Azure Kinect's own library, by platform


class Open3dRealSense:
    """An Intel RealSense camera through Open3D, which tells neither frame numbers nor settings."""

    name = "realsense"
    dropped: int | None = None
    connected: bool | None = None
    warnings: tuple[str, ...] = ()

    def __init__(self, camera: Path | None = None, record: Path | None = None, sensor: Any = None) -> None:
        """Start it. camera: intrinsics instead of the camera's own. record: .bag file to write everything into.

        sensor: an object like Open3D's RealSenseSensor, for tests. Raises IdRgbdoError where there is no camera.
        """
        with open3d_speaks("the RealSense camera"):
            self._sensor = load_open3d().t.io.RealSenseSensor() if sensor is None else sensor
            if not self._sensor.enumerate_devices():
                raise IdRgbdoError(
                    "sensor: expected a RealSense camera, found none; connect one to a USB 3 port, "
                    "or choose --camera azure"
                )
            self._sensor.init_sensor(filename=str(record or ""))
            self._sensor.start_capture(record is not None)
            metadata = self._sensor.get_metadata()
        self.calibration = calibration_of(metadata.intrinsics, camera)
        self.depth_scale = float(metadata.depth_scale)

    def capture(self) -> Shot | None:
        """The next image, with the camera's own time; None where none came within some seconds."""
        with open3d_speaks("the RealSense camera"):
            image = self._sensor.capture_frame(wait=True, align_depth_to_color=True)
            return None if image.is_empty() else (self._sensor.get_timestamp() * 1e-6, partial(raw_pair, image))

    def stop(self) -> None:
        """Stop capturing, and recording."""
        with open3d_speaks("the RealSense camera"):
            self._sensor.stop_capture()


class AzureKinect:
    """A Microsoft Azure Kinect. Open3D tells neither its intrinsics nor its times: a file and the clock do."""

    name = "azure"
    dropped: int | None = None
    connected: bool | None = None
    warnings: tuple[str, ...] = ()
    depth_scale = AZURE_DEPTH_SCALE

    def __init__(self, camera: Path | None = None, sensor: Any = None) -> None:
        """Start it. camera: its intrinsics. sensor: an object like Open3D's AzureKinectSensor, for tests.

        Raises IdRgbdoError without intrinsics, Microsoft's library or a camera.
        """
        if camera is None:
            raise IdRgbdoError(
                "camera: expected intrinsics of the Azure Kinect's colour camera, got none; pass --intrinsics F.toml"
            )
        self.calibration = calibration_of(None, camera)
        with open3d_speaks("the Azure Kinect"):
            self._sensor = _azure_sensor() if sensor is None else sensor
            if not self._sensor.connect(0):
                raise IdRgbdoError("sensor: expected an Azure Kinect, found none; connect one to a USB 3 port")

    def capture(self) -> Shot | None:
        """The next image at the time it was there; None where none came."""
        with open3d_speaks("the Azure Kinect"):
            image = self._sensor.capture_frame(True)
        return None if image is None else (time.time(), partial(raw_pair, image))

    def stop(self) -> None:
        """Let go of the camera."""
        with open3d_speaks("the Azure Kinect"):
            self._sensor.disconnect()


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
