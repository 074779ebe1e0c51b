"""A Luxonis OAK camera through its maker's library, depthai, whose RGBD node aligns depth to colour."""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np

from ...config import CameraSettings
from ...errors import IdRgbdoError
from ..calibration import Calibration, find_calibration
from .realsense import QUEUE
from .sequence import MISSED, Shot

WAIT_S = 1.0  # for an image
RADIAL = 8  # of depthai's 14 distortion coefficients: k1, k2, p1, p2, k3, k4, k5, k6 as OpenCV has them


class Oak:
    """An OAK with a stereo pair beside its colour camera."""

    name = "oak"
    depth_scale = 1000.0
    warnings: tuple[str, ...] = ()

    def __init__(self, settings: CameraSettings | None = None, camera: Path | None = None, device: Any = None) -> None:
        """Start it. Of the settings, size and rate. camera: intrinsics instead of the camera's own.

        device: an RGBD node of depthai in a pipeline that is not yet started, else one is made for the camera.
        Raises IdRgbdoError without the library or a camera.
        """
        s = settings or CameraSettings()
        if s != CameraSettings(s.width, s.height, s.fps):
            raise IdRgbdoError(
                "settings: expected size and rate alone for an OAK; set the rest with its maker's viewer"
            )
        dai = _library()
        self.dropped = 0
        self._last: int | None = None  # number of the last colour image
        self._closed = dai.MessageQueue.QueueException
        try:
            if device is None:
                device = dai.Pipeline().create(dai.node.RGBD).build(True, size=(s.width, s.height), fps=float(s.fps))
            self._pipeline = device.getParentPipeline()
            self._queue = device.rgbd.createOutputQueue(maxSize=QUEUE, blocking=False)
            self._pipeline.start()
        except RuntimeError as error:
            raise IdRgbdoError(
                f"sensor: expected an OAK camera ({error}); connect one, and close what uses it"
            ) from error
        try:
            first = next(filter(None, (self._message() for _ in range(MISSED))), None)
            if first is None:
                raise IdRgbdoError("sensor: no image came from the oak camera; check its cable and port")
            own = _calibration(dai, first.getRGBFrame().getTransformation())
            self.calibration = own if camera is None else find_calibration(camera.parent, camera)
        except IdRgbdoError:
            self.stop()
            raise
        self._waiting: Any = first

    @property
    def connected(self) -> bool:
        """Whether the library's pipeline still runs."""
        return bool(self._pipeline.isRunning())

    def capture(self) -> Shot | None:
        """The next colour image with depth of its time; None where none came within a second."""
        message, self._waiting = self._waiting or self._message(), None
        if message is None:
            return None
        color, depth = message.getRGBFrame(), message.getDepthFrame()
        number = color.getSequenceNum()
        if self._last is not None:
            self.dropped += max(0, number - self._last - 1)
        self._last = number
        images = np.array(color.getCvFrame()), np.array(depth.getFrame())  # copies: the library reuses its buffers
        return color.getTimestampDevice().total_seconds(), lambda: images

    def stop(self) -> None:
        """Stop the camera, and wait for the library's threads: where the pipeline goes before they have ended, it waits
        for them with Python's lock in hand, and one that needs it never ends.
        """
        self._pipeline.stop()
        self._pipeline.wait()

    def _message(self) -> Any:
        try:
            return self._queue.get(timedelta(seconds=WAIT_S))
        except self._closed:  # the pipeline ended, as it does when the camera is unplugged
            return None


def _calibration(dai: Any, seen: Any) -> Calibration:
    """Of an image's ImgTransformation. Raises IdRgbdoError for a lens that OpenCV's model does not describe."""
    K = np.array(seen.getIntrinsicMatrix())
    width, height = seen.getSize()
    coefficients = [float(k) for k in seen.getDistortionCoefficients()]
    fx, fy, cx, cy = (float(k) for k in (K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
    camera = Calibration(fx, fy, cx, cy, width=int(width), height=int(height), origin="camera of the device")
    if not any(coefficients):
        return camera
    if seen.getDistortionModel() != dai.CameraModel.Perspective or any(coefficients[RADIAL:]):
        raise IdRgbdoError(
            f"sensor: expected a lens with radial and tangential distortion, got {seen.getDistortionModel()} with "
            f"{coefficients}; calibrate it and pass the file with --intrinsics"
        )
    k1, k2, p1, p2, k3, k4, k5, k6 = [*coefficients, *[0.0] * RADIAL][:RADIAL]
    return replace(camera, k1=k1, k2=k2, p1=p1, p2=p2, k3=k3, k4=k4, k5=k5, k6=k6)


def _library() -> Any:
    try:
        import depthai
    except ImportError as error:
        raise IdRgbdoError(f'sensor: an OAK needs depthai ({error}); run `pip install "idrgbdo_torch[oak]"`') from error
    return depthai
