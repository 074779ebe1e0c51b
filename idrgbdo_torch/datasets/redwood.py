"""Open3D's and Redwood's layout: color/, depth/ (millimetres), the camera as JSON, trajectory.log."""

from __future__ import annotations

from pathlib import Path

from ..errors import IdRgbdoError
from ..text.files import damage_named, is_plain_file, read_bytes, read_json
from .by_name import pair_by_names
from .calibration import Calibration, believed, find_calibration
from .pairing import images, reader
from .poses import Matrix, by_frame, log_poses, reference, usable
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
    logged, unread = usable(log_poses, folder / "trajectory.log", dict[int, Matrix]())
    poses, guessed = by_frame(logged, paired.numbers, paired.all_numbers)
    return Recording(
        name=folder.resolve().name,
        title=f"Open3D/Redwood layout, {paired.how}",
        timestamps=list(times.values()),
        read=reader([(a, b) for _, a, b in paired.frames]),
        calibration=calibration,
        depth_scale=DEPTH_SCALE,
        groundtruth=reference(times, poses),
        warnings=(*paired.warnings, *unread, *guessed),
    )


def read_intrinsics(path: Path) -> Calibration:
    """Open3D's PinholeCameraIntrinsic: width, height, intrinsic_matrix column by column.

    Raises IdRgbdoError for another content.
    """
    advice = "write it with Open3D"
    content = read_json(path, "camera", advice)
    with damage_named(str(path), "width, height and an intrinsic_matrix of 9 numbers", advice):
        K = [float(number) for number in content["intrinsic_matrix"]]
        size = int(content["width"]), int(content["height"])
        return believed(Calibration(K[0], K[4], K[6], K[7], width=size[0], height=size[1]), str(path))


def _intrinsics_file(folder: Path) -> Path | None:
    """The JSON file that holds an intrinsic matrix, if any."""
    for path in sorted(folder.glob("*.json")):
        if is_plain_file(path) and path.stat().st_size < 10_000 and b'"intrinsic_matrix"' in read_bytes(path, 10_000):
            return path
    return None
