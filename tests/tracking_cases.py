"""A keyframe and a later frame of the rendered desk, and how tracking gets from one to the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from rendered import Film, rotation_deg
from torch import Tensor

from idrgbdo_torch.config import Config
from idrgbdo_torch.definitions import se3
from idrgbdo_torch.frame import Frame, Keyframe, prepare
from idrgbdo_torch.measurement import PIXELS, Noise, State, Subset, tracked_noise
from idrgbdo_torch.tracker.backends import Backend, backend_named
from idrgbdo_torch.tracker.keyframe import make_keyframe
from idrgbdo_torch.tracker.selection import select_points
from idrgbdo_torch.tracker.tracking import Pair, Tracked, motion_information, track_frame

CONFIG = Config()
FUSED, TORCH = backend_named("fused"), backend_named("torch")
NOISE = tracked_noise(CONFIG)
PRIOR = motion_information(CONFIG, 0.1)
EYE = np.eye(4)
NO_CHANGE = np.zeros(2)  # of brightness


@dataclass(frozen=True)
class Case:
    """A keyframe, a later frame, and how one moves to the other."""

    keyframe: Keyframe
    frame: Frame
    T: Tensor  # (4, 4) true T_frame_kf

    def choose(self, m: int) -> np.ndarray:
        return select_points(self.keyframe, EYE, m, PRIOR, CONFIG.selection, NOISE, np.random.default_rng(0), FUSED)

    def track(self, m: int = 24, guess: np.ndarray = EYE, prior: np.ndarray = PRIOR, frame: Frame | None = None,
              affine: np.ndarray = NO_CHANGE, noise: Noise = NOISE) -> Tracked:  # fmt: skip
        coarse = Subset(self.keyframe.coarse, PIXELS)
        return track_frame(
            self.pair(frame, noise), State(guess, affine), self.choose(m), coarse, prior, CONFIG.tracking.levels
        )

    def pair(self, frame: Frame | None = None, noise: Noise = NOISE, backend: Backend = FUSED) -> Pair:
        return Pair(frame or self.frame, self.keyframe, noise, backend)

    def error(self, tracked: Tracked) -> tuple[float, float]:
        """Translation in m and rotation in degrees between the estimate and the truth."""
        E = se3.inverse(self.T) @ torch.from_numpy(tracked.T_frame_kf)
        return float(E[:3, 3].norm()), rotation_deg(E)

    def twist(self, tracked: Tracked) -> Tensor:
        """(6,) left increment from the estimate to the truth."""
        return se3.log(self.T @ se3.inverse(torch.from_numpy(tracked.T_frame_kf)))


def make_cases(desk: Film) -> list[Case]:
    """Steps of 3 frames: 3 to 6 cm and 1 to 3 degrees."""
    out = []
    for k in (0, 5, 10, 20, 30):
        keyframe = make_keyframe(prepare(desk.frames[k]), CONFIG, np.random.default_rng(0), FUSED)
        out.append(Case(keyframe, prepare(desk.frames[k + 3]), desk.T(k + 3, k)))
    return out
