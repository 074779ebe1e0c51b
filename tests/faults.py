"""A film with a fault put in, as a sequence that can be checked."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch

from idrgbdo_torch.definitions.camera import Pinhole
from idrgbdo_torch.frame import BrokenFrame, RgbdFrame
from idrgbdo_torch.trajectory import Trajectory

Frames = list[RgbdFrame]


@dataclass
class Recording:
    """Frames in memory, with what a recorded sequence offers."""

    frames: Frames
    groundtruth: Trajectory | None = None
    name: str = "film"

    def __post_init__(self) -> None:
        self.timestamps = [frame.timestamp for frame in self.frames]
        self.camera: Pinhole = self.frames[0].camera
        self.warnings: list[str] = []
        self.recognised = "frames in memory"

    def __len__(self) -> int:
        return len(self.frames)

    def __iter__(self) -> Iterator[RgbdFrame | BrokenFrame]:
        return iter(self.frames)

    def read(self, index: int) -> RgbdFrame | BrokenFrame:
        return self.frames[index]


def scaled_depth(factor: float) -> Callable[[Frames], Frames]:
    return lambda frames: [replace(frame, depth=frame.depth * factor) for frame in frames]


def moved_depth(right: int, down: int) -> Callable[[Frames], Frames]:
    """Depth moved by whole pixels; what comes in is unknown."""

    def move(frame: RgbdFrame) -> RgbdFrame:
        depth = torch.roll(frame.depth, (down, right), (0, 1))
        depth[: max(down, 0)] = 0
        depth[:, : max(right, 0)] = 0
        if down < 0:
            depth[down:] = 0
        if right < 0:
            depth[:, right:] = 0
        return replace(frame, depth=depth)

    return lambda frames: [move(frame) for frame in frames]


def dropped(share: float) -> Callable[[Frames], Frames]:
    """A share of the frames missing, at random places."""

    def drop(frames: Frames) -> Frames:
        kept = np.random.default_rng(3).choice(len(frames), round(len(frames) * (1 - share)), replace=False)
        return [frames[index] for index in sorted(kept)]

    return drop


def other_camera(focal: float, center: float = 1.0) -> Callable[[Frames], Frames]:
    """Wrong intrinsics: fx and fy, and cx and cy, times a factor."""

    def change(frame: RgbdFrame) -> RgbdFrame:
        c = frame.camera
        camera = replace(c, fx=c.fx * focal, fy=c.fy * focal, cx=c.cx * center, cy=c.cy * center)
        return replace(frame, camera=camera)

    return lambda frames: [change(frame) for frame in frames]


def late_depth(count: int) -> Callable[[Frames], Frames]:
    """The depth of every frame is that of `count` frames before (after, where negative)."""

    def shift(frames: Frames) -> Frames:
        span = range(max(count, 0), len(frames) + min(count, 0))
        return [replace(frames[index], depth=frames[index - count].depth) for index in span]

    return shift


def cut_to(others: Frames, at: int) -> Callable[[Frames], Frames]:
    """From a frame on, the images of another scene."""
    return lambda frames: (
        frames[:at]
        + [replace(other, timestamp=frame.timestamp) for frame, other in zip(frames[at:], others[at:], strict=True)]
    )


def seen_by(wider: Frames) -> Callable[[Frames], Frames]:
    """Depth as another camera at the same place sees it, taken for colour's."""
    return lambda frames: [replace(frame, depth=wide.depth) for frame, wide in zip(frames, wider, strict=True)]


def covered(share: float, step: int) -> Callable[[Frames], Frames]:
    """A faintly textured board 0.8 m away before the left share of the view, that moves by `step` px a frame."""

    def cover(frames: Frames) -> Frames:
        height, width = frames[0].gray.shape
        noise = np.random.default_rng(5).uniform(115, 140, (height // 8, 2 * width // 8)).astype(np.float32)
        board = np.kron(noise, np.ones((8, 8), np.float32))
        part, out = round(share * width), []
        for number, frame in enumerate(frames):
            gray, depth = frame.gray.clone(), frame.depth.clone()
            gray[:, :part] = torch.from_numpy(np.roll(board, step * number, axis=1)[:height, :part].copy())
            depth[:, :part] = 0.8
            out.append(replace(frame, gray=gray, depth=depth, color=None))
        return out

    return cover
