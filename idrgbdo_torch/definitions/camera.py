"""Pinhole camera: projection, back-projection at inverse depth, and their Jacobians."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..errors import IdRgbdoError
from .given import number

SHORTEST_PX, FARTHEST_PX = 1e-6, 1e7  # of a focal length; beyond, squares leave the range of numbers
MIN_DEPTH = 1e-3  # m; nearer, or behind, is not in front of the camera


@dataclass(frozen=True, kw_only=True)
class Pinhole:
    """Undistorted pinhole camera that knows its image size.

    Pixel (0, 0) is the centre of the top-left pixel, u to the right, v down; all values in pixels but the two times.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    readout_ms: float = 0.0  # of a rolling shutter, first to last row of the colour image; a frame's time is its middle
    depth_delay_ms: float = 0.0  # by which the depth image is taken later than the colour image

    def __post_init__(self) -> None:
        """Raises IdRgbdoError for what is no camera; whole numbers become the floats that everything else takes."""
        for name in ("fx", "fy", "cx", "cy"):
            object.__setattr__(self, name, number(f"camera: {name}", getattr(self, name), "pixels"))
        for name in ("width", "height"):
            pixels = number(f"camera: {name}", getattr(self, name), "pixels")
            if pixels != int(pixels):
                raise IdRgbdoError(f"camera: {name}: expected a whole number of pixels, got {pixels}; change it")
            object.__setattr__(self, name, int(pixels))
        if max(self.fx, self.fy, abs(self.cx), abs(self.cy)) > FARTHEST_PX or 0 < min(self.fx, self.fy) < SHORTEST_PX:
            raise IdRgbdoError(
                f"camera: expected focal lengths and a principal point in pixels, got fx={self.fx:g}, fy={self.fy:g}, "
                f"cx={self.cx:g}, cy={self.cy:g}; check the intrinsics"
            )
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
            readout_ms=self.readout_ms,
            depth_delay_ms=self.depth_delay_ms,
        )

    def matrix(self) -> Tensor:
        """(3, 3) float64 intrinsic matrix."""
        return torch.tensor([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]], dtype=torch.float64)


def project(camera: Pinhole, P: Tensor) -> tuple[Tensor, Tensor]:
    """Pixels uv (..., 2) of camera points P (..., 3) in metres, and the mask (...) of those in front of the camera.

    An invalid point (nearer than MIN_DEPTH, behind, or not finite) gets the principal point and gradients of zero.
    Whether uv lies inside the image is `inside`'s question.
    """
    P, valid = _in_front(P)
    x, y, z = P.unbind(-1)
    uv = torch.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], dim=-1)
    return uv, valid


def duv_dP(camera: Pinhole, P: Tensor) -> Tensor:
    """Jacobian (..., 2, 3) of `project` in px/m; zero where the point is not in front of the camera."""
    P, valid = _in_front(P)
    x, y, z = P.unbind(-1)
    zero = torch.zeros_like(z)
    du_dP = torch.stack([camera.fx / z, zero, -camera.fx * x / (z * z)], dim=-1)
    dv_dP = torch.stack([zero, camera.fy / z, -camera.fy * y / (z * z)], dim=-1)
    J = torch.stack([du_dP, dv_dP], dim=-2)
    return torch.where(valid[..., None, None], J, torch.zeros_like(J))


def inside(camera: Pinhole, uv: Tensor, margin: float = 0.0) -> Tensor:
    """The mask (...) of pixels uv (..., 2) at least `margin` px within the centres of the border pixels."""
    u, v = uv.unbind(-1)
    return (u >= margin) & (u <= camera.width - 1 - margin) & (v >= margin) & (v <= camera.height - 1 - margin)


def backproject(camera: Pinhole, uv: Tensor, inverse_depth: Tensor) -> Tensor:
    """Camera points P (..., 3) in metres of pixels uv (..., 2) at inverse depth (...) in 1/m.

    An inverse depth that is not positive and finite gives the zero vector, never NaN; mask it by `inverse_depth > 0`.
    """
    d, valid = _positive(inverse_depth)
    x = (uv[..., 0] - camera.cx) / camera.fx
    y = (uv[..., 1] - camera.cy) / camera.fy
    P = torch.stack([x / d, y / d, torch.ones_like(x) / d], dim=-1)
    return torch.where(valid[..., None], P, torch.zeros_like(P))


def dP_dinverse_depth(camera: Pinhole, uv: Tensor, inverse_depth: Tensor) -> Tensor:
    """Jacobian (..., 3) of `backproject` with respect to the inverse depth, in m^2: -P / d; zero where d is invalid."""
    d, _ = _positive(inverse_depth)
    return -backproject(camera, uv, inverse_depth) / d[..., None]


def _in_front(P: Tensor) -> tuple[Tensor, Tensor]:
    """P with invalid points replaced by (0, 0, 1), so that nothing divides by zero, and the mask of the valid."""
    valid = (P[..., 2] > MIN_DEPTH) & torch.isfinite(P).all(-1)
    axis = torch.tensor([0.0, 0.0, 1.0], dtype=P.dtype, device=P.device)
    return torch.where(valid[..., None], P, axis), valid


def _positive(inverse_depth: Tensor) -> tuple[Tensor, Tensor]:
    """The inverse depth with invalid values replaced by 1, and the validity mask."""
    valid = (inverse_depth > 0) & torch.isfinite(inverse_depth)
    return torch.where(valid, inverse_depth, torch.ones_like(inverse_depth)), valid
