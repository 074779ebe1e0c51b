"""A live camera in a loop: `for result in idrgbdo_torch.live.realsense(): ...`"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ..config import CameraSettings
from ..datasets.live import LiveSequence, open_camera
from ..errors import IdRgbdoError
from ..frame import BrokenFrame, RgbdFrame
from ..odometry import Odometry, Record, Status, TrackResult, run
from ..tracker.id_rgbdo import IdRgbdo
from .certainty import Certainty

__all__ = ["CameraSettings", "LiveResult", "LiveSequence", "azure", "oak", "open_camera", "realsense", "track"]


@dataclass(frozen=True)
class LiveResult:
    """What is known of a camera at one image."""

    timestamp: float  # s, of the colour image by the camera's clock
    T_world_cam: Tensor  # (4, 4) float64; the first image defines the world: x right, y down, z forward
    velocity: Tensor  # (6,) float64 [v, w] in the camera's own axes since the image before, m/s, rad/s; NaN if unknown
    status: Status
    reason: str  # one sentence; empty when OK
    covariance: Tensor  # (6, 6) float64 of the pose in the world, [x, y, z, rx, ry, rz]: m, rad; infinite if unknown
    dropped: int | None  # images so far that were never tracked; None where the camera does not number them
    frame: RgbdFrame | BrokenFrame  # the images
    measured: TrackResult  # all that the odometry says


def realsense(
    *,
    width: int = 640,
    height: int = 480,
    fps: int = 30,
    emitter: bool | None = None,
    exposure: float | None = None,
    gain: float | None = None,
    serial: str | None = None,
    camera: Path | None = None,
    record: Path | None = None,
    max_frames: int | None = None,
    odometry: Odometry | None = None,
    device: Any = None,
) -> Iterator[LiveResult]:
    """Track a RealSense camera: a result an image, until the loop is left or max_frames have come.

    width, height, fps: of both images. emitter: the infrared pattern. exposure, gain: of colour, in the camera's units
    (D400: exposure in 0.1 ms). serial: of several cameras. camera: a file with other intrinsics than the camera's own.
    record: a file for everything that the camera gives. odometry: what tracks, else IdRgbdo(); its trajectory() and map
    are there when the loop is over. device: one of pyrealsense2's, such as a software_device.
    Raises IdRgbdoError where there is no camera, it refuses a setting, or it is unplugged.
    """
    method = IdRgbdo() if odometry is None else odometry  # compiled before the camera runs
    settings = CameraSettings(width, height, fps, serial=serial, emitter=emitter, exposure=exposure, gain=gain)
    yield from track(
        open_camera("realsense", camera=camera, record=record, max_frames=max_frames, settings=settings, device=device),
        method,
    )


def oak(
    *,
    width: int = 640,
    height: int = 400,
    fps: int = 30,
    camera: Path | None = None,
    max_frames: int | None = None,
    odometry: Odometry | None = None,
    device: Any = None,
) -> Iterator[LiveResult]:
    """Track a Luxonis OAK as `realsense` does a RealSense. device: an RGBD node of depthai that is not yet started."""
    method = IdRgbdo() if odometry is None else odometry
    settings = CameraSettings(width, height, fps)
    yield from track(open_camera("oak", camera=camera, max_frames=max_frames, settings=settings, device=device), method)


def azure(*, camera: Path, max_frames: int | None = None, odometry: Odometry | None = None) -> Iterator[LiveResult]:
    """Track an Azure Kinect as `realsense` does a RealSense; camera: a file with its intrinsics."""
    method = IdRgbdo() if odometry is None else odometry
    yield from track(open_camera("azure", camera=camera, max_frames=max_frames), method)


def track(sequence: LiveSequence, odometry: Odometry) -> Iterator[LiveResult]:
    """Track a camera that was opened with open_camera. Raises IdRgbdoError, after the last result, if it is gone."""
    certainty = Certainty()
    before: tuple[Record, ...] = ()
    frames = iter(sequence)
    try:
        for frame in frames:
            record = run(odometry, (frame,), earlier=before).records[-1]
            before = (record,)
            world, velocity = certainty.follow(record)
            result = record.result
            yield LiveResult(
                record.timestamp,
                result.T_world_cam,
                torch.full((6,), torch.nan, dtype=torch.float64) if velocity is None else torch.from_numpy(velocity),
                result.status,
                result.reason,
                torch.diag(torch.full((6,), torch.inf, dtype=torch.float64))
                if world is None
                else torch.from_numpy(world),
                sequence.dropped,
                frame,
                result,
            )
    finally:
        frames.close()  # type: ignore[attr-defined]  # a generator: the camera stops when the loop is left
    if sequence.ended:
        raise IdRgbdoError(sequence.ended)
