"""What goes wrong in front of a camera: frames as a covered lens, a shake, a passer-by or a poor sensor leave them.

Every function gives a new frame and leaves its own as it is. Colour is dropped: the tracker sees gray levels alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from ..frame import RgbdFrame

Image = NDArray[np.float32]

THING_M = 0.6  # m, how far a thing in front of everything is from the camera
BULGE = 0.05  # of that, by which its middle is nearer than its edges
THING_NOISE_M = 0.001  # m, of its depth
LENS_GRAY = 6.0  # gray levels of a covered lens,
LENS_NOISE = 2.0  # and their noise


def _seen(frame: RgbdFrame, gray: Image, depth: Image) -> RgbdFrame:
    levels = torch.from_numpy(np.ascontiguousarray(gray.clip(0.0, 255.0), np.float32))
    return replace(frame, gray=levels, depth=torch.from_numpy(np.ascontiguousarray(depth, np.float32)), color=None)


def black(frame: RgbdFrame) -> RgbdFrame:
    """Nothing at all."""
    return _seen(frame, np.zeros_like(frame.gray.numpy()), np.zeros_like(frame.depth.numpy()))


def covered(frame: RgbdFrame, rng: np.random.Generator) -> RgbdFrame:
    """A hand on the lens: dim and noisy, without depth."""
    noise = rng.normal(LENS_GRAY, LENS_NOISE, tuple(frame.gray.shape))
    return _seen(frame, noise.astype(np.float32), np.zeros_like(frame.depth.numpy()))


def smeared(frame: RgbdFrame, length_px: float, angle_rad: float) -> RgbdFrame:
    """Blurred along a direction, as by a shake; the depth, which knows no exposure, stays."""
    half = max(int(np.ceil(length_px / 2.0)), 1)
    steps = np.linspace(-length_px / 2.0, length_px / 2.0, 4 * half + 1)
    kernel = np.zeros((2 * half + 1, 2 * half + 1), np.float32)
    for s in steps:
        kernel[round(half + float(s * np.sin(angle_rad))), round(half + float(s * np.cos(angle_rad)))] += 1.0
    blurred = cv2.filter2D(frame.gray.numpy(), -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE)
    return _seen(frame, np.asarray(blurred, np.float32), frame.depth.numpy())


def exposed(frame: RgbdFrame, gain: float, offset: float = 0.0) -> RgbdFrame:
    """Brighter or darker by a gain and gray levels, clipped as a sensor clips."""
    return _seen(frame, np.float32(gain) * frame.gray.numpy() + np.float32(offset), frame.depth.numpy())


def flipped(frame: RgbdFrame, axes: tuple[int, ...]) -> RgbdFrame:
    """Upside down (0), mirrored (1) or both, depth too."""
    return _seen(frame, np.flip(frame.gray.numpy(), axes), np.flip(frame.depth.numpy(), axes))


def with_holes(frame: RgbdFrame, share: float, rng: np.random.Generator) -> RgbdFrame:
    """Without the depth of a share of all pixels, each by chance."""
    there = rng.random(tuple(frame.depth.shape)) >= share
    return _seen(frame, frame.gray.numpy(), frame.depth.numpy() * there)


@dataclass(frozen=True)
class Thing:
    """A textured surface that stands in front of everything."""

    gray: Image  # (h, w) gray levels
    depth: Image  # (h, w) m, 0 outside its outline

    def before(self, frame: RgbdFrame, left: int, top: int) -> RgbdFrame:
        """The frame with this thing at a place in px, which may lie outside the image in part."""
        gray, depth = frame.gray.numpy().copy(), frame.depth.numpy().copy()
        height, width = gray.shape
        h, w = self.gray.shape
        u0, u1, v0, v1 = max(left, 0), min(left + w, width), max(top, 0), min(top + h, height)
        if u0 < u1 and v0 < v1:
            own = slice(v0 - top, v1 - top), slice(u0 - left, u1 - left)
            solid = self.depth[own] > 0.0
            gray[v0:v1, u0:u1][solid] = self.gray[own][solid]
            depth[v0:v1, u0:u1][solid] = self.depth[own][solid]
        return _seen(frame, gray, depth)


def thing(width: int, height: int, seed: int) -> Thing:
    """A thing of so many px, rounded at its corners, with patterns of several sizes on it."""
    rng = np.random.default_rng(seed)
    gray = np.full((height, width), 128.0, np.float32)
    for size, contrast in ((3, 25.0), (8, 30.0), (30, 35.0)):
        rough = rng.normal(0.0, 1.0, (height // size + 2, width // size + 2)).astype(np.float32)
        gray += contrast * cv2.resize(rough, (width, height), interpolation=cv2.INTER_LINEAR)
    v, u = np.mgrid[-1.0 : 1.0 : height * 1j, -1.0 : 1.0 : width * 1j]
    outline = u**8 + v**8 <= 1.0
    depth = THING_M * (1.0 + BULGE * (0.5 * (u**2 + v**2) - 0.5)) + rng.normal(0.0, THING_NOISE_M, u.shape)
    return Thing(gray.clip(0.0, 255.0), (depth * outline).astype(np.float32))
