"""Replica as rendered for NICE-SLAM: results/frame*.jpg and depth*.png, traj.txt, cam_params.json one folder up."""

from __future__ import annotations

import json
from pathlib import Path

from ..errors import IdRgbdoError
from .calibration import Calibration, find_calibration
from .pairing import FPS, numbered, pair_by_number, reader
from .poses import matrices, reference
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
    parameters = next(
        (p / "cam_params.json" for p in (folder, folder.resolve().parent) if (p / "cam_params.json").exists()), None
    )
    calibration = find_calibration(folder, options.camera, _read_camera(parameters) if parameters else PUBLISHED)
    fps = calibration.fps or FPS
    times = {number: number / fps for number in pairs}
    log = folder / "traj.txt"
    return Recording(
        name=folder.resolve().name,
        title="Replica, as NICE-SLAM lays it out",
        timestamps=list(times.values()),
        read=reader(list(pairs.values())),
        calibration=calibration,
        depth_scale=6553.5,
        groundtruth=reference(times, dict(enumerate(matrices(log)))) if log.exists() else None,
        warnings=warnings,
    )


def _read_camera(path: Path) -> Calibration:
    """cam_params.json: {"camera": {"w", "h", "fx", "fy", "cx", "cy", "scale"}}."""
    try:
        c = json.loads(path.read_text(encoding="utf-8"))["camera"]
        fx, fy, cx, cy, scale = (float(c[name]) for name in ("fx", "fy", "cx", "cy", "scale"))
        return Calibration(fx, fy, cx, cy, width=int(c["w"]), height=int(c["h"]), depth_scale=scale)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise IdRgbdoError(f"{path}: expected camera with w, h, fx, fy, cx, cy, scale ({error}); correct it") from error
