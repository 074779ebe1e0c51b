"""OpenCV 5's cv2.Odometry with its makers' defaults, which cap a step at 0.15 m and 15 degrees."""

from __future__ import annotations

from typing import Any, Literal

import cv2
import numpy as np
import torch
from torch import Tensor

from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.odometry import FrameToFrame

from .checked import Raw, checked

Kind = Literal["RGB", "DEPTH", "RGB_DEPTH"]


def make(kind: Kind) -> FrameToFrame:
    """Frame-to-frame odometry: photometric, ICP on depth, or both."""
    return FrameToFrame(checked(aligner(kind)), f"OpenCV {kind}")


def aligner(kind: Kind) -> Raw:
    """The bare pairwise method; it has no use for a guess. A frame that comes twice in a row is prepared once."""
    odometries: dict[Any, Any] = {}
    last: list[tuple[RgbdFrame, Any]] = []

    def prepared(frame: RgbdFrame, odometry: Any) -> Any:
        for known, image in last:
            if known is frame:
                return image
        gray = frame.gray.round().clamp(0, 255).to(torch.uint8).numpy()
        image = cv2.OdometryFrame(frame.depth.numpy().copy(), gray)
        odometry.prepareFrame(image)
        return image

    def align(source: RgbdFrame, target: RgbdFrame, guess: Tensor) -> Tensor | str:
        odometry = odometries.get(source.camera)
        if odometry is None:
            odometry = odometries[source.camera] = _odometry(source, kind)
            last.clear()
        images = prepared(source, odometry), prepared(target, odometry)
        last[:] = [(target, images[1])]
        try:
            found, T_target_source = odometry.compute(*images)
        except cv2.error as error:
            return f"OpenCV gave up: {error.err}"
        if not found:
            return "OpenCV found no motion within its limits of 0.15 m and 15 degrees"
        return torch.from_numpy(np.array(T_target_source, dtype=np.float64))

    return align


def _odometry(frame: RgbdFrame, kind: Kind) -> Any:
    settings = cv2.OdometrySettings()
    settings.setCameraMatrix(frame.camera.matrix().numpy().astype(np.float32))  # float64 is read as garbage
    return cv2.Odometry(getattr(cv2, f"OdometryType_{kind}"), settings, cv2.OdometryAlgoType_COMMON)
