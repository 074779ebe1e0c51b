"""Replica as rendered for NICE-SLAM: results/frame*.jpg and depth*.png, traj.txt, cam_params.json one folder up."""

from __future__ import annotations

from pathlib import Path

from ..text.files import damage_named, is_plain_file, read_json
from .calibration import Calibration, believed, find_calibration
from .pairing import FPS, numbered, pair_by_number, reader
from .poses import NO_POSES, matrices, reference, usable
from .recording import Options, Recording

PUBLISHED = Calibration(600.0, 600.0, 599.5, 339.5, width=1200, height=680, depth_scale=6553.5)


def recognise(path: Path) -> bool:
    """Whether results/ holds images named as in Replica."""
    return any((path / "results").glob("frame*.jpg")) or any((path / "results").glob("frame*.png"))


def read(folder: Path, options: Options) -> Recording:
    """Pair the files by number. Raises IdRgbdoError where files are missing or cannot be read."""
    results = folder / "results"
    color, depth = numbered(results, r"^frame(\d+)\.\w+$"), numbered(results, r"^depth(\d+)\.\w+$")
    pairs, warnings = pair_by_number(color, depth, results)
    places = (place / "cam_params.json" for place in (folder, folder.resolve().parent))
    parameters = next((path for path in places if is_plain_file(path)), None)
    calibration = find_calibration(folder, options.camera, _read_camera(parameters) if parameters else PUBLISHED)
    fps = calibration.fps or FPS
    times = {number: number / fps for number in pairs}
    poses, unread = usable(matrices, folder / "traj.txt", NO_POSES)
    return Recording(
        name=folder.resolve().name,
        title="Replica, as NICE-SLAM lays it out",
        timestamps=list(times.values()),
        read=reader(list(pairs.values())),
        calibration=calibration,
        depth_scale=6553.5,
        groundtruth=reference(times, dict(enumerate(poses))),
        warnings=(*warnings, *unread),
    )


def _read_camera(path: Path) -> Calibration:
    """cam_params.json: {"camera": {"w", "h", "fx", "fy", "cx", "cy", "scale"}}."""
    content = read_json(path, "camera")
    with damage_named(str(path), "camera with w, h, fx, fy, cx, cy, scale"):
        c = content["camera"]
        fx, fy, cx, cy, scale = (float(c[name]) for name in ("fx", "fy", "cx", "cy", "scale"))
        camera = Calibration(fx, fy, cx, cy, width=int(c["w"]), height=int(c["h"]), depth_scale=scale)
        return believed(camera, str(path))
