"""A RealSense lens, whatever model its maker describes it by, as OpenCV's radial and tangential one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ...errors import IdRgbdoError
from ..calibration import Calibration

GRID = (17, 13)  # pixels across and down at which the two models are compared
MOST_OFF_PX = 0.25  # between the two, before the lens counts as one of another kind


def calibration_of_profile(rs: Any, intrinsics: Any) -> Calibration:
    """The camera of pyrealsense2's intrinsics; its distortion is fitted to where the library says that pixels look.

    rs: the module. Raises IdRgbdoError for a lens that OpenCV's model does not describe.
    """
    i = intrinsics
    camera = Calibration(i.fx, i.fy, i.ppx, i.ppy, width=i.width, height=i.height, origin="camera of the device")
    if not any(i.coeffs):
        return camera
    u, v = (np.linspace(0, size - 1, count) for size, count in zip((i.width, i.height), GRID, strict=True))
    pixels = np.stack(np.meshgrid(u, v), -1).reshape(-1, 2)  # (N, 2)
    centred = (pixels - [i.ppx, i.ppy]) / [i.fx, i.fy]
    if i.model == rs.distortion.modified_brown_conrady:  # the one model that the library has forwards alone
        (x, y), seen = centred.T, np.array([rs.rs2_project_point_to_pixel(i, [*xy, 1.0]) for xy in centred.tolist()])
        seen = (seen - [i.ppx, i.ppy]) / [i.fx, i.fy]
    else:
        seen, (x, y) = centred, np.array([rs.rs2_deproject_pixel_to_point(i, p, 1.0)[:2] for p in pixels.tolist()]).T
    r2 = x * x + y * y
    # linear in k1, k2, p1, p2, k3: x (1 + k1 r2 + k2 r4 + k3 r6) + 2 p1 x y + p2 (r2 + 2 x x), and the same of y
    of_x = np.stack([x * r2, x * r2**2, 2 * x * y, r2 + 2 * x * x, x * r2**3], -1)
    of_y = np.stack([y * r2, y * r2**2, r2 + 2 * y * y, 2 * x * y, y * r2**3], -1)
    rows = np.concatenate([of_x * i.fx, of_y * i.fy])
    moved = np.concatenate([(seen[:, 0] - x) * i.fx, (seen[:, 1] - y) * i.fy])  # px
    k1, k2, p1, p2, k3 = np.linalg.lstsq(rows, moved, rcond=None)[0]
    off = float(np.abs(rows @ [k1, k2, p1, p2, k3] - moved).max())
    if not off < MOST_OFF_PX:
        raise IdRgbdoError(
            f"sensor: expected a lens with radial and tangential distortion, got {i.model}, which such a one misses by "
            f"{off:.2g} px; calibrate it and pass the file with --intrinsics"
        )
    return replace(camera, k1=float(k1), k2=float(k2), p1=float(p1), p2=float(p2), k3=float(k3))
