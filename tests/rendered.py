"""A short rendered sequence for tests: a desk filmed by a hand-held camera, poses exactly known."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from idrgbdo_torch.definitions.se3 import inverse
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.synthetic import FaultConfig, RenderedSequence, SensorConfig, SynthConfig
from idrgbdo_torch.synthetic.world import World
from idrgbdo_torch.tracker.open3d_loader import load_open3d
from idrgbdo_torch.trajectory import Trajectory

SMALL = SynthConfig(kind="desk", frames=40, width=320, height=240, fx=262.5, fy=262.5, cx=159.5, cy=119.5)
FAULTLESS = SynthConfig(
    kind="structure_texture",
    frames=8,
    width=160,
    height=120,
    fx=131.25,
    fy=131.25,
    cx=79.5,
    cy=59.5,
    rate=15.0,
    sensor=SensorConfig.ideal(),
)


@dataclass(frozen=True)
class Film:
    """All frames of a rendered sequence in memory, and the truth."""

    frames: tuple[RgbdFrame, ...]
    groundtruth: Trajectory

    def T(self, target: int, source: int) -> Tensor:
        """(4, 4) float64 true T_target_source of two frames."""
        poses = self.groundtruth.T_world_cam
        return inverse(poses[target]) @ poses[source]


def film(config: SynthConfig = SMALL) -> Film:
    """Render it now."""
    sequence = RenderedSequence(config)
    return Film(tuple(sequence), sequence.groundtruth)


def with_faults(faultless: RenderedSequence, faults: FaultConfig, frames: int | None = None) -> RenderedSequence:
    """A film with faults, or its first frames; world, path and exposure are not made again."""
    faulty = RenderedSequence(replace(faultless.config, faults=faults, frames=frames or faultless.config.frames))
    for shared in ("renderer", "path", "T_scene_world", "exposure"):
        faulty.__dict__[shared] = getattr(faultless, shared)
    return faulty


def rotation_deg(T: Tensor) -> float:
    """The angle of a motion in degrees."""
    cosine = (T[:3, :3].diagonal().sum() - 1) / 2
    return float(torch.rad2deg(torch.arccos(cosine.clamp(-1, 1))))


def later(frame: RgbdFrame, seconds: float) -> RgbdFrame:
    """The same images at another time."""
    return replace(frame, timestamp=frame.timestamp + seconds)


def clearance(world: World, points: np.ndarray) -> np.ndarray:
    """(N,) distance in metres of points (N, 3) from the nearest surface."""
    query = load_open3d().core.Tensor(np.ascontiguousarray(points, np.float32))
    return np.asarray(world.caster.compute_distance(query, nthreads=1).numpy(), np.float64)
