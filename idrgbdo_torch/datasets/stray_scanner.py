"""Stray Scanner, an app for iPhones and iPads with LiDAR: a folder as it comes from the phone.

rgb.mp4              colour, as the sensor saw it
depth/000000.png     millimetres, 256x192, one a frame; .npy in the app's first versions
confidence/000000.png   0, 1, 2: low, medium, high
camera_matrix.csv    of the colour images
odometry.csv         timestamp, frame, x, y, z, qx, qy, qz, qw[, fx, fy, cx, cy]: ARKit's poses, z forward
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import IdRgbdoError
from ..text.files import read_text
from . import arkit
from .builder import RawPair
from .calibration import Calibration, find_calibration
from .images import read_depth, read_labels
from .pairing import FPS, numbered
from .poses import Matrix, reference
from .recording import Options, Recording
from .video import Video

NUMBER = r"^(\d+)\.\w+$"
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
LENS = ("fx", "fy", "cx", "cy")


def recognise(path: Path) -> bool:
    """Whether the video and the camera's matrix are there."""
    return (path / "rgb.mp4").is_file() and (path / "camera_matrix.csv").is_file()


def read(folder: Path, options: Options) -> Recording:
    """Frame number i has image i of the video. Raises IdRgbdoError where files are missing or cannot be read."""
    if not (folder / "rgb.mp4").is_file():
        raise IdRgbdoError(
            f"sequence: expected rgb.mp4 in '{folder}', found none; copy the whole folder from the phone"
        )
    video = Video(folder / "rgb.mp4")
    depths, confidences = (numbered(folder / name, NUMBER) for name in ("depth", "confidence"))
    odometry = _odometry(folder / "odometry.csv")
    numbers = [number for number in depths if number < video.frames]
    if not numbers:
        raise IdRgbdoError(
            f"sequence: expected depth/000000.png to {video.frames - 1:06}.png in '{folder}', the frames of the video, "
            f"found {len(depths)} depth images; copy the whole folder from the phone"
        )
    warnings: tuple[str, ...] = ()
    if len(numbers) < max(len(depths), video.frames):
        warnings = (
            f"the video has {video.frames} frames and depth/ {len(depths)} images; {len(numbers)} have both, the "
            "others are left out",
        )

    def read_images(index: int) -> RawPair:
        number = numbers[index]
        color = video.read(number)  # in any case, for frames come one after the other
        depth = read_depth(depths[number])
        confidence = confidences.get(number)
        return color, arkit.sure(depth, None if confidence is None else read_labels(confidence))

    first = arkit.first_good(read_images, len(numbers))
    own = arkit.own_or(folder, options.camera, _camera(folder, odometry))
    usual = (own.fx, own.fy, own.cx, own.cy)

    def read_pair(index: int) -> RawPair:
        lens = odometry.lenses.get(numbers[index])
        pair = read_images(index)
        return pair if lens is None else arkit.steady(pair, lens, usual)

    fps = own.fps or video.fps or FPS
    times = {number: odometry.times.get(number, number / fps) for number in numbers}
    if not bool((np.diff(list(times.values())) > 0).all()):
        times = {number: number / fps for number in numbers}
    return Recording(
        name=folder.resolve().name,
        title="Stray Scanner",
        timestamps=list(times.values()),
        read=read_pair,
        calibration=arkit.with_depth_camera(own, first, str(folder)),
        depth_scale=1000.0,
        groundtruth=reference(times, odometry.poses),
        warnings=warnings,
        any_thread=False,  # one decoder, which goes forwards
    )


@dataclass(frozen=True)
class Odometry:
    """What odometry.csv says, by the frame's number."""

    times: dict[int, float]  # s
    poses: dict[int, Matrix]  # (4, 4) T_world_cam
    lenses: dict[int, NDArray[np.float64]]  # (4,) fx, fy, cx, cy


def _odometry(path: Path) -> Odometry:
    """Read it by the names in its first line; without such a line it is x, y, z, qx, qy, qz, qw.

    Raises IdRgbdoError for a file that cannot be read. Without a file there is no reference.
    """
    if not path.is_file():
        return Odometry({}, {}, {})
    try:
        lines = [[cell.strip() for cell in row] for row in csv.reader(io.StringIO(read_text(path))) if row]
        names = [name.lower() for name in lines[0]] if lines and "qw" in map(str.lower, lines[0]) else []
        values = np.array(lines[1:] if names else lines, np.float64).reshape(-1, len(names) or len(POSE))
        columns: dict[str, Any] = dict(zip(names or POSE, values.T, strict=True))
        numbers = columns.get("frame", np.arange(len(values))).astype(int).tolist()
        poses = arkit.rigid(*(np.stack([columns[n] for n in part], -1) for part in (POSE[:3], POSE[3:])))
        known = set(LENS) <= set(columns)
        lenses = list(np.stack([columns[name] for name in LENS], -1)) if known else []
    except (OSError, ValueError, KeyError) as error:
        raise IdRgbdoError(
            f"{path}: expected the columns timestamp, frame, {', '.join(POSE)} ({error}); copy it again"
        ) from error
    times = dict(zip(numbers, columns["timestamp"].tolist(), strict=True)) if "timestamp" in columns else {}
    return Odometry(times, dict(zip(numbers, poses, strict=True)), dict(zip(numbers, lenses, strict=False)))


def _camera(folder: Path, odometry: Odometry) -> Calibration:
    """Of camera_matrix.csv, or the median of the frames' lenses."""
    camera = find_calibration(folder, folder / "camera_matrix.csv")
    if odometry.lenses:
        fx, fy, cx, cy = arkit.usual_lens(np.stack(list(odometry.lenses.values())))
        camera = replace(camera, fx=fx, fy=fy, cx=cx, cy=cy)
    return replace(camera, origin="camera of camera_matrix.csv")
