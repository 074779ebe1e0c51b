"""ICL-NUIM as published, in either of its two forms.

- "TUM RGB-D compatible PNGs": rgb/, depth/ (along the optical axis), associations.txt with frame numbers for times, and
  poses in *.gt.freiburg, downloaded apart.
- POV-Ray's own: scene_00_0000.png, .depth (text, centimetres along the ray), .txt (position and axes of the camera).

Both have a camera whose y axis points up, which is why the published fy is negative. Poses here have it point down:
T = M T_published M with M = diag(1, -1, 1, 1). Source: the README of ankurhanda/living_room_iclnuim.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import IdRgbdoError
from ..text.files import damage_named, is_plain_file, read_bytes, read_text
from ..trajectory import read_tum
from .builder import RawPair
from .calibration import Calibration, find_calibration
from .images import MOST_BYTES, MOST_PIXELS, read_color
from .pairing import FPS, numbered, reader
from .poses import Matrix, pose_files, reference, usable
from .published import ICL_NUIM, ICL_NUIM_NAME
from .recording import Options, Recording
from .tum import DEPTH_SCALE, read_associations

M = np.diag([1.0, -1.0, 1.0, 1.0])


def recognise(path: Path) -> bool:
    """Whether there are POV-Ray's depth files, or numbered pairs beside the poses or in a folder of the set's name.

    Numbered pairs alone are how people prepare recordings of their own, too.
    """
    if any(path.glob("scene_*.depth")):
        return True
    if (path / "rgb.txt").exists() or not is_plain_file(path / "associations.txt"):
        return False
    named = re.search(ICL_NUIM_NAME, path.resolve().name, re.IGNORECASE) is not None
    return named or any(path.glob("*.gt.freiburg"))


def read(folder: Path, options: Options) -> Recording:
    """Either form. Raises IdRgbdoError where files are missing or cannot be read."""
    calibration = find_calibration(folder, options.camera, ICL_NUIM)
    return _read_povray(folder, calibration) if any(folder.glob("scene_*.depth")) else _read_pngs(folder, calibration)


def _read_pngs(folder: Path, calibration: Calibration) -> Recording:
    listed = read_associations(folder / "associations.txt").frames
    frames = [(round(number), color, depth) for number, color, depth in listed]
    fps = calibration.fps or FPS
    poses: dict[int, Matrix] = {}
    unread: tuple[str, ...] = ()
    for path in sorted(folder.glob("*.gt.freiburg"))[:1]:
        truth, unread = usable(read_tum, path, None)
        numbers = [round(time) for time in truth.timestamps.tolist()] if truth else []
        T_world_cam = truth.T_world_cam.numpy() if truth else ()
        poses = {number: M @ T @ M for number, T in zip(numbers, T_world_cam, strict=True)}
    return Recording(
        name=folder.resolve().name,
        title="ICL-NUIM, PNG files",
        timestamps=[number / fps for number, _, _ in frames],
        read=reader([(color, depth) for _, color, depth in frames]),
        calibration=calibration,
        depth_scale=DEPTH_SCALE,
        groundtruth=reference({number: number / fps for number, _, _ in frames}, poses),
        warnings=unread,
    )


def _read_povray(folder: Path, calibration: Calibration) -> Recording:
    images = numbered(folder, r"^scene_(?:\d+_)?(\d+)\.png$")
    fps = calibration.fps or FPS
    if not images:
        raise IdRgbdoError(
            f"sequence: expected scene_*.png beside the .depth files of '{folder}', found none; add them"
        )
    files = list(images.values())
    poses, unread = pose_files([(number, path.with_suffix(".txt")) for number, path in images.items()], _pose)

    def read_pair(index: int) -> RawPair:
        color = read_color(files[index])
        height, width = color.shape[:2]
        along_ray = _read_ray_depth(files[index].with_suffix(".depth"), height, width)
        return color, along_ray / _ray_lengths(calibration, height, width)

    return Recording(
        name=folder.resolve().name,
        title="ICL-NUIM, POV-Ray files",
        timestamps=[number / fps for number in images],
        read=read_pair,
        calibration=calibration,
        depth_scale=1.0,
        groundtruth=reference({number: number / fps for number in images}, poses),
        warnings=unread,
    )


def _read_ray_depth(path: Path, height: int, width: int) -> NDArray[np.float32]:
    """(H, W) metres from the camera's centre to the surface."""
    data = read_bytes(path, MOST_BYTES, "image", "download it again")
    of_pixels = damage_named(str(path), "the depth of each pixel", "download it again")
    with of_pixels, np.errstate(over="ignore"):  # infinity is unknown depth
        numbers = np.array(data.split(maxsplit=MOST_PIXELS), dtype=np.float32)
    if len(numbers) != height * width:
        raise IdRgbdoError(f"{path}: expected {height * width} numbers, got {len(numbers)}; download it again")
    return numbers.reshape(height, width) / np.float32(100)


def _ray_lengths(calibration: Calibration, height: int, width: int) -> NDArray[np.float32]:
    """(H, W) length of each pixel's ray up to depth 1."""
    x = (np.arange(width) - calibration.cx) / calibration.fx
    y = (np.arange(height) - calibration.cy) / calibration.fy
    return np.sqrt(1 + x[None, :] ** 2 + y[:, None] ** 2).astype(np.float32)


def _pose(path: Path) -> Matrix:
    """T_world_cam of the lines `cam_pos = [x, y, z]'` (centimetres), `cam_dir`, `cam_up`; NaN where one is missing."""
    text = read_text(path, "pose")
    vectors = {}
    for name, numbers in re.findall(r"(cam_pos|cam_dir|cam_up)\s*=\s*\[([^\]]*)\]", text):
        fields = numbers.replace(",", " ").split()
        with damage_named(str(path), f"the numbers of {name}", "download it again"):
            vectors[name] = np.array([float(field) for field in fields]) if len(fields) == 3 else np.full(3, np.nan)
    if len(vectors) < 3:
        return np.full((4, 4), np.nan)
    with np.errstate(all="ignore"):  # NaN for directions that are none
        z = vectors["cam_dir"] / np.linalg.norm(vectors["cam_dir"])
        x = np.cross(vectors["cam_up"], z)
        x /= np.linalg.norm(x)
        T = np.eye(4)
        T[:3] = np.column_stack([x, np.cross(z, x), z, vectors["cam_pos"] / 100])
        return np.asarray(M @ T @ M)
