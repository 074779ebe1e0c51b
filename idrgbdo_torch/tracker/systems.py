"""Normal equations of a window as sums of parts, and as they would be a little further on."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.solver import dot
from ..kernels.window import times
from ..measurement import WindowSystem

Array = NDArray[Any]


class Part(NamedTuple):
    """What some pairs of keyframes say, linear about where it was taken."""

    energy: float
    system: WindowSystem

    def __add__(self, other: object) -> Part:
        """Both together; they share no pair."""
        if not isinstance(other, Part):
            return NotImplemented
        mine, theirs = self.system, other.system
        H, b, Hd, bd, cross = (x + y for x, y in zip(mine[:-1], theirs[:-1], strict=True))
        return Part(self.energy + other.energy, WindowSystem(H, b, Hd, bd, cross, np.maximum(mine.rms, theirs.rms)))

    def at(self, step: Array, depth_step: Array) -> Part:
        """The same at a state that lies step (8K,) and depth_step (K, N) away: another energy, other right sides."""
        H, b, Hd, bd, cross, rms = self.system
        Hs, Hsd = times(self.system, step, depth_step)
        energy = self.energy + dot(step, Hs - 2.0 * b) + dot(depth_step.ravel(), (Hsd - 2.0 * bd).ravel())
        return Part(energy, WindowSystem(H, b - Hs, Hd, bd - Hsd, cross, rms))

    def moved(self, step: Array, depth_step: Array) -> float:
        """How far that is, in squared standard deviations of this part, the mean over its unknowns."""
        _, b, _, bd, _, _ = self.system
        there = self.at(step, depth_step).system
        squared = float(dot(step, b - there.b) + dot(depth_step.ravel(), (bd - there.bd).ravel()))
        return squared / (step.size + depth_step.size)
