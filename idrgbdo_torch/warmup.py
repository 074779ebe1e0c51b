"""Compiles the kernels before the first frame, with a notice, instead of during the first frames, without one."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator

import cv2
import numpy as np
import torch
from numba.core.event import Event, Listener, install_listener

from .camera import Pinhole
from .frame import RgbdFrame
from .kernels.alignment import align
from .odometry import Odometry

NOTICE = "compiling the kernels, some 15 s, once; they are kept for later processes"
FRAMES = 12
STEP = 6  # px that the image moves from frame to frame
DEPTH_M = 1.5

log = logging.getLogger("idrgbdo_torch")


def warm_up(make: Callable[[], Odometry]) -> None:
    """Compile every kernel, or load it from the cache, unless this process has done so.

    make: the odometry whose kernels they are; it tracks some tiny frames. Where something has to be compiled, a
    warning is logged, which Python shows on stderr unless told otherwise. Loading takes some 0.3 s.
    """
    if align.signatures:
        return
    odometry = make()
    with install_listener("numba:compile", Notice()):
        for frame in tiny_film():
            odometry.track(frame)


class Notice(Listener):  # type: ignore[misc]  # numba has no types
    """Logs once that kernels are compiled."""

    def __init__(self) -> None:
        self._said = False

    def on_start(self, event: Event) -> None:
        """A function that is not in the cache."""
        if not self._said:
            self._said = True
            log.warning(NOTICE)

    def on_end(self, event: Event) -> None:
        """It is compiled."""


def tiny_film() -> Iterator[RgbdFrame]:
    """A textured wall seen by a camera that moves along it: enough for keyframes and a window."""
    camera = Pinhole(width=160, height=120, fx=140.0, fy=140.0, cx=79.5, cy=59.5)
    wide = camera.width + FRAMES * STEP
    noise = np.random.default_rng(0).uniform(0, 255, (camera.height, wide)).astype(np.float32)
    wall = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 2.0), None, 0.0, 255.0, cv2.NORM_MINMAX)
    depth = torch.full((camera.height, camera.width), DEPTH_M)
    for number in range(FRAMES):
        left = number * STEP
        gray = np.ascontiguousarray(wall[:, left : left + camera.width])
        yield RgbdFrame(number / 30.0, torch.from_numpy(gray), depth, camera)
