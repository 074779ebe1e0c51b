"""What tracking, selection and the window cost: cases to be timed, here and by the benchmarks."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..config import Config
from ..frame import Keyframe, RgbdFrame, prepare
from ..kernels.se3 import inverse, retract
from ..measurement import State, Subset, WindowPairs, tracked_noise
from ..synthetic import SynthConfig
from ..synthetic.sequence import RenderedSequence
from ..tracker.backends import backend_named
from ..tracker.keyframe import make_keyframe
from ..tracker.selection import select_points
from ..tracker.tracking import Pair, motion_information, track_frame
from ..tracker.window import Window

Array = NDArray[np.float64]
FUSED = backend_named("fused")
Case = Callable[[], Any]  # does the work once; called again it does the same

POINTS = (24, 48, 96, 192, 256, 500)
KEYFRAMES = (4, 6, 8, 10, 12)
WRONG = np.array([0.004, -0.003, 0.005, 0.003, -0.004, 0.002])  # m, rad: how far a predicted pose is off
STEP = 8  # frames between two keyframes of the window
DT = 1.0 / 30.0  # s


@dataclass(frozen=True)
class Scene:
    """Frames of a rendered desk, and where the camera truly was."""

    frames: tuple[RgbdFrame, ...]
    T_cam_world: Array  # (N, 4, 4)


def rendered_scene(numbers: Sequence[int], shrink: int = 1) -> Scene:
    """The frames of these numbers of a built-in hand-held sequence; `shrink` divides the image size, for tests."""
    config = SynthConfig(
        frames=max(numbers) + 1,
        width=640 // shrink,
        height=480 // shrink,
        fx=525.0 / shrink,
        fy=525.0 / shrink,
        cx=320.0 / shrink - 0.5,
        cy=240.0 / shrink - 0.5,
    )
    sequence = RenderedSequence(config)
    return Scene(
        tuple(sequence.read(number) for number in numbers),
        np.stack([inverse(sequence.T_world_cam[number]) for number in numbers]),
    )


def pair(shrink: int = 1) -> Scene:
    """A keyframe and a frame four later."""
    return rendered_scene((0, 4), shrink)


def window_scene(keyframes: int = KEYFRAMES[-1], shrink: int = 1) -> Scene:
    """As many keyframes as a window may have, at about their usual distance."""
    return rendered_scene(tuple(range(0, STEP * keyframes, STEP)), shrink)


def configured(points: int) -> Config:
    """The defaults with so many points, on the coarse levels and in the window too: what the paper counts."""
    config = Config()
    return replace(
        config,
        selection=replace(config.selection, points=points),
        tracking=replace(config.tracking, points_coarse=points),
        window=replace(config.window, points=points),
    )


def tracking_case(scene: Scene, points: int, *, select: bool = False, config: Config | None = None) -> Case:
    """Align the second frame to the first with so many points (on every level); with `select` also choose them.

    What a frame needs whatever the points, its pyramid above all, is done before. `config` stands for configured().
    """
    config = config or configured(points)
    noise = tracked_noise(config)
    keyframe, frame, T_guess = _keyframe(scene, config), prepare(scene.frames[1], config.tracking.blur), _guess(scene)
    prior = motion_information(config, DT)
    choose = selection_case(scene, points, config=config)
    index = choose()

    pair = Pair(frame, keyframe, noise, FUSED)
    start, coarse = State(T_guess, np.zeros(2)), Subset(keyframe.coarse, keyframe.points.patch.shape[2])

    def track() -> Any:
        return track_frame(pair, start, choose() if select else index, coarse, prior, config.tracking.levels)

    return track


def selection_case(scene: Scene, points: int, *, config: Config | None = None) -> Case:
    """Choose so many of the first frame's candidates for the second."""
    config = config or configured(points)
    noise = tracked_noise(config)
    keyframe, T_guess, prior = _keyframe(scene, config), _guess(scene), motion_information(config, DT)

    def choose() -> Any:
        rng = np.random.default_rng(0)
        return select_points(keyframe, T_guess, points, prior, config.selection, noise, rng, FUSED)

    return choose


def window_case(scene: Scene, points: int, keyframes: int) -> Case:
    """Optimise a window of so many keyframes with so many points each, from poses that are a little off."""
    config = configured(points)
    config = replace(config, window=replace(config.window, keyframes=keyframes))
    noise, rng = tracked_noise(config), np.random.default_rng(0)
    prior = motion_information(config, DT)
    window = Window(config, noise, FUSED)
    for number in range(keyframes):
        keyframe = make_keyframe(prepare(scene.frames[number], config.tracking.blur), config, rng, FUSED)
        index = select_points(keyframe, np.eye(4), points, prior, config.selection, noise, rng, FUSED)
        off = WRONG * rng.normal(size=6) if number else np.zeros(6)
        window.add(keyframe, retract(off, scene.T_cam_world[number]), np.zeros(2), index)
    start = window.members

    def optimise() -> Any:
        # with no pair taken, or nothing would be left to do
        window.members = start._replace(pairs=WindowPairs.empty(*start.inv_depth.shape))
        return window.optimise()

    return optimise


def median_ms(cases: Sequence[Case], repeats: int) -> list[float]:
    """The median time of a call of each case: processor time of this thread, which is all that the cases use.

    They take turns, so that whatever else the machine does hits all alike. The first two rounds do not count.
    """
    times: list[list[float]] = [[] for _ in cases]
    for number in range(repeats + 2):
        for case, own in zip(cases, times, strict=True):
            begin = time.thread_time_ns()
            case()
            if number >= 2:
                own.append((time.thread_time_ns() - begin) / 1e6)
    return [median(own) for own in times]


def _keyframe(scene: Scene, config: Config) -> Keyframe:
    return make_keyframe(prepare(scene.frames[0], config.tracking.blur), config, np.random.default_rng(0), FUSED)


def _guess(scene: Scene) -> Array:
    """T_frame_kf as a prediction would have it."""
    guess: Array = retract(WRONG, scene.T_cam_world[1] @ inverse(scene.T_cam_world[0]))
    return guess
