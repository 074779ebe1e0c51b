"""Windows over keyframes of the rendered desk whose poses are exactly known, moved by errors of a given size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from rendered import Film, rotation_deg
from torch import Tensor

from idrgbdo_torch.config import Config, WindowConfig
from idrgbdo_torch.definitions import se3
from idrgbdo_torch.frame import Keyframe, prepare
from idrgbdo_torch.measurement import tracked_noise
from idrgbdo_torch.tracker.backends import backend_named
from idrgbdo_torch.tracker.keyframe import make_keyframe
from idrgbdo_torch.tracker.selection import select_points
from idrgbdo_torch.tracker.tracking import motion_information
from idrgbdo_torch.tracker.window import Window

FRAMES = (0, 4, 8, 12, 16, 20, 24)
FUSED = backend_named("fused")
CONFIG = replace(Config(), window=WindowConfig(keyframes=5))
NOISE = tracked_noise(CONFIG)
PRIOR = motion_information(CONFIG, 1 / 30)
NO_CHANGE = np.zeros(2)
MM = 1e-3
DEGREE = np.pi / 180


def twists(count: int, translation: float, rotation: float, seed: int = 0) -> Tensor:
    """Left increments (count, 6) of these sizes, the first one zero."""
    xi = torch.randn(count, 2, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    xi = torch.nn.functional.normalize(xi, dim=-1) * torch.tensor([[translation], [rotation]], dtype=torch.float64)
    xi[0] = 0.0
    return xi.reshape(count, 6)


@dataclass(frozen=True)
class Desk:
    """The keyframes, made once, and the truth."""

    film: Film
    keyframes: Sequence[Keyframe]

    def window(
        self, count: int = 5, off_m: float = 0.0, off_rad: float = 0.0, seed: int = 0, config: Config = CONFIG
    ) -> Window:
        """A window of the first keyframes at their true poses, world = first camera, moved by errors of this size."""
        window = Window(config, NOISE, FUSED)
        for k, xi in enumerate(twists(count, off_m, off_rad, seed)):
            self.add(window, k, xi)
        return window

    def add(self, window: Window, k: int, xi: Tensor | None = None) -> None:
        """Append keyframe k at its true pose, moved by a left increment."""
        m = window.config.window_points
        rng = np.random.default_rng(0)
        index = select_points(self.keyframes[k], np.eye(4), m, PRIOR, CONFIG.selection, NOISE, rng, FUSED)
        T = self.film.T(FRAMES[k], 0)
        window.add(self.keyframes[k], (T if xi is None else se3.retract(xi, T)).numpy(), NO_CHANGE, index)

    def errors(self, window: Window) -> tuple[np.ndarray, np.ndarray]:
        """Metres and degrees by which the keyframes are off, each against the first of all."""
        start = self.film.frames[0].timestamp
        E = []
        for keyframe, T in zip(window.members.keyframes, window.members.T, strict=True):
            frame = round((keyframe.frame.timestamp - start) * 30)
            E.append(se3.inverse(self.film.T(frame, 0)) @ torch.from_numpy(T))
        return np.array([float(e[:3, 3].norm()) for e in E]), np.array([rotation_deg(e) for e in E])


def make_desk(film: Film) -> Desk:
    return Desk(film, [make_keyframe(prepare(film.frames[k]), CONFIG, np.random.default_rng(0), FUSED) for k in FRAMES])
