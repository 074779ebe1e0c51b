"""What the frames of a check say of the camera's numbers: each run of them tracked, as `idrgbdo run` would."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch

from ..definitions.camera import Pinhole
from ..errors import IdRgbdoError
from ..frame import RgbdFrame
from ..odometry import Record
from ..tracker.camera_estimate import CameraEstimate, CameraEstimator, together
from ..tracker.id_rgbdo import IdRgbdo
from .samples import Sample


@dataclass
class CameraSeen:
    """Collects from runs of neighbouring frames; each begins anew, so what it says is independent of the others."""

    camera: Pinhole
    estimators: list[CameraEstimator] = field(default_factory=list)

    def add(self, run: list[Sample]) -> None:
        """Track a run. One that cannot be tracked, as with depth in no metres, says nothing."""
        odometry, estimator = IdRgbdo(), CameraEstimator(sparing=False)
        for sample in run:
            gray, depth = torch.from_numpy(sample.gray).float(), torch.from_numpy(sample.depth)
            try:
                frame = RgbdFrame(sample.timestamp, gray, depth, self.camera)
                record = Record(sample.timestamp, odometry.track(frame), 0.0, None)
            except IdRgbdoError:
                break
            estimator.look(record, odometry)
        self.estimators.append(estimator)

    def fit(self) -> CameraEstimate | None:
        """From all runs; None where they can't tell."""
        return together(self.estimators, self.camera)
