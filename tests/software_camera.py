"""A rendered film pushed through the software device of pyrealsense2: its real pipeline, queue and recorder."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyrealsense2 as rs
from format_writers import color, depth
from numpy.typing import NDArray
from rendered import Film

UNITS = 0.001  # metres per depth value
Images = tuple[NDArray[np.uint8], NDArray[np.uint16]]  # (H, W, 3) blue green red, (h, w) millimetres


def images(film: Film) -> list[Images]:
    """All frames as a camera gives them."""
    return [(color(film, index), depth(film, index, 1000)) for index in range(len(film.frames))]


def intrinsics(
    size: tuple[int, int],
    pinhole: Sequence[float],
    model: Any = rs.distortion.none,
    coeffs: Sequence[float] = (0.0,) * 5,
) -> Any:
    """pinhole: fx, fy, cx, cy in pixels of images of size (width, height)."""
    made = rs.intrinsics()
    made.width, made.height = size
    made.fx, made.fy, made.ppx, made.ppy = pinhole
    made.model, made.coeffs = model, list(coeffs)
    return made


class SoftwareCamera:
    """A device with a depth and a colour sensor, and a thread that shows it images at their time."""

    def __init__(
        self, of_color: Any, of_depth: Any = None, offset_m: Sequence[float] = (0.0, 0.0, 0.0), usb: str = "3.2"
    ):
        """of_color, of_depth: intrinsics; one for both unless told. offset_m: the depth camera in the colour camera."""
        self.device = rs.software_device()
        for kind, text in (("name", "film"), ("serial_number", "123"), ("usb_type_descriptor", usb)):
            self.device.register_info(getattr(rs.camera_info, kind), text)
        self.depth, self.color = (self.device.add_sensor(name) for name in ("Stereo Module", "RGB Camera"))
        streams = (
            (self.depth, rs.stream.depth, rs.format.z16, 2, of_depth or of_color),
            (self.color, rs.stream.color, rs.format.bgr8, 3, of_color),
        )
        self._profiles = []
        for uid, (sensor, stream, format, bytes_a_pixel, of_stream) in enumerate(streams):
            video = rs.video_stream()
            video.type, video.index, video.uid, video.fps = stream, 0, uid, 30
            video.width, video.height, video.intrinsics = of_stream.width, of_stream.height, of_stream
            video.bpp, video.fmt = bytes_a_pixel, format
            self._profiles.append(sensor.add_video_stream(video).as_video_stream_profile())
        self.depth.add_read_only_option(rs.option.depth_units, UNITS)
        beside = rs.extrinsics()
        beside.rotation, beside.translation = [1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0], list(offset_m)
        self._profiles[0].register_extrinsics_to(self._profiles[1], beside)
        self.device.create_matcher(rs.matchers.default)

    def play(self, shots: Sequence[Images | None], fps: float = 30.0, begin_s: float = 100.0) -> threading.Thread:
        """Show the images from a thread once the camera runs, None for one that is lost; stamped begin_s + k / 30 s."""
        thread = threading.Thread(target=self._play, args=(list(shots), fps, begin_s))
        thread.start()
        return thread

    def _play(self, shots: list[Images | None], fps: float, begin_s: float) -> None:
        patience = time.monotonic() + 60
        while not (self.color.get_active_streams() and self.depth.get_active_streams()) and time.monotonic() < patience:
            time.sleep(0.005)
        begin = time.monotonic() + 0.1
        for number, shot in enumerate(shots):
            time.sleep(max(0.0, begin + number / fps - time.monotonic()))
            if shot is None:
                continue
            for sensor, profile, image in zip((self.depth, self.color), self._profiles, shot[::-1], strict=True):
                frame = rs.software_video_frame()
                frame.pixels, frame.profile = image, profile
                frame.bpp = 2 if image.ndim == 2 else 3
                frame.stride = image.shape[1] * frame.bpp
                frame.timestamp, frame.frame_number = (begin_s + number / 30) * 1e3, number + 1
                frame.domain = rs.timestamp_domain.hardware_clock
                if image.ndim == 2:
                    frame.depth_units = UNITS
                sensor.on_video_frame(frame)
