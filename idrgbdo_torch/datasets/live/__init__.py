"""Frames of a camera as they come: RealSense and OAK by their makers' libraries, others by Open3D."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

from ...config import CameraSettings
from ...errors import IdRgbdoError
from .oak import Oak
from .open3d_sensors import AzureKinect, Open3dRealSense
from .realsense import RealSense
from .sequence import LiveSequence, Sensor

__all__ = [
    "AzureKinect",
    "CameraSettings",
    "LiveSequence",
    "Oak",
    "Open3dRealSense",
    "RealSense",
    "Sensor",
    "open_camera",
]

Kind = Literal["realsense", "oak", "open3d", "azure"]


def open_camera(
    kind: Kind,
    *,
    camera: Path | None = None,
    record: Path | None = None,
    depth_scale: float | None = None,
    max_frames: int | None,
    settings: CameraSettings | None = None,
    device: Any = None,
) -> LiveSequence:
    """The frames of a camera that is connected.

    kind: "realsense" by pyrealsense2 where that is installed, else by Open3D, as "open3d" is. camera: a file with its
    intrinsics. record: a new file for all that it gives. settings: of a RealSense; of an OAK size and rate. device: of
    the maker's library, instead of the camera that is connected.
    Raises IdRgbdoError where there is no camera, it cannot be started, or a recording of that name is there.
    """
    for path in (record, record.with_suffix(".toml")) if record else ():
        if path.exists():
            raise IdRgbdoError(f"record: expected a new file, got '{path}' that is there; pass another --record")
    asked = settings is not None and settings != CameraSettings()
    if kind == "realsense" and (find_spec("pyrealsense2") or device or asked):
        return LiveSequence(RealSense(settings, camera, record, device), max_frames, depth_scale)
    if asked and kind != "oak":
        raise IdRgbdoError(
            "settings: expected none, as only pyrealsense2's cameras take them; leave them out, or choose "
            "--camera realsense"
        )
    if kind in ("realsense", "open3d"):
        return LiveSequence(Open3dRealSense(camera, record), max_frames, depth_scale)
    if record is not None:
        raise IdRgbdoError(
            "record: expected no file, as only a RealSense camera records while it is tracked; leave it out"
        )
    if kind == "oak":
        return LiveSequence(Oak(settings, camera, device), max_frames, depth_scale)
    return LiveSequence(AzureKinect(camera), max_frames, depth_scale)
