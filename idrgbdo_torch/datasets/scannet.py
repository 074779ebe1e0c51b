"""ScanNet as its SensReader extracts it: color/, depth/ (millimetres), pose/, intrinsic/, all files numbered.

Colour is larger than depth and has intrinsics of its own. Here the colour image is reduced to the depth image's size
and the depth mapped into it by the two cameras' intrinsics.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from ..errors import IdRgbdoError
from .builder import RawPair
from .calibration import Calibration, DepthCamera, find_calibration, scaled
from .images import read_color, read_depth
from .pairing import FPS, numbered, pair_by_number
from .poses import matrices, pose_files, reference
from .recording import LOOK_AT, Options, Recording

DEPTH_SCALE = 1000.0
NUMBER = r"^\D*(\d+)\.\w+$"


def recognise(path: Path) -> bool:
    """Whether the four folders' intrinsics are there."""
    return (path / "intrinsic" / "intrinsic_color.txt").is_file() and (path / "color").is_dir()


def read(folder: Path, options: Options) -> Recording:
    """Pair the files by number. Raises IdRgbdoError where files are missing or cannot be read."""
    for name in ("color", "depth"):
        if not (folder / name).is_dir():
            raise IdRgbdoError(f"sequence: expected {name}/ in '{folder}', found none; extract the scan again")
    pairs, warnings = pair_by_number(numbered(folder / "color", NUMBER), numbered(folder / "depth", NUMBER), folder)
    files = list(pairs.values())
    K_color = _intrinsics(folder / "intrinsic" / "intrinsic_color.txt")
    depth_file = folder / "intrinsic" / "intrinsic_depth.txt"
    color_size, depth_size = _sizes(files)
    calibration = find_calibration(folder, options.camera, K_color)
    if calibration.depth.fx is None and depth_file.exists():
        d = _intrinsics(depth_file)
        calibration = replace(calibration, depth=DepthCamera(d.fx, d.fy, d.cx, d.cy))
    calibration = scaled(calibration, color_size, depth_size)
    fps = calibration.fps or FPS
    times = {number: number / fps for number in pairs}

    def read_pair(index: int) -> RawPair:
        color, depth = (read(path) for read, path in zip((read_color, read_depth), files[index], strict=True))
        return np.asarray(cv2.resize(color, depth_size, interpolation=cv2.INTER_AREA), dtype=np.uint8), depth

    return Recording(
        name=folder.resolve().name,
        title="ScanNet, extracted",
        timestamps=list(times.values()),
        read=read_pair,
        calibration=calibration,
        depth_scale=DEPTH_SCALE,
        groundtruth=reference(times, pose_files([(n, folder / "pose" / f"{n}.txt") for n in pairs])),
        warnings=(*warnings, *_extrinsic_warnings(folder)),
    )


def _intrinsics(path: Path) -> Calibration:
    """fx, fy, cx, cy of a 4x4 matrix in text."""
    K = matrices(path)[0]
    return Calibration(K[0, 0], K[1, 1], K[0, 2], K[1, 2])


def _sizes(files: list[tuple[Path, Path]]) -> tuple[tuple[int, int], tuple[int, int]]:
    """(width, height) of the first good colour and depth image. Raises the first one's error where none is good."""
    first_error: IdRgbdoError | None = None
    for color, depth in files[:LOOK_AT]:
        try:
            color_shape, depth_shape = read_color(color).shape, read_depth(depth).shape
            return (color_shape[1], color_shape[0]), (depth_shape[1], depth_shape[0])
        except IdRgbdoError as error:
            first_error = first_error or error
    raise first_error or IdRgbdoError("sequence: expected images, found none; extract the scan again")


def _extrinsic_warnings(folder: Path) -> list[str]:
    """A sentence where the two cameras are said to stand apart, which the data set's own tools ignore too."""
    files = [folder / "intrinsic" / f"extrinsic_{kind}.txt" for kind in ("color", "depth")]
    if all(np.allclose(matrices(path)[0], np.eye(4), atol=1e-6) for path in files if path.exists()):
        return []
    return [
        "the extrinsic files say that colour and depth camera stand apart, which is not applied; "
        "a camera file with [depth] and T_color_depth applies it"
    ]
