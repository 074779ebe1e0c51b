"""What a sensor gives (RgbdFrame, BrokenFrame)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .camera import Pinhole
from .errors import IdRgbdoError


@dataclass(frozen=True)
class RgbdFrame:
    """One registered colour and depth image.

    timestamp: seconds. gray: (H, W) float32 gray levels 0..255. depth: (H, W) float32 metres, 0 where invalid.
    camera: the undistorted pinhole of both. color: (H, W, 3) uint8 RGB for maps and pictures, optional.
    """

    timestamp: float
    gray: Tensor
    depth: Tensor
    camera: Pinhole
    color: Tensor | None = None

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        for name, image in (("gray", self.gray), ("depth", self.depth)):
            if image.dtype != torch.float32 or tuple(image.shape) != size:
                raise IdRgbdoError(
                    f"{name}: expected a float32 tensor of shape {size} (the camera's height, width), "
                    f"got {image.dtype} {tuple(image.shape)}; convert it or pass the matching camera"
                )


@dataclass(frozen=True)
class BrokenFrame:
    """A frame that could not be read: it costs that frame, not the run."""

    timestamp: float
    reason: str
