"""OpenEXR files, which OpenCV's wheels do not read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import IdRgbdoError

DEPTH_CHANNELS = ("Z", "Y", "depth", "D", "R")  # in the order in which depth is looked for
SIGNATURE = b"\x76\x2f\x31\x01"


def read_exr(path: Path) -> NDArray[Any]:
    """(H, W) depth of an EXR file: the channel Z, Y, depth or R, or its only one.

    Raises IdRgbdoError without the package OpenEXR, or for a file that is damaged or has no such channel.
    """
    try:
        import OpenEXR
    except ImportError as error:
        raise IdRgbdoError(
            f'{path}: reading EXR needs OpenEXR ({error}); run `pip install "idrgbdo_torch[exr]"`, '
            "or save the depth as 16-bit PNG, float TIFF or .npy"
        ) from error
    try:
        with path.open("rb") as file:
            if file.read(4) != SIGNATURE:
                raise IdRgbdoError(f"{path}: expected an EXR image, got something else; copy or download it again")
        content = OpenEXR.File(str(path), separate_channels=True)
        channels = {name: np.asarray(channel.pixels) for name, channel in content.channels().items()}
    except (OSError, RuntimeError, ValueError) as error:
        raise IdRgbdoError(f"{path}: cannot read the image ({error}); copy or download it again") from error
    bare = {name.rsplit(".", 1)[-1].lower(): pixels for name, pixels in channels.items()}  # of layers, too
    for name in DEPTH_CHANNELS:
        if name.lower() in bare:
            return bare[name.lower()]
    if len(bare) == 1:
        return next(iter(bare.values()))
    raise IdRgbdoError(
        f"{path}: expected depth in a channel {', '.join(DEPTH_CHANNELS)}, found {', '.join(channels)}; rename it"
    )
