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
from ..text.files import is_named
from .builder import RawPair, unreadable_named
from .calibration import Calibration, DepthCamera, believed, find_calibration, scaled
from .pairing import FPS, numbered, pair_by_number, reader
from .poses import matrices, pose_files, reference, usable
from .recording import Options, Recording
from .usual import usual_pair

DEPTH_SCALE = 1000.0
NUMBER = r"^\D*(\d+)\.\w+$"


def recognise(path: Path) -> bool:
    """Whether the four folders' intrinsics are there."""
    return is_named(path / "intrinsic" / "intrinsic_color.txt") and (path / "color").is_dir()


def read(folder: Path, options: Options) -> Recording:
    """Pair the files by number. Raises IdRgbdoError where files are missing or cannot be read."""
    for name in ("color", "depth"):
        if not (folder / name).is_dir():
            raise IdRgbdoError(f"sequence: expected {name}/ in '{folder}', found none; extract the scan again")
    pairs, warnings = pair_by_number(numbered(folder / "color", NUMBER), numbered(folder / "depth", NUMBER), folder)
    files = list(pairs.values())
    read_files = reader(files)
    K_color = _intrinsics(folder / "intrinsic" / "intrinsic_color.txt")
    depth_file = folder / "intrinsic" / "intrinsic_depth.txt"
    _, images = usual_pair(unreadable_named(read_files), range(len(files)))
    color_size, depth_size = ((image.shape[1], image.shape[0]) for image in images)
    calibration = find_calibration(folder, options.camera, K_color)
    if calibration.depth.fx is None and is_named(depth_file):
        d = _intrinsics(depth_file)
        calibration = replace(calibration, depth=DepthCamera(d.fx, d.fy, d.cx, d.cy))
    calibration = scaled(calibration, color_size, depth_size)
    fps = calibration.fps or FPS
    times = {number: number / fps for number in pairs}
    poses, unread = pose_files([(n, folder / "pose" / f"{n}.txt") for n in pairs])

    def read_pair(index: int) -> RawPair:
        color, depth = read_files(index)
        if (color.shape[1], color.shape[0]) != color_size:
            raise IdRgbdoError(
                f"{files[index][0]}: expected {color_size[0]}x{color_size[1]} pixels as most images have, got "
                f"{color.shape[1]}x{color.shape[0]}; extract the scan again"
            )
        return np.asarray(cv2.resize(color, depth_size, interpolation=cv2.INTER_AREA), dtype=np.uint8), depth

    return Recording(
        name=folder.resolve().name,
        title="ScanNet, extracted",
        timestamps=list(times.values()),
        read=read_pair,
        calibration=calibration,
        depth_scale=DEPTH_SCALE,
        groundtruth=reference(times, poses),
        warnings=(*warnings, *unread, *_extrinsic_warnings(folder)),
    )


def _intrinsics(path: Path) -> Calibration:
    """fx, fy, cx, cy of a 4x4 matrix in text."""
    K = matrices(path)[0].tolist()
    return believed(Calibration(K[0][0], K[1][1], K[0][2], K[1][2]), str(path))


def _extrinsic_warnings(folder: Path) -> list[str]:
    """A sentence where the two cameras are said to stand apart, which the data set's own tools ignore too."""
    files = [folder / "intrinsic" / f"extrinsic_{kind}.txt" for kind in ("color", "depth")]
    extrinsics = [usable(lambda path: matrices(path)[0], path, np.eye(4))[0] for path in files]
    if all(np.allclose(T, np.eye(4), atol=1e-6) for T in extrinsics):
        return []
    return [
        "the extrinsic files say that colour and depth camera stand apart, which is not applied; "
        "a camera file with [depth] and T_color_depth applies it"
    ]
