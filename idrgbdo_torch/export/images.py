"""The images of an export as the tracker saw them: undistorted colour, depth registered to it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import IdRgbdoError
from ..frame import BrokenFrame, RgbdFrame
from .tracked import Read

DEPTH_SCALE = 1000.0  # values per metre: what nerfstudio and most others expect
MOST_M = 65.535  # that 16 bits hold


@dataclass(frozen=True)
class Written:
    """Which frames have their images in the folder."""

    frames: tuple[int, ...]
    broken: int  # frames that could not be read


def color_name(number: int) -> str:
    """The file of a frame, relative to the export's folder."""
    return f"images/{image_name(number)}"


def depth_name(number: int) -> str:
    """The same of its depth: 16-bit millimetres, 0 where unknown."""
    return f"depth/{image_name(number)}"


def image_name(number: int) -> str:
    """The file's name alone."""
    return f"frame_{number:06}.png"


def write_images(
    folder: Path, frames: Sequence[int], read: Read, with_depth: bool, on_frame: Callable[[str], None]
) -> Written:
    """Write the frames' images as PNG; those of an earlier export go. Raises IdRgbdoError where that fails."""
    for kind in ("images", "depth"):
        for old in (folder / kind).glob(f"frame_{6 * '[0-9]'}.png"):
            old.unlink()
    written = []
    for number in frames:
        frame = read(number)
        on_frame("")
        if isinstance(frame, BrokenFrame):
            continue
        save(folder / color_name(number), bgr(frame))
        if with_depth:
            depth = frame.depth.numpy()
            near = np.where(depth < MOST_M, depth, 0.0)
            save(folder / depth_name(number), np.rint(near * DEPTH_SCALE).astype(np.uint16))
        written.append(number)
    if not written:
        raise IdRgbdoError("source: no chosen frame could be read; try idrgbdo check")
    return Written(tuple(written), len(frames) - len(written))


def bgr(frame: RgbdFrame) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 in OpenCV's order, gray where the frame came without colour."""
    if frame.color is not None:
        return np.ascontiguousarray(frame.color.numpy()[..., ::-1])
    return np.repeat(gray8(frame)[..., None], 3, axis=2)


def gray8(frame: RgbdFrame) -> NDArray[np.uint8]:
    """(H, W) uint8."""
    return np.asarray(np.rint(frame.gray.numpy().clip(0, 255)), np.uint8)


def save(path: Path, image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    """Write a PNG. Raises IdRgbdoError where that fails."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(cv2.imencode(".png", image)[1].tobytes())
    except OSError as error:
        raise IdRgbdoError(f"out: cannot write '{path}': {error.strerror}; pass another --out") from error
