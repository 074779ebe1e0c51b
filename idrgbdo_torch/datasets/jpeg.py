"""JPEG files by a newer libjpeg-turbo than OpenCV has, to the same bits; what it complains of is left to OpenCV."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

try:
    import simplejpeg
except ImportError:  # there is no wheel for every machine
    simplejpeg = None


def decode_jpeg(data: bytes) -> NDArray[np.uint8] | None:
    """(H, W, 3) uint8 blue, green, red, or None for what is no sound JPEG, or where libjpeg-turbo is not installed.

    Gray levels are made from the colours, as for every other format: the decoder's own are others by up to 14.
    """
    if simplejpeg is None or not data.startswith(b"\xff\xd8"):
        return None
    try:
        return np.asarray(simplejpeg.decode_jpeg(data, "BGR"))
    except ValueError:
        return None
