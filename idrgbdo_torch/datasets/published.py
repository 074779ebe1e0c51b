"""The cameras of data sets, as published, by the names of their folders."""

from __future__ import annotations

import re
from pathlib import Path

from .calibration import Calibration

BY_NAME = "camera of {}, by the folder's name"


def _vga(origin: str, *values: float) -> Calibration:
    """Of images of 640x480: fx, fy, cx, cy, k1, k2, p1, p2, k3."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = [*values, 0.0, 0.0, 0.0, 0.0, 0.0][:9]
    return Calibration(fx, fy, cx, cy, k1, k2, p1, p2, k3, width=640, height=480, origin=origin)


# Published for the TUM RGB-D benchmark's three cameras; the third's images are already undistorted.
TUM_CAMERAS = {
    "1": _vga(
        BY_NAME.format("TUM freiburg1"),
        *(517.306408, 516.469215, 318.643040, 255.313989, 0.262383, -0.953104, -0.005358, 0.002628, 1.163314),
    ),
    "2": _vga(
        BY_NAME.format("TUM freiburg2"),
        *(520.908620, 521.007327, 325.141442, 249.701764, 0.231222, -0.784899, -0.003257, -0.000105, 0.917205),
    ),
    "3": _vga(BY_NAME.format("TUM freiburg3"), 535.4, 539.2, 320.1, 247.6),
}
BONN = _vga(
    BY_NAME.format("Bonn's data set"),
    *(542.822841, 542.576870, 315.593520, 237.756098, 0.039903, -0.099343, -0.000730, -0.000144),
)
# published with fy = -480, since its y axis points up
ICL_NUIM = _vga("camera of ICL-NUIM", 481.2, 480.0, 319.5, 239.5)
ICL_NUIM_NAME = r"traj\d\w*_frei_png|(^|_)(lr|of)_?kt\d|icl[-_]?nuim"
NAMED = {
    **{rf"(?<![a-z])(freiburg|fr){number}(?!\d)": camera for number, camera in TUM_CAMERAS.items()},
    r"rgbd_bonn_": BONN,
    ICL_NUIM_NAME: ICL_NUIM,
}


def camera_by_name(folder: Path) -> Calibration | None:
    """The published camera of the data set that a folder is named after; None for another name.

    People call folders of their own fr1, too: ask only where the layout is the data set's.
    """
    name = folder.resolve().name
    return next((known for pattern, known in NAMED.items() if re.search(pattern, name, re.IGNORECASE)), None)
