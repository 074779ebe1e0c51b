"""A film of a run: every tracked frame with its points, coloured by what each is worth in bits; mp4 or gif."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import cv2
import numpy as np

from ..errors import IdRgbdoError
from ..frame import BrokenFrame, RgbdFrame
from ..odometry import Status, TrackResult
from ..tracker.id_rgbdo import IdRgbdo
from .pictures import Picture, draw_points

FORMATS = (".mp4", ".gif")
FADE = (
    0.98  # a frame: the scale of the colours follows the largest worth down no faster, so that colours do not flicker
)
GIF_FRAMES = 300  # at most; a gif stays in memory until it is written
GIF_WIDTH = 480  # px, unless told
BORDER = 6  # px, red around a lost frame, yellow around a weak one
BORDERS = {Status.WEAK: (235, 180, 30), Status.LOST: (205, 48, 48)}


def pictures(
    frames: Iterable[RgbdFrame | BrokenFrame], odometry: IdRgbdo, on_frame: Callable[[TrackResult], None] | None = None
) -> Iterator[Picture]:
    """Track the frames and draw each that could be read."""
    most, begin = 0.0, None
    for number, frame in enumerate(frames):
        if isinstance(frame, BrokenFrame):
            continue
        begin = frame.timestamp if begin is None else begin
        result = odometry.track(frame)
        if on_frame is not None:
            on_frame(result)
        uv, bits = odometry.last_points()
        most = max(FADE * most, float(bits.max()) if len(bits) else 0.0, 1e-9)
        what = f"{len(uv)} points" + (", keyframe" if result.keyframe else "")
        what += "" if result.status is Status.OK else f", {result.status.value}: {result.reason}"
        caption = f"frame {number}, {frame.timestamp - begin:.2f} s, {what}"
        picture = draw_points(frame, uv, bits, odometry.last_candidates(), caption, most)
        color = BORDERS.get(result.status)
        if color is not None:
            height, width = picture.shape[:2]
            cv2.rectangle(picture, (0, 0), (width - 1, height - 1), color, BORDER)
        yield picture


def write_video(path: Path, frames: Iterable[Picture], fps: float, width: int | None = None) -> int:
    """Write pictures (H, W, 3) RGB of one size as .mp4 or .gif, `width` px wide; returns how many.

    The file appears when it is complete. A gif takes at most GIF_FRAMES, evenly left out, at the same speed.
    """
    if path.suffix.lower() not in FORMATS:
        raise IdRgbdoError(f"out: expected a name ending in {' or '.join(FORMATS)}, got '{path}'; choose one of them")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise IdRgbdoError(f"out: cannot make '{path.parent}': {error.strerror}; choose another file") from error
    draft = path.with_name(f".{path.stem}{path.suffix.lower()}")
    try:
        count = (
            _write_gif(draft, frames, fps, width) if draft.suffix == ".gif" else _write_mp4(draft, frames, fps, width)
        )
        if count:
            draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)
    return count


def _write_mp4(path: Path, frames: Iterable[Picture], fps: float, width: int | None) -> int:
    writer: cv2.VideoWriter | None = None
    count = 0
    try:
        for picture in frames:
            image = _resized(picture, width)
            if writer is None:
                size = (image.shape[1], image.shape[0])
                writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), fps, size)
                if not writer.isOpened():
                    raise IdRgbdoError(f"out: OpenCV cannot write '{path}' as mp4; check the folder, or write a .gif")
            writer.write(np.ascontiguousarray(image[..., ::-1]))
            count += 1
    finally:
        if writer is not None:
            writer.release()
    return count


def _write_gif(path: Path, frames: Iterable[Picture], fps: float, width: int | None) -> int:
    kept: list[Picture] = []
    step, count = 1, 0
    for picture in frames:
        if count % step == 0:
            kept.append(np.ascontiguousarray(_resized(picture, width or GIF_WIDTH)[..., ::-1]))
            if len(kept) > GIF_FRAMES:
                kept, step = kept[::2], 2 * step
        count += 1
    if not kept:
        return 0
    animation = cv2.Animation()
    animation.frames = kept
    animation.durations = [max(20, round(1000 * step / fps))] * len(kept)
    if not cv2.imwriteanimation(str(path), animation):
        raise IdRgbdoError(f"out: OpenCV cannot write '{path}' as gif; check the folder, or write an .mp4")
    return count


def _resized(picture: Picture, width: int | None) -> Picture:
    """The picture at this width, with an even number of rows and columns, which mp4 wants."""
    scale = 1.0 if width is None else width / picture.shape[1]
    size = [max(2, round(side * scale / 2) * 2) for side in (picture.shape[1], picture.shape[0])]
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
