"""The camera that a CameraInfo message of ROS describes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import IdRgbdoError
from .calibration import Calibration, believed


def calibration_of_info(info: Any, rectified: bool, where: str) -> Calibration:
    """Intrinsics of a CameraInfo, whose fields ROS 1 writes in capitals and ROS 2 does not."""
    K, D, P = (_field(info, name) for name in "KDP")
    if rectified:
        camera = Calibration(P[0], P[5], P[2], P[6])
    else:
        if any(D[8:]) or (any(D) and info.distortion_model not in ("plumb_bob", "rational_polynomial")):
            raise IdRgbdoError(
                f"{where}: expected the distortion model plumb_bob or rational_polynomial of up to 8 coefficients, "
                f"got {info.distortion_model} of {len(D)}; use rectified images, or pass --camera F.toml with k1, k2, "
                "p1, p2, k3, k4, k5, k6"
            )
        k1, k2, p1, p2, k3, k4, k5, k6 = [*D, *[0.0] * 8][:8]
        camera = Calibration(K[0], K[4], K[2], K[5], k1, k2, p1, p2, k3, k4, k5, k6)
    if not (camera.fx > 0 and camera.fy > 0):
        raise IdRgbdoError(f"{where}: expected a calibrated camera, got fx={camera.fx:g}; pass --camera F.toml")
    return believed(replace(camera, width=info.width or None, height=info.height or None), where)


def _field(info: Any, name: str) -> Sequence[float]:
    values = getattr(info, name) if hasattr(info, name) else getattr(info, name.lower())
    return [float(value) for value in np.asarray(values).ravel()]
