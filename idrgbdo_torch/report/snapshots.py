"""Frames with the points that were tracked in them."""

from __future__ import annotations

import base64
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from torch import Tensor

from ..frame import BrokenFrame, RgbdFrame
from ..tracker.inspection import Inspectable

WIDTH = 480  # px of an embedded image


@dataclass(frozen=True)
class Snapshot:
    """A frame's image with points and their worth."""

    timestamp: float  # s
    image: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]  # (H, W, 3) RGB
    uv: Tensor  # (N, 2) px
    bits: Tensor  # (N,)


def watch(
    frames: Iterable[RgbdFrame | BrokenFrame], odometry: object, picks: Collection[int], into: list[Snapshot]
) -> Iterator[RgbdFrame | BrokenFrame]:
    """The frames, unchanged; after the picked ones (by number) were tracked, a snapshot goes into the list.

    It is made when the next frame is asked for, which is outside the clock of track().
    """
    for number, frame in enumerate(frames):
        yield frame
        if number in picks and isinstance(odometry, Inspectable) and isinstance(frame, RgbdFrame):
            gray = frame.gray.round().clamp(0, 255)[..., None].expand(-1, -1, 3)
            image = (gray if frame.color is None else frame.color).numpy().astype(np.uint8)
            into.append(Snapshot(frame.timestamp, image, *odometry.last_points()))


def snapshot_html(snapshot: Snapshot, begin: float) -> str:
    """The image as JPEG inside an SVG, each point a ring whose size grows with its worth."""
    height, width = snapshot.image.shape[:2]
    scale = min(1.0, WIDTH / width)
    small = cv2.resize(snapshot.image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", np.ascontiguousarray(small[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, 82])
    source = "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()
    most = max(float(snapshot.bits.max()), 1e-9) if len(snapshot.bits) else 1.0
    rings = "".join(
        f'<circle cx="{u:.1f}" cy="{v:.1f}" r="{4 + 7 * max(worth, 0.0) / most:.1f}">'
        f"<title>{worth:.2f} bits</title></circle>"
        for (u, v), worth in zip(snapshot.uv.tolist(), snapshot.bits.tolist(), strict=True)
    )
    caption = f"{snapshot.timestamp - begin:.2f} s, {len(snapshot.uv)} points"
    return (
        f'<figure><svg viewBox="0 0 {width} {height}" role="img"><image href="{source}" width="{width}" '
        f'height="{height}"/><g fill="none" stroke="#ff3df2" stroke-width="3">{rings}</g></svg>'
        f"<figcaption>{caption}</figcaption></figure>"
    )
