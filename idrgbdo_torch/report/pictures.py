"""Pictures of a run, drawn with OpenCV: the chosen points over a frame, and the trajectory from above."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from ..errors import IdRgbdoError
from ..frame import BrokenFrame, RgbdFrame
from ..odometry import Record
from ..tracker.inspection import Inspectable

Picture = NDArray[np.uint8]  # (H, W, 3) RGB
Color = tuple[int, int, int]

EVERY = 50  # frames between two pictures
FIRST_KEYFRAMES = 3  # that get a picture too
SIDE = 640  # px, least width of a picture
BAR = 86  # px, width of the colour scale
CAPTION = 26  # px, height of the line above
SHIFT = 4  # bits of a pixel's fraction in OpenCV's drawing
WHITE, INK, GRAY, PALE = (255, 255, 255), (30, 30, 30), (190, 190, 190), (228, 228, 228)
BLUE, RED = (31, 98, 201), (205, 48, 48)


def draw_frames(
    frames: Iterable[RgbdFrame | BrokenFrame], odometry: object, records: Sequence[Record], folder: Path
) -> Iterator[RgbdFrame | BrokenFrame]:
    """The frames, unchanged; the first keyframes and every 50th frame leave folder/frame_000050.png.

    records: grows by one with every frame that was tracked. A picture is drawn when the next frame is asked for, which
    is outside the clock of track().
    """
    keyframes = sum(record.result.keyframe for record in records)
    for number, frame in enumerate(frames, start=len(records)):
        yield frame
        result = records[-1].result
        keyframes += result.keyframe
        wanted = number % EVERY == 0 or (result.keyframe and keyframes <= FIRST_KEYFRAMES)
        if wanted and isinstance(frame, RgbdFrame) and isinstance(odometry, Inspectable):
            uv, bits = odometry.last_points()
            what = f"keyframe {keyframes}" if result.keyframe else result.status.value
            candidates = odometry.last_candidates()
            count = f"{len(uv)} points of {len(candidates)}" if len(uv) else str(len(candidates))
            caption = f"frame {number}, {what}: {count} candidates"
            save(folder / f"frame_{number:06}.png", draw_points(frame, uv, bits, candidates, caption))


def draw_points(
    frame: RgbdFrame, uv: Tensor, bits: Tensor, candidates: Tensor | None = None, caption: str = "",
    most: float | None = None,
) -> Picture:  # fmt: skip
    """A frame with its chosen points, uv (N, 2) px, coloured by what each is worth, bits (N,); candidates (M, 2) small.

    The image is darkened under the points; a scale tells the colours, a caption stands above. most: the bits of the
    brightest colour, else the largest there are.
    """
    base = frame.gray[..., None].expand(-1, -1, 3) if frame.color is None else frame.color.float()
    zoom = max(1, round(SIDE / frame.camera.width))
    image = (0.75 * base.clamp(0, 255)).numpy().astype(np.uint8)
    image = cv2.resize(image, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_NEAREST)
    small = np.zeros((0, 2)) if candidates is None else candidates.numpy()
    for place in (small + 0.5) * zoom - 0.5:
        _disc(image, place, 1.5, WHITE)
    if most is None:
        most = max(float(bits.max()), 1e-9) if len(bits) else 1.0
    colors = information_colors(bits.numpy() / most)
    for number in np.argsort(bits.numpy()):  # the best on top
        place = (uv[number].numpy() + 0.5) * zoom - 0.5
        _disc(image, place, 7.5, (0, 0, 0))
        _disc(image, place, 6.0, colors[number])
    picture = _blank(image.shape[0] + CAPTION, image.shape[1] + BAR)
    picture[CAPTION:, : image.shape[1]] = image
    _write(picture, caption, (8, CAPTION - 8))
    if len(bits):
        _scale(picture[CAPTION:, image.shape[1] :], most)
    return picture


def draw_trajectory(
    T_world_cam: Tensor,
    keyframes: Sequence[int] = (),
    lost: Sequence[int] = (),
    reference: Tensor | None = None,
    size: int = SIDE,
) -> Picture:
    """The camera's path from above, T_world_cam (N, 4, 4): blue, with keyframes as dots and lost frames in red.

    reference: (M, 3) positions in the same world, drawn in gray. keyframes, lost: numbers of poses.
    """
    R = from_above(T_world_cam)
    path = (T_world_cam[:, :3, 3] @ R.T).numpy()[:, :2]
    gray = np.zeros((0, 2)) if reference is None else (reference @ R.T).numpy()[:, :2]
    drawn = np.concatenate([path, gray])
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    side = max(float((high - low).max()), 1e-3) * 1.15
    px_per_m = size / side
    top = 2 * CAPTION
    height = round(min(max(1.3 * px_per_m * (high - low)[1], 0.5 * size), size))
    corner = 0.5 * (low + high) + 0.5 * np.array([-size, height]) / px_per_m  # top left

    def place(points: NDArray[Any]) -> NDArray[np.float64]:
        pixels: NDArray[np.float64] = (points - corner) * np.array([px_per_m, -px_per_m]) + np.array([0.0, top])
        return pixels

    picture = _blank(height + top, size)
    step = _round_step(side / 5)
    for line in range(-1, 8):
        tick = (np.floor(corner / step) + np.array([line, -line])) * step
        u, v = place(tick).round().astype(int)
        cv2.line(picture, (int(u), top), (int(u), height + top), PALE, 1)
        cv2.line(picture, (0, max(int(v), top)), (size, max(int(v), top)), PALE, 1)
    _polyline(picture, place(gray), GRAY, 6)
    _polyline(picture, place(path), BLUE, 2)
    for number in keyframes:
        _disc(picture, place(path[number]), 3.2, BLUE)
    for number in lost:
        _disc(picture, place(path[number]), 3.2, RED)
    _disc(picture, place(path[0]), 6.0, INK)
    _disc(picture, place(path[0]), 4.0, WHITE)
    _write(picture, f"from above, a square is {step:g} m, the ring is the start", (8, CAPTION - 8))
    legend = [("estimate", BLUE, 2)]
    legend += [(f"{len(keyframes)} keyframes", BLUE, 0)] if keyframes else []
    legend += [("reference", GRAY, 6)] if reference is not None else []
    legend += [(f"{len(lost)} lost", RED, 0)] if lost else []
    for column, (name, color, width) in enumerate(legend):
        u, v = 10 + size * column // 4, CAPTION + 14
        if width:
            cv2.line(picture, (u, v - 4), (u + 20, v - 4), color, width, cv2.LINE_AA)
        else:
            _disc(picture, (u + 14, v - 4), 3.2, color)
        _write(picture, name, (u + 28, v))
    return picture


def from_above(T_world_cam: Tensor) -> Tensor:
    """(3, 3) rotation of the world to axes right, ahead, up of a person behind the camera, from poses (N, 4, 4).

    A camera held level turns and nods, but does not roll: up is where its right axis never points. Where it does not
    turn, that leaves a choice, and the mean up axis of the image decides.
    """
    right, up = T_world_cam[:, :3, 0], -T_world_cam[:, :3, 1].mean(dim=0)
    spread = right.mT @ right / len(right) - 0.01 * up[:, None] * up
    z = np.linalg.eigh(spread.numpy())[1][:, 0]
    z = z if z @ up.numpy() > 0 else -z
    x = right.mean(dim=0).numpy()
    x = x - (x @ z) * z
    length = np.linalg.norm(x)
    x = x / length if length > 1e-6 else np.linalg.svd(z[None])[2][1]  # a full turn has no mean right
    R: Tensor = T_world_cam.new_tensor(np.stack([x, np.cross(z, x), z]))
    return R


def save(path: Path, picture: Picture) -> None:
    """Write a picture as PNG, making its folder. Raises IdRgbdoError where that fails."""
    _, data = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data.tobytes())
    except OSError as error:
        raise IdRgbdoError(f"out: cannot write '{path}': {error.strerror}; pass another --out") from error


def _blank(height: int, width: int) -> Picture:
    return np.full((height, width, 3), 255, dtype=np.uint8)


def information_colors(share: NDArray[Any]) -> list[Color]:
    """What a point is worth as a colour: dark blue over green to yellow for shares (N,) from 0 to 1."""
    levels = (255 * np.clip(share, 0, 1)).round().astype(np.uint8).reshape(-1, 1)
    if len(levels) == 0:
        return []
    bgr = cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS)[:, 0]
    return [(int(r), int(g), int(b)) for b, g, r in bgr]


def _disc(image: Picture, where: Sequence[float] | NDArray[Any], radius: float, color: Color) -> None:
    one = 1 << SHIFT
    centre = (round(where[0] * one), round(where[1] * one))
    cv2.circle(image, centre, round(radius * one), color, cv2.FILLED, cv2.LINE_AA, shift=SHIFT)


def _polyline(image: Picture, points: NDArray[Any], color: Color, width: int) -> None:
    if len(points) > 1:
        fixed = (points * (1 << SHIFT)).round().astype(np.int32)
        cv2.polylines(image, [fixed], False, color, width, cv2.LINE_AA, SHIFT)


def _write(image: Picture, text: str, where: tuple[int, int]) -> None:
    cv2.putText(image, text, where, cv2.FONT_HERSHEY_SIMPLEX, 0.46, INK, 1, cv2.LINE_AA)


def _scale(area: Picture, most: float) -> None:
    """A bar of the colours with bits beside it."""
    top, bottom = 40, min(area.shape[0] - 20, 300)
    for v, color in zip(range(bottom, top, -1), information_colors(np.linspace(0, 1, bottom - top)), strict=True):
        area[v, 12:28] = color
    _write(area, "bits", (12, 24))
    for share in (0.0, 0.5, 1.0):
        _write(area, f"{share * most:.2f}", (36, round(bottom - share * (bottom - top)) + 5))


def _round_step(length: float) -> float:
    """The nearest of 1, 2 and 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(min((power, 2 * power, 5 * power, 10 * power), key=lambda step: abs(step - length)))
