"""A RealSense camera through its maker's own library, pyrealsense2."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...config import CameraSettings
from ...errors import IdRgbdoError
from ...tracker.open3d_loader import load_libusb
from ..calibration import Calibration, DepthCamera, find_calibration
from .lens import calibration_of_profile
from .sequence import Shot

WAIT_S = 1.0  # for an image
QUEUE = 30  # framesets that wait while the tracker is busy; the oldest goes where more come
APART = 0.6  # of the time between two images, that colour and depth of one frame may be apart


class RealSense:
    """An Intel RealSense camera; depth is registered to colour by this package, as it is in recordings."""

    name = "realsense"

    def __init__(
        self,
        settings: CameraSettings | None = None,
        camera: Path | None = None,
        record: Path | None = None,
        device: Any = None,
    ) -> None:
        """Start it. camera: intrinsics instead of the camera's own. record: a file to write everything into; the
        camera is written beside it as .toml, and both together are a recording that `idrgbdo run` reads.

        device: a device of pyrealsense2, such as its software_device; by default the camera that is connected.
        Raises IdRgbdoError without the library or a camera, or for settings that the camera refuses.
        """
        self._rs = rs = _library()
        self._settings = s = settings or CameraSettings()
        self.dropped = 0
        self._last: int | None = None  # number of the last colour image that was given
        self._queue = rs.frame_queue(QUEUE, True)
        with realsense_speaks():
            self._pipeline = rs.pipeline(rs.context())
            self._device = _connected(rs, s.serial) if device is None else device
            self.warnings = _usb_warning(rs, self._device)
            config = rs.config()
            if device is None:
                config.enable_device(self._device.get_info(rs.camera_info.serial_number))
            else:
                self._pipeline.set_device(device)
            size = (s.depth_width or s.width, s.depth_height or s.height)
            config.enable_stream(rs.stream.depth, *size, rs.format.z16, s.fps)
            config.enable_stream(rs.stream.color, s.width, s.height, rs.format.bgr8, s.fps)
            if record is not None:
                config.enable_record_to_file(str(record))
            self._adjust()
            profile = self._pipeline.start(config, self._queue)
        try:
            with realsense_speaks():
                own = self._calibration(profile)
                self._waiting: Shot | None = None
                self.depth_scale = self._first_scale()
            self.calibration = own if camera is None else find_calibration(camera.parent, camera)
            if record is not None:
                record.with_suffix(".toml").write_text(camera_text(self.calibration, self.depth_scale))
        except (IdRgbdoError, OSError):
            self.stop()
            raise

    @property
    def connected(self) -> bool:
        """Whether the library still sees the camera."""
        return bool(self._device.is_connected())

    def capture(self) -> Shot | None:
        """The next colour image with depth of its time; None where none came within a second."""
        if self._waiting is not None:
            shot, self._waiting = self._waiting, None
            return shot
        pair = self._pair()
        return None if pair is None else _shot(*pair)

    def stop(self) -> None:
        """Stop the camera, and the recording."""
        with suppress(RuntimeError):  # of a camera that is gone
            self._pipeline.stop()

    def _pair(self) -> tuple[Any, Any] | None:
        """The next colour frame with the depth frame of its time. The library also gives half-new pairs: they wait."""
        end = time.monotonic() + WAIT_S
        with realsense_speaks():
            while (left := end - time.monotonic()) > 0:
                there, frame = self._queue.try_wait_for_frame(max(1, int(left * 1e3)))
                frames = frame.as_frameset() if there else None
                color, depth = (frames.get_color_frame(), frames.get_depth_frame()) if frames else (None, None)
                if not color or not depth or color.frame_number == self._last or self._apart(color, depth):
                    continue
                if self._last is not None:
                    self.dropped += max(0, color.frame_number - self._last - 1)
                self._last = color.frame_number
                return color, depth
        return None

    def _apart(self, color: Any, depth: Any) -> bool:
        """Whether the two are of different frames, where they are on one clock."""
        if color.frame_timestamp_domain != depth.frame_timestamp_domain:
            return False
        return bool(abs(color.timestamp - depth.timestamp) > APART * 1e3 / self._settings.fps)

    def _first_scale(self) -> float:
        """Depth values per metre, which the first depth image tells; it is kept for `capture`."""
        for _ in range(3):
            pair = self._pair()
            if pair is not None:
                self._waiting = _shot(*pair)
                units = float(pair[1].get_units())  # metres per value
                whole = round(1 / units)
                return float(whole) if abs(whole * units - 1) < 1e-4 else 1 / units
        raise IdRgbdoError("sensor: no image came from the realsense camera; check its cable and port")

    def _calibration(self, profile: Any) -> Calibration:
        """Of colour, with the depth camera beside it unless both are one."""
        rs = self._rs
        color, depth = (profile.get_stream(s).as_video_stream_profile() for s in (rs.stream.color, rs.stream.depth))
        calibration = calibration_of_profile(rs, color.get_intrinsics())
        d, e = depth.get_intrinsics(), depth.get_extrinsics_to(color)
        T = np.column_stack([np.reshape(e.rotation, (3, 3)).T, e.translation])  # the library writes it by columns
        same = (d.width, d.height, d.fx, d.fy, d.ppx, d.ppy) == (
            *(calibration.width, calibration.height),
            *(calibration.fx, calibration.fy, calibration.cx, calibration.cy),
        )
        if same and np.allclose(T, np.eye(3, 4), atol=1e-9):
            return calibration
        return replace(calibration, depth=DepthCamera(d.fx, d.fy, d.ppx, d.ppy, tuple(map(tuple, T.tolist()))))

    def _adjust(self) -> None:
        """Set what was asked for. Raises IdRgbdoError for what the camera does not have, or another range."""
        rs, s = self._rs, self._settings
        color, depth = (_sensor(self._device, kind) for kind in (rs.stream.color, rs.stream.depth))
        wanted = [
            (depth, rs.option.emitter_enabled, "emitter", None if s.emitter is None else float(s.emitter)),
            (color, rs.option.exposure, "exposure", s.exposure),
            (color, rs.option.gain, "gain", s.gain),
        ]
        if (s.exposure is not None or s.gain is not None) and color and color.supports(rs.option.enable_auto_exposure):
            color.set_option(rs.option.enable_auto_exposure, 0.0)
        for sensor, option, name, value in wanted:
            if value is None:
                continue
            if sensor is None or not sensor.supports(option):
                raise IdRgbdoError(f"{name}: expected a camera that has this setting, this one has not; leave it out")
            limits = sensor.get_option_range(option)
            if not limits.min <= value <= limits.max:
                raise IdRgbdoError(
                    f"{name}: expected {limits.min:g} to {limits.max:g} for this camera, got {value:g}; change it"
                )
            sensor.set_option(option, value)


@contextmanager
def realsense_speaks() -> Iterator[None]:
    """Raises IdRgbdoError for what the library raises."""
    try:
        yield
    except RuntimeError as error:
        text = " ".join(str(error).split())
        raise IdRgbdoError(f"sensor: the RealSense camera failed: {text}; try it with realsense-viewer") from error


def camera_text(calibration: Calibration, depth_scale: float) -> str:
    """The camera as a camera.toml, the depth camera included."""
    c = calibration
    names = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    lines = [f"{name} = {float(getattr(c, name))!r}" for name in names]
    lines.append(f"depth_scale = {float(c.depth_scale or depth_scale)!r}")
    if c.depth.fx is not None:
        lines.append("[depth]")
        lines += [f"{name} = {float(getattr(c.depth, name))!r}" for name in ("fx", "fy", "cx", "cy")]
        lines.append(f"T_color_depth = {[list(row) for row in c.depth.T_color_depth]}")
    return "\n".join(lines) + "\n"


def _shot(color: Any, depth: Any) -> Shot:
    """Copies of the two images, as the library reuses its memory."""
    images = np.array(color.get_data()), np.array(depth.get_data())
    return color.timestamp * 1e-3, lambda: images


def _library() -> Any:
    load_libusb()  # which its library links to
    try:
        import pyrealsense2
    except ImportError as error:
        raise IdRgbdoError(
            f'sensor: a RealSense camera needs pyrealsense2 ({error}); run `pip install "idrgbdo_torch[realsense]"`, '
            "or choose --camera open3d"
        ) from error
    return pyrealsense2


def _connected(rs: Any, serial: str | None) -> Any:
    """The camera that is connected, or the one of that serial number."""
    devices = {device.get_info(rs.camera_info.serial_number): device for device in rs.context().query_devices()}
    if not devices:
        raise IdRgbdoError(
            "sensor: expected a RealSense camera, found none; connect one to a USB 3 port, or choose --camera azure"
        )
    if serial is not None and serial not in devices:
        raise IdRgbdoError(f"serial: expected one of {', '.join(devices)}, got {serial}; change it or leave it out")
    return devices[serial] if serial is not None else next(iter(devices.values()))


def _sensor(device: Any, stream: Any) -> Any:
    """The sensor of a device that gives such images; None where there is none."""
    found = (s for s in device.query_sensors() if any(p.stream_type() == stream for p in s.get_stream_profiles()))
    return next(found, None)


def _usb_warning(rs: Any, device: Any) -> tuple[str, ...]:
    kind = rs.camera_info.usb_type_descriptor
    usb = device.get_info(kind) if device.supports(kind) else ""
    if not usb.startswith("2"):
        return ()
    return (f"the camera is connected by USB {usb}, which is too slow for many sizes and rates; use a USB 3 port",)
