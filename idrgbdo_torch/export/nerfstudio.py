"""transforms.json of nerfstudio: poses of cameras with OpenGL's axes, in metres.

OpenGL's camera looks along -z with y up, ours along +z with y down. nerfstudio, like COLMAP, has the centre of the
top-left pixel at (0.5, 0.5).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..definitions.camera import Pinhole
from ..errors import IdRgbdoError
from .images import color_name, depth_name
from .tracked import TrackedRun

HALF = 0.5  # px
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # T_cam_opengl
POINTS = "sparse_pc.ply"  # the name that nerfstudio gives its own


def opengl(T_world_cam: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4, 4) of the camera with OpenGL's axes, in the same world."""
    return np.asarray(T_world_cam @ OPENGL)


def write_transforms(folder: Path, run: TrackedRun, frames: Sequence[int], camera: Pinhole) -> None:
    """Write transforms.json beside the images and POINTS. Raises IdRgbdoError where that fails."""
    path = folder / "transforms.json"
    content = {
        "camera_model": "OPENCV",
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "cx": camera.cx + HALF,
        "cy": camera.cy + HALF,
        "w": camera.width,
        "h": camera.height,
        **dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0),  # the images are undistorted
        "ply_file_path": POINTS,
        "frames": [
            {
                "file_path": color_name(number),
                "depth_file_path": depth_name(number),
                "transform_matrix": opengl(run.T_world_cam[number]).tolist(),
            }
            for number in frames
        ],
    }
    try:
        path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        raise IdRgbdoError(f"out: cannot write '{path}': {error.strerror}; pass another --out") from error
