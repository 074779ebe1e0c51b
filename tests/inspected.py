"""A stand-in for an odometry that can be looked into: what a test does not give is empty."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from idrgbdo_torch.frame import Keyframe
from idrgbdo_torch.odometry import ConstantVelocity
from idrgbdo_torch.tracker.inspection import Inspectable
from idrgbdo_torch.tracker.mapping import NOTHING, Cloud
from idrgbdo_torch.tracker.tracking import Tracked


class Inspected(ConstantVelocity):
    """Never looks at an image, and shows nothing."""

    def last_points(self) -> tuple[Tensor, Tensor]:
        return torch.zeros(0, 2, dtype=torch.float64), torch.zeros(0, dtype=torch.float64)

    def last_candidates(self) -> Tensor:
        return torch.zeros(0, 2, dtype=torch.float64)

    def last_alignment(self) -> tuple[Keyframe, Tracked] | None:
        return None

    def window_keyframes(self) -> dict[int, tuple[Keyframe, np.ndarray]]:
        return {}

    def maps(self) -> dict[int, Cloud]:
        return {0: NOTHING}


assert isinstance(Inspected(), Inspectable)
