"""Compiles the kernels before the first frame, with a notice, instead of during the first frames, without one."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from itertools import islice

import cv2
import numpy as np
import torch
from numba.core.event import Event, Listener, install_listener

from ..config import Config
from ..definitions.camera import Pinhole
from ..frame import Keyframe, RgbdFrame, prepare
from ..kernels.tracking import align
from ..measurement import LEVELS, PATTERN_U, Points, kernel_noise
from ..odometry import Odometry
from .backends import backend_named
from .window import Window

NOTICE = "compiling the kernels, some 15 s, once; they are kept for later processes"
FRAMES = 12
STEP = 6  # px that the image moves from frame to frame
DEPTH_M = 1.5

log = logging.getLogger("idrgbdo_torch")


def warm_up(make: Callable[[], Odometry], on_function: Callable[[], None] | None = None) -> None:
    """Compile every kernel, or load it from the cache, unless this process has done so.

    make: the odometry whose kernels they are; it tracks some tiny frames. Where something has to be compiled,
    on_function is called for every function of the kernels; without it a warning is logged, which Python shows on
    stderr unless told otherwise. Loading takes some 0.3 s.
    """
    if align.signatures:
        return
    odometry = make()
    notice = Notice(on_function)
    with install_listener("numba:compile", notice):
        for number, frame in enumerate(tiny_film()):
            if number == 2:  # about to need the window
                notice.wait()
            odometry.track(frame)


def compile_window() -> None:
    """Compile what only the window needs; for a second process, beside the one that compiles the rest."""
    config = Config()
    window = Window(config, kernel_noise(config.noise, config.tracking.patch), backend_named(config.backend))
    none, no_index = np.zeros(0), np.zeros(0, np.int64)
    for frame in islice(tiny_film(), 2):
        patch = np.zeros((LEVELS, 0, len(PATTERN_U)), np.float32)
        points = Points(np.zeros((0, 2)), none, none, patch, np.zeros((*patch.shape, 2), np.float32), np.zeros((0, 2)))
        keyframe = Keyframe(prepare(frame), points, none, none, none, no_index, no_index)
        window.add(keyframe, np.eye(4), np.zeros(2), no_index)
    window.optimise()


class Notice(Listener):  # type: ignore[misc]  # numba has no types
    """Says once that kernels are compiled, and has the window's compiled by a second process meanwhile.

    numba compiles one function at a time in a process; the window's take a third of the time.
    """

    def __init__(self, on_function: Callable[[], None] | None = None) -> None:
        self._on_function = on_function
        self._said = False
        self._other: subprocess.Popen[bytes] | None = None

    def on_start(self, event: Event) -> None:
        """A function that is not in the cache."""
        if self._on_function is not None:
            self._on_function()
        if self._said:
            return
        self._said = True
        if self._on_function is None:
            log.warning(NOTICE)
        if (os.cpu_count() or 1) > 1:
            script = "from idrgbdo_torch.tracker.warmup import compile_window; compile_window()"
            # if it fails, its share is compiled here after all
            self._other = subprocess.Popen(
                [sys.executable, "-c", script],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )

    def on_end(self, event: Event) -> None:
        """It is compiled."""

    def wait(self) -> None:
        """Until the second process is done."""
        if self._other is not None:
            self._other.wait()


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
