"""What a report shows of single frames: small images, the points tracked in them, and the window at that time.

A run of any length leaves a bounded amount: the longer it gets, the fewer of its frames keep their points, and fewer
still their image.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from ..frame import BrokenFrame, RgbdFrame
from ..tracker.inspection import Inspectable

WIDTH = 320  # px of an embedded image
QUALITY = 55  # of its JPEG
MOST_IMAGES = 160
MOST_FRAMES = 1000  # with points
MOST_POINTS = 64  # of a frame: those worth most
PX, MM, BITS = 8.0, 1000.0, 1000.0  # steps of the kept numbers in a pixel, a metre, a bit
LARGEST = np.iinfo(np.uint16).max
NO_IMAGE = np.zeros(0, np.uint8)


@dataclass(frozen=True)
class Glimpse:
    """What is kept of one frame."""

    number: int  # of the frame
    points: NDArray[np.uint16]  # (N, 4) u, v in 1/8 px, depth in mm (0 unknown), worth in 1/1000 bit
    window: tuple[float, ...]  # s, times of the keyframes that were still refined
    jpeg: NDArray[np.uint8]  # a JPEG file, empty where the image is not kept


def watch(
    frames: Iterable[RgbdFrame | BrokenFrame], odometry: object, into: list[Glimpse], first: int = 0
) -> Iterator[RgbdFrame | BrokenFrame]:
    """The frames, unchanged, the first of them being number `first`; what they leave goes into the list.

    It is made when the next frame is asked for, which is outside the clock of track().
    """
    for number, frame in enumerate(frames, start=first):
        yield frame
        if number and _every(number, MOST_FRAMES) > _every(number - 1, MOST_FRAMES):
            into[:] = [one for one in into if _kept(one.number, number, MOST_FRAMES)]
        if number and _every(number, MOST_IMAGES) > _every(number - 1, MOST_IMAGES):
            into[:] = [one if _kept(one.number, number, MOST_IMAGES) else replace(one, jpeg=NO_IMAGE) for one in into]
        if isinstance(frame, RgbdFrame) and _kept(number, number, MOST_FRAMES):
            jpeg = small_image(frame) if _kept(number, number, MOST_IMAGES) else NO_IMAGE
            window = odometry.window_keyframes().values() if isinstance(odometry, Inspectable) else ()
            times = tuple(keyframe.frame.timestamp for keyframe, _ in window)
            into.append(Glimpse(number, _points(frame, odometry), times, jpeg))


def small_image(frame: RgbdFrame) -> NDArray[np.uint8]:
    """The frame's image as a JPEG file of at most WIDTH px."""
    gray = frame.gray.round().clamp(0, 255).to(torch.uint8)
    image = (gray if frame.color is None else frame.color).numpy()
    scale = min(1.0, WIDTH / image.shape[1])
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    small = small if frame.color is None else cv2.cvtColor(small, cv2.COLOR_RGB2BGR)
    _, data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return np.asarray(data, np.uint8).reshape(-1)


def _points(frame: RgbdFrame, odometry: object) -> NDArray[np.uint16]:
    """(N, 4) as a Glimpse has them; the depth is what the sensor says there."""
    if not isinstance(odometry, Inspectable):
        return np.zeros((0, 4), np.uint16)
    uv, bits = (values.numpy() for values in odometry.last_points())
    best = np.sort(np.argsort(-bits, kind="stable")[:MOST_POINTS])
    uv, bits = uv[best], bits[best]
    height, width = frame.depth.shape
    column = np.clip(np.rint(uv[:, 0]).astype(np.int64), 0, width - 1)
    row = np.clip(np.rint(uv[:, 1]).astype(np.int64), 0, height - 1)
    mm = MM * frame.depth.numpy()[row, column]
    mm = np.where(mm <= LARGEST, mm, 0.0)  # too far to say
    table = np.column_stack([PX * uv[:, 0], PX * uv[:, 1], mm, BITS * bits])
    return np.asarray(np.nan_to_num(table).round().clip(0, LARGEST), np.uint16)


def _every(number: int, most: int) -> int:
    """The least power of two of which at most `most` multiples are not above `number`."""
    step = 1
    while number // step >= most:
        step *= 2
    return step


def _kept(number: int, newest: int, most: int) -> bool:
    return number % _every(newest, most) == 0
