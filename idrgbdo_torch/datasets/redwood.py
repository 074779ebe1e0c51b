"""Open3D's and Redwood's layout: color/, depth/ (millimetres), the camera as JSON, trajectory.log."""

from __future__ import annotations

import json
from pathlib import Path

from ..errors import IdRgbdoError
from .by_name import pair_by_names
from .calibration import Calibration, find_calibration
from .pairing import images, reader
from .poses import by_frame, log_poses, reference
from .recording import Options, Recording

COLOR_FOLDERS = ("color", "rgb", "image")
PRIMESENSE = Calibration(525.0, 525.0, 319.5, 239.5, width=640, height=480)  # Redwood's, where no file tells it
DEPTH_SCALE = 1000.0


def recognise(path: Path) -> bool:
    """Whether images stand beside a JSON file with an intrinsic matrix, or a trajectory.log."""
    folders = any((path / name).is_dir() for name in COLOR_FOLDERS) and (path / "depth").is_dir()
    return folders and (_intrinsics_file(path) is not None or (path / "trajectory.log").exists())


def read(folder: Path, options: Options) -> Recording:
    """Pair the files by their names. Raises IdRgbdoError where files are missing or cannot be read."""
    color = next((folder / name for name in COLOR_FOLDERS if (folder / name).is_dir()), None)
    if color is None or not (folder / "depth").is_dir():
        raise IdRgbdoError(f"sequence: expected color/ and depth/ in '{folder}'; put the images there")
    intrinsics = _intrinsics_file(folder)
    camera = read_intrinsics(intrinsics) if intrinsics else PRIMESENSE
    calibration = find_calibration(folder, options.camera, camera)
    of_color, of_depth = images(color), images(folder / "depth")
    if not of_color or not of_depth:
        raise IdRgbdoError(
            f"sequence: expected images in '{color}' and '{folder / 'depth'}', found none in one of them"
        )
    paired = pair_by_names(of_color, of_depth, folder, calibration.fps, options.association_limit_s)
    times = {number: time for number, (time, _, _) in zip(paired.numbers, paired.frames, strict=True)}
    log = folder / "trajectory.log"
    poses, guessed = by_frame(log_poses(log), paired.numbers, paired.all_numbers) if log.exists() else ({}, ())
    return Recording(
        name=folder.resolve().name,
        title=f"Open3D/Redwood layout, {paired.how}",
        timestamps=list(times.values()),
        read=reader([(a, b) for _, a, b in paired.frames]),
        calibration=calibration,
        depth_scale=DEPTH_SCALE,
        groundtruth=reference(times, poses),
        warnings=(*paired.warnings, *guessed),
    )


def read_intrinsics(path: Path) -> Calibration:
    """Open3D's PinholeCameraIntrinsic: width, height, intrinsic_matrix column by column.

    Raises IdRgbdoError for another content.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        K = [float(number) for number in content["intrinsic_matrix"]]
        return Calibration(K[0], K[4], K[6], K[7], width=int(content["width"]), height=int(content["height"]))
    except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
        raise IdRgbdoError(
            f"{path}: expected width, height and an intrinsic_matrix of 9 numbers ({error}); write it with Open3D"
        ) from error


def _intrinsics_file(folder: Path) -> Path | None:
    """The JSON file that holds an intrinsic matrix, if any."""
    small = (path for path in sorted(folder.glob("*.json")) if path.stat().st_size < 10_000)
    return next((path for path in small if '"intrinsic_matrix"' in path.read_text(errors="replace")), None)
