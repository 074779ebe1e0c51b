"""Open3D's and Redwood's layout: color/, depth/ (millimetres), the camera as JSON, trajectory.log."""

from __future__ import annotations

from pathlib import Path

from ..errors import IdRgbdoError
from ..text.files import is_named, is_plain_file, read_bytes
from ..trajectory import Trajectory, read_tum
from .by_name import Paired, pair_by_names
from .calibration import Calibration, find_calibration
from .folder import DEPTH_FOLDERS, subfolder
from .pairing import images, reader
from .poses import Matrix, by_frame, log_poses, reference, usable
from .recording import Options, Recording

COLOR_FOLDERS = ("color", "rgb", "image")
PRIMESENSE = Calibration(525.0, 525.0, 319.5, 239.5, width=640, height=480)  # Redwood's, where no file tells it
DEPTH_SCALE = 1000.0


def recognise(path: Path) -> bool:
    """Whether images stand beside a JSON file with an intrinsic matrix, or a trajectory.log."""
    folders = all(subfolder(path, names) is not None for names in (COLOR_FOLDERS, DEPTH_FOLDERS))
    return folders and (_intrinsics_file(path) is not None or (path / "trajectory.log").exists())


def read(folder: Path, options: Options) -> Recording:
    """Pair the files by their names. Raises IdRgbdoError where files are missing or cannot be read."""
    color, depth = subfolder(folder, COLOR_FOLDERS), subfolder(folder, DEPTH_FOLDERS)
    if color is None or depth is None:
        raise IdRgbdoError(f"sequence: expected color/ and depth/ in '{folder}'; put the images there")
    unnamed = PRIMESENSE if depth.name == "depth" else None  # Redwood has no folder of another name
    calibration = find_calibration(folder, options.camera, _intrinsics_file(folder) or unnamed)
    of_color, of_depth = images(color), images(depth)
    if not of_color or not of_depth:
        raise IdRgbdoError(f"sequence: expected images in '{color}' and '{depth}', found none in one of them")
    paired = pair_by_names(of_color, of_depth, folder, calibration.fps, options.association_limit_s)
    truth, doubts = _reference(folder, paired)
    return Recording(
        name=folder.resolve().name,
        title=f"Open3D/Redwood layout, {color.name}/ and {depth.name}/, {paired.how}",
        timestamps=[time for time, _, _ in paired.frames],
        read=reader([(a, b) for _, a, b in paired.frames]),
        calibration=calibration,
        depth_scale=DEPTH_SCALE,
        groundtruth=truth,
        warnings=(*paired.warnings, *doubts),
    )


def _reference(folder: Path, paired: Paired) -> tuple[Trajectory | None, tuple[str, ...]]:
    """The poses of trajectory.log, else of groundtruth.txt, and sentences where they are doubtful."""
    if not is_named(folder / "trajectory.log"):
        return usable(read_tum, folder / "groundtruth.txt", None)
    times = {number: time for number, (time, _, _) in zip(paired.numbers, paired.frames, strict=True)}
    logged, unread = usable(log_poses, folder / "trajectory.log", dict[int, Matrix]())
    poses, guessed = by_frame(logged, paired.numbers, paired.all_numbers)
    return reference(times, poses), (*unread, *guessed)


def _intrinsics_file(folder: Path) -> Path | None:
    """The JSON file that holds an intrinsic matrix, if any."""
    for path in sorted(folder.glob("*.json")):
        if is_plain_file(path) and path.stat().st_size < 10_000 and b'"intrinsic_matrix"' in read_bytes(path, 10_000):
            return path
    return None
