"""Images that a camera gave twice: a driver without a new one passes on the last, which shows an earlier time.

In dim light a colour camera drops to half its rate while depth goes on, and a busy computer drops images of either
kind. Sensors have noise, so two equal images are one. Taken for new, such a colour image says that the camera stopped
for a frame, and such a depth image, that surfaces moved with the camera.

At half its rate a colour camera may be late even with new images: it exposes for longer and hands on what it had
before. Then the depth that belongs to them came a frame earlier (seen on a D435).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..frame import RgbdFrame
from .instant import at_one_instant

Array = NDArray[np.float64]
Image = NDArray[np.float32]

STEP = 32  # px between the rows that are compared: whole ones, which are quicker to read than pixels here and there
LONGEST_S = 0.1  # s for which an image is taken for an earlier one; a view that rests longer is taken as it is


@dataclass(frozen=True)
class Seen:
    """Some rows of the last frame's images, and since when they have been shown."""

    gray: Image
    depth: Image
    timestamp: float  # s, of the frame
    gray_since: float  # s
    depth_since: float  # s
    slow: int = 0  # colour images in a row, up to the one before this, that were shown for longer than a frame
    whole_depth: Image | None = None  # m, the frame's depth, where the next frame may need it
    depth_before: Image | None = None  # m, that of the frame before, where the colour image may be as old

    @staticmethod
    def after(before: Seen | None, rgbd: RgbdFrame) -> Seen:
        """Of a frame that comes after the one before."""
        now = rgbd.timestamp
        gray, depth = (np.array(image.detach().numpy()[::STEP]) for image in (rgbd.gray, rgbd.depth))
        if before is None:
            return Seen(gray, depth, now, now, now)
        repeats_gray, repeats_depth = same(gray, before.gray), same(depth, before.depth)
        long = before.gray_since < before.timestamp
        slow = before.slow if repeats_gray else before.slow + 1 if long else 0
        return Seen(
            gray, depth, now,
            before.gray_since if repeats_gray else now,
            before.depth_since if repeats_depth else now,
            slow,
            np.array(rgbd.depth.detach().numpy()) if slow or (repeats_gray and not repeats_depth) else None,
            before.whole_depth if slow or before.slow else None,
        )  # fmt: skip

    @property
    def late_color(self) -> bool:
        """Whether the colour image is older than the depth."""
        return self.gray_since < self.depth_since and self.timestamp - self.gray_since < LONGEST_S

    @property
    def late_depth(self) -> float:
        """How much older than the colour image the depth is, s."""
        return self.gray_since - self.depth_since if self.timestamp - self.depth_since < LONGEST_S else 0.0

    @property
    def late(self) -> bool:
        """Whether both are those of the frame before."""
        return self.gray_since == self.depth_since < self.timestamp < self.gray_since + LONGEST_S


def same(a: Image, b: Image) -> bool:
    """Whether two images are one, which is not a black or white one that says nothing."""
    return bool(np.array_equal(a, b) and a.min(initial=np.inf) < a.max(initial=-np.inf))


def with_late_depth(rgbd: RgbdFrame, delay: float, velocity: Array) -> RgbdFrame:
    """The frame with its depth, so many seconds too old, brought to its time; velocity as in at_one_instant."""
    if delay <= 0.0 or not velocity.any():
        return rgbd
    late = replace(rgbd, camera=replace(rgbd.camera, depth_delay_ms=-1e3 * delay, readout_ms=0.0))
    return replace(at_one_instant(late, velocity), camera=rgbd.camera)
