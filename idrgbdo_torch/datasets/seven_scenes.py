"""7-Scenes as published: frame-000000.color.png, .depth.png (not registered), .pose.txt in a folder for each sequence.

The data set has no calibration. Depth intrinsics are those its authors used (585, centre at 320, 240), the colour
camera is a Kinect's usual one, and between the two stands the calibration that the relocalisation literature uses
(LIRIS, projet.liris.cnrs.fr/voir/activities-dataset/kinect-calibration.html); a camera file with [depth] replaces all.
The published poses are KinectFusion's, so they are of the depth camera.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .calibration import Calibration, DepthCamera, find_calibration
from .pairing import FPS, numbered, pair_by_number, reader
from .poses import is_pose, pose_files, reference
from .recording import Options, Recording

KINECT = Calibration(
    *(525.0, 525.0, 320.0, 240.0),
    depth=DepthCamera(
        *(585.0, 585.0, 320.0, 240.0),
        T_color_depth=(
            (9.9996518012567637e-01, 2.6765126468950343e-03, -7.9041012313000904e-03, -2.5558943178152542e-02),
            (-2.7409311281316700e-03, 9.9996302803027592e-01, -8.1504520778013286e-03, 1.0109636268061706e-04),
            (7.8819942130445332e-03, 8.1718328771890631e-03, 9.9993554558014031e-01, 2.0318321729487039e-03),
        ),
    ),
)
DEPTH_SCALE = 1000.0


def recognise(path: Path) -> bool:
    """Whether there are files named as in 7-Scenes."""
    return any(path.glob("frame-*.color.png"))


def read(folder: Path, options: Options) -> Recording:
    """Pair the files by number. Raises IdRgbdoError where depth images are missing."""
    color = numbered(folder, r"^frame-(\d+)\.color\.png$")
    depth = numbered(folder, r"^frame-(\d+)\.depth\.png$")
    pairs, warnings = pair_by_number(color, depth, folder)
    calibration = find_calibration(folder, options.camera, KINECT)
    fps = calibration.fps or FPS
    T_depth_color = np.linalg.inv(calibration.T_color_depth())
    poses, unread = pose_files(
        [(number, path.with_name(path.name.replace(".color.png", ".pose.txt"))) for number, (path, _) in pairs.items()]
    )
    return Recording(
        name=f"{folder.resolve().parent.name}_{folder.resolve().name}",
        title="7-Scenes",
        timestamps=[number / fps for number in pairs],
        read=reader(list(pairs.values())),
        calibration=calibration,
        depth_scale=DEPTH_SCALE,
        groundtruth=reference(
            {number: number / fps for number in pairs},
            {number: T @ T_depth_color for number, T in poses.items() if is_pose(T)},
        ),
        warnings=(*warnings, *unread),
    )
