"""What an odometry shows of itself to pictures, maps, reports and viewers: the one door through which they look in."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..definitions.growing import Column
from ..frame import Keyframe
from ..measurement import Noise
from .backends import Backend
from .mapping import Cloud
from .reference import Reference
from .selection import point_bits
from .tracking import Tracked

Last = tuple[Keyframe, Tracked]  # what a frame was tracked against, and how


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


def tracked_points(last: Last | None, noise: Noise, backend: Backend) -> tuple[Tensor, Tensor]:
    """What last_points gives."""
    if last is None:
        return torch.zeros(0, 2, dtype=torch.float64), torch.zeros(0, dtype=torch.float64)
    keyframe, tracked = last
    return point_bits(keyframe, tracked.T_frame_kf, tracked.index, noise, backend)


def seen_candidates(
    last: Last | None, reference: Reference | None, times: Column, noise: Noise, backend: Backend
) -> Tensor:
    """What last_candidates gives; the last of `times` is that of the frame."""
    if last is not None:
        keyframe, tracked = last
        return point_bits(keyframe, tracked.T_frame_kf, np.arange(len(keyframe.points.uv)), noise, backend)[0]
    own = reference.keyframe if reference else None
    shown = own is not None and own.frame.timestamp == times[-1]
    return torch.from_numpy(own.points.uv) if own and shown else torch.zeros(0, 2, dtype=torch.float64)
