"""OpenEXR files, which OpenCV's wheels do not read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import IdRgbdoError
from ..text.files import DAMAGE, is_plain_file

DEPTH_CHANNELS = ("Z", "Y", "depth", "D", "R")  # in the order in which depth is looked for
MOST_CHANNELS = 4  # of the largest image: all are unpacked
SIGNATURE = b"\x76\x2f\x31\x01"


def read_exr(path: Path, most_pixels: int) -> NDArray[Any]:
    """(H, W) depth of an EXR file: the channel Z, Y, depth or R, or its only one.

    Raises IdRgbdoError without the package OpenEXR, or for a file that is damaged, has more than `most_pixels` or no
    such channel.
    """
    try:
        import OpenEXR
    except ImportError as error:
        raise IdRgbdoError(
            f'{path}: reading EXR needs OpenEXR ({error}); run `pip install "idrgbdo_torch[exr]"`, '
            "or save the depth as 16-bit PNG, float TIFF or .npy"
        ) from error
    if not is_plain_file(path):
        raise IdRgbdoError(f"image: cannot read '{path}': there is no such file; check the list that names it")
    try:
        with path.open("rb") as file:
            if file.read(4) != SIGNATURE:
                raise IdRgbdoError(f"{path}: expected an EXR image, got something else; copy or download it again")
        parts = [part.header for part in OpenEXR.File(str(path), header_only=True).parts]
        sizes = [_size(head) for head in parts]
        width, height = sizes[0]
        numbers = sum(wide * high * len(head["channels"]) for (wide, high), head in zip(sizes, parts, strict=True))
        if numbers > MOST_CHANNELS * most_pixels:
            raise IdRgbdoError(
                f"{path}: expected depth, got {numbers >> 20} million numbers in {len(parts)} parts; write it alone"
            )
        if not all(0 < wide * high <= most_pixels for wide, high in sizes):
            raise IdRgbdoError(
                f"{path}: expected an image of at most {most_pixels >> 20} million pixels, got {width}x{height}; "
                "replace it, or resize the images"
            )
        content = OpenEXR.File(str(path), separate_channels=True)
        channels = {name: np.asarray(channel.pixels) for name, channel in content.channels().items()}
    except IdRgbdoError:
        raise
    except (*DAMAGE, RuntimeError) as error:
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


def _size(head: dict[str, Any]) -> tuple[int, int]:
    """(width, height) in px of a part of a file."""
    (left, top), (right, bottom) = (map(int, corner) for corner in head["dataWindow"])
    return right - left + 1, bottom - top + 1
