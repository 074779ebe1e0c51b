"""What Open3D's sensors and readers give, as raw images and a calibration."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import IdRgbdoError
from ..tracker.open3d_loader import load_open3d
from .builder import RawPair
from .calibration import Calibration, believed, find_calibration


def raw_pair(image: Any) -> RawPair:
    """Colour (blue, green, red) and depth of an RGBDImage of Open3D, legacy or tensor.

    Raises IdRgbdoError for colour that is not RGB of 8 bits.
    """
    color, depth = _array(image.color), _array(image.depth)
    if color.dtype != np.uint8 or color.ndim != 3 or color.shape[2] != 3:
        raise IdRgbdoError(
            f"camera: expected colour as RGB of 8 bits, got {color.dtype} of shape {color.shape}; "
            "set its colour format to RGB8"
        )
    return np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2BGR), dtype=np.uint8), depth.reshape(depth.shape[:2])


def calibration_of(intrinsics: Any, camera: Path | None) -> Calibration:
    """The camera file where there is one, else Open3D's PinholeCameraIntrinsic."""
    if camera is not None:
        return find_calibration(camera.parent, camera)
    K = np.asarray(intrinsics.intrinsic_matrix)
    stated = Calibration(
        *(float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])),
        width=int(intrinsics.width),
        height=int(intrinsics.height),
    )
    return believed(stated, "camera")


@contextmanager
def open3d_speaks(who: str) -> Iterator[None]:
    """Keep Open3D's sensors from printing; raises IdRgbdoError with one plain line for what they raise in colours."""
    utility = load_open3d().utility
    try:
        with utility.VerbosityContextManager(utility.VerbosityLevel.Error):
            yield
    except RuntimeError as error:
        text = " ".join(re.sub(r"\x1b\[[\d;]*m", "", str(error)).split())
        raise IdRgbdoError(f"sensor: {who} failed: {text}; try it with its maker's viewer") from error


def _array(image: Any) -> NDArray[Any]:
    """A copy, since a sensor reuses its buffers."""
    return np.array(image.as_tensor().numpy() if hasattr(image, "as_tensor") else image)
