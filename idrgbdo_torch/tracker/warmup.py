"""Has the kernels compiled before the first frame, with a notice, instead of during the first frames, without one.

Processes of their own compile them, and this one then loads what those have kept: a process that compiled a kernel
itself links it otherwise than one that loads it, and sums then differ in the last bit. So the first run after an
installation gives the same bits as every later one.
"""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from itertools import islice
from threading import get_ident

import cv2
import numpy as np
import torch
from numba.core.event import Event, Listener, install_listener

from ..config import Config, KeyframeConfig, SelectionConfig, WindowConfig
from ..definitions.camera import Pinhole
from ..frame import Keyframe, RgbdFrame, prepare
from ..kernels.matching import mutual_matches
from ..kernels.surface import align_surface, surface_planes
from ..kernels.tracking import align
from ..measurement import LEVELS, PIXELS, Points, tracked_noise
from ..odometry import Odometry
from .backends import backend_named
from .features import RATIO, WORDS, poses_of_triangles
from .surface import GATES, HELD, RADIUS
from .window import Window

NOTICE = "compiling the kernels, about a minute, once; they are kept for later processes"
FRAMES = 12
STEP = 6  # px that the image moves from frame to frame
DEPTH_M = 1.5
EAGER = KeyframeConfig(threshold_bits=1e-3)  # so that the window is full after some frames, and keyframes leave it
ALONE = Config(keyframe=EAGER, window=WindowConfig(enabled=False))  # needs nothing that only the window does
CONFIGS = (  # which together use every kernel that any configuration does
    Config(keyframe=EAGER, window=WindowConfig(keyframes=3)),
    Config(keyframe=EAGER, window=WindowConfig(keyframes=3, removal="information"), selection=SelectionConfig("rand")),
)
ALL = """
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo
from idrgbdo_torch.tracker.warmup import compile_all
compile_all(lambda config: IdRgbdo(config, compile_ahead=False))
"""
WINDOW = "from idrgbdo_torch.tracker.warmup import compile_window; compile_window()"

log = logging.getLogger("idrgbdo_torch")
Make = Callable[[Config], Odometry]


class Missing(Exception):
    """A kernel is not in the cache."""


def warm_up(make: Make, on_function: Callable[[], None] | None = None) -> None:
    """Load every kernel from the cache, where it is compiled into if it is not there, unless this process has done so.

    make: an odometry of a configuration; each tracks some tiny frames. Where something has to be compiled,
    on_function is called for every function of the kernels; without it a warning is logged, which Python shows on
    stderr unless told otherwise. Loading takes some 0.3 s.
    """
    if align.signatures:
        return
    missing = ""
    while (found := first_missing(make)) not in ("", missing):
        if not missing and on_function is None:
            log.warning(NOTICE)
        missing = found
        if (process := python(ALL)) is not None and process.stdout is not None:
            for _ in process.stdout:
                if on_function is not None:
                    on_function()
            process.wait()
    if found:  # they cannot be kept, or no process can be started: this one compiles
        with install_listener("numba:compile", Telling(on_function)):
            track_films(make)


def first_missing(make: Make) -> str:
    """The first kernel that is not in the cache; empty where all are, and are loaded now."""
    try:
        with install_listener("numba:compile", Refusal()):
            track_films(make)
    except Missing as missing:
        return str(missing)
    return ""


def compile_all(make: Make) -> None:
    """Compile what is not in the cache, with the help of a second process, which takes what only the window needs.

    numba compiles one function at a time in a process; the window's take half of the time.
    """
    other = python(WINDOW) if (os.cpu_count() or 1) > 1 else None

    def tell() -> None:
        sys.stdout.write("\n")  # the process that waits reads lines
        sys.stdout.flush()

    with install_listener("numba:compile", Telling(tell)):
        track_film(make(ALONE))
        remove_nothing()
        if other is not None:
            other.wait()  # it writes nothing that could fill the pipe
        track_films(make)  # if the other failed, its share is compiled here after all


def track_films(make: Make) -> None:
    """Track the tiny film with every configuration."""
    for config in CONFIGS:
        track_film(make(config))
    match_nothing()


def track_film(odometry: Odometry) -> None:
    """Track the tiny film."""
    for frame in tiny_film():
        odometry.track(frame)


def match_nothing() -> None:
    """Call what only lost frames need."""
    mutual_matches(np.zeros((1, WORDS), np.uint64), np.zeros((1, WORDS), np.uint64), RATIO)
    poses_of_triangles(np.zeros((3, 3)), np.ones((3, 3)))
    depth, camera = np.zeros((8, 8), np.float32), np.ones(4)
    planes = surface_planes(depth, camera, RADIUS, RADIUS, 1.0)
    align_surface(depth, camera, planes, np.eye(4), HELD, 1.0, GATES)


def remove_nothing() -> None:
    """Call what only keyframes that leave a window need."""
    backend, nothing = backend_named(Config().backend), np.zeros(12)
    backend.marginalize(np.eye(12), nothing, nothing > 0)
    backend.redundancy(np.eye(12))


def compile_window() -> None:
    """Compile what only the window needs, and some of what is called late, so that both processes have their share."""
    config = Config()
    window = Window(config, tracked_noise(config), backend_named(config.backend))
    none, no_index = np.zeros(0), np.zeros(0, np.int64)
    for frame in islice(tiny_film(), 2):
        patch = np.zeros((LEVELS, 0, PIXELS), np.float32)
        points = Points(np.zeros((0, 2)), none, none, patch, np.zeros((*patch.shape, 2), np.float32), np.zeros((0, 2)))
        keyframe = Keyframe(prepare(frame), points, none, none, none, no_index, no_index)
        window.add(keyframe, np.eye(4), np.zeros(2), no_index)
    window.optimise()
    window.backend.next_view_bits(np.eye(12), np.stack([np.eye(6)] * 2), np.stack([np.eye(6)] * 2))
    match_nothing()


def python(script: str) -> subprocess.Popen[bytes] | None:
    """A process that runs a script with this one's modules; None where there can be none."""
    if getattr(sys, "frozen", False) or not sys.executable:  # what could be started is another program
        return None
    script = f"import sys; sys.path[:] = {sys.path!r}\n{script}"
    nowhere = subprocess.DEVNULL
    try:
        return subprocess.Popen([sys.executable, "-c", script], stdin=nowhere, stdout=subprocess.PIPE, stderr=nowhere)
    except OSError:
        return None


class Telling(Listener):  # type: ignore[misc]  # numba has no types
    """Calls for every function that is compiled, where there is something to call."""

    def __init__(self, on_function: Callable[[], None] | None) -> None:
        self._on_function = on_function

    def on_start(self, event: Event) -> None:
        """A function that is not in the cache."""
        if self._on_function is not None:
            self._on_function()

    def on_end(self, event: Event) -> None:
        """It is compiled."""


class Refusal(Listener):  # type: ignore[misc]  # numba has no types
    """Raises Missing where the thread that made it is about to compile a function."""

    def __init__(self) -> None:
        self._thread = get_ident()

    def on_start(self, event: Event) -> None:
        """A function that is not in the cache."""
        if get_ident() == self._thread:
            raise Missing(str(event.data["dispatcher"]))

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
