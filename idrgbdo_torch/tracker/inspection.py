"""What an odometry shows of itself to pictures, maps, reports and viewers: the one door through which they look in."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from ..frame import Keyframe
from .mapping import Cloud
from .tracking import Tracked


@runtime_checkable
class Inspectable(Protocol):
    """An odometry that tracks points of keyframes and says which. Nothing here changes what it does next."""

    def last_points(self) -> tuple[Tensor, Tensor]:
        """The points last tracked: (N, 2) px in that frame, and (N,) bits that each adds to what the others know."""

    def last_candidates(self) -> Tensor:
        """(M, 2) px of all points that could have been chosen there."""

    def last_alignment(self) -> tuple[Keyframe, Tracked] | None:
        """The keyframe that the last frame was tracked against, and how; None where it was not tracked."""

    def window_keyframes(self) -> dict[int, tuple[Keyframe, NDArray[np.float64]]]:
        """By number, the keyframes that are still refined and their T_kf_world (4, 4); the newest is the last."""

    def maps(self) -> dict[int, Cloud]:
        """By segment, the points of its keyframes with colours and normals; segments lie in worlds of their own."""
