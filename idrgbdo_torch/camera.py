"""Pinhole camera: projection, back-projection at inverse depth, their Jacobians, and the depth noise of Eq. (10)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .errors import IdRgbdoError


@dataclass(frozen=True, kw_only=True)
class Pinhole:
    """Undistorted pinhole camera that knows its image size.

    Pixel (0, 0) is the centre of the top-left pixel, u to the right, v down; all values in pixels.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        if self.width <= 0 or self.height <= 0 or self.fx <= 0 or self.fy <= 0:
            raise IdRgbdoError(
                f"camera: expected a positive size and focal length, got {self.width}x{self.height}, "
                f"fx={self.fx}, fy={self.fy}; check the intrinsics"
            )

    def at_level(self, level: int) -> Pinhole:
        """The same camera on a pyramid level: half the size a level, c -> (c + 0.5) s - 0.5."""
        s = 0.5**level
        return Pinhole(
            width=self.width >> level,
            height=self.height >> level,
            fx=self.fx * s,
            fy=self.fy * s,
            cx=(self.cx + 0.5) * s - 0.5,
            cy=(self.cy + 0.5) * s - 0.5,
        )

    def matrix(self) -> Tensor:
        """(3, 3) float64 intrinsic matrix."""
        return torch.tensor(
            [[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]], dtype=torch.float64
        )
