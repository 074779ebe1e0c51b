"""An analytic world for tests: a smoothly textured plane, rendered exactly from any pose."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor
from torch.func import jacfwd

from idrgbdo_torch.definitions import se3
from idrgbdo_torch.definitions.camera import Pinhole, backproject
from idrgbdo_torch.definitions.image import sample_bilinear

CAMERA = Pinhole(width=320, height=240, fx=280.0, fy=270.0, cx=161.5, cy=117.5)
XI = torch.tensor([0.06, -0.04, 0.05, 0.02, -0.03, 0.04], dtype=torch.float64)
T_TARGET_HOST = se3.exp(XI)
AFFINE = torch.tensor([0.1, -5.0], dtype=torch.float64)
FACING = torch.tensor([0.0, 0.0, 0.5], dtype=torch.float64)  # plane n . P = 1 of the host: at 2 m, frontal
SLANTED = torch.tensor([0.12, -0.1, 0.5], dtype=torch.float64)


def texture(P: Tensor) -> Tensor:
    """Gray level of a host point; waves of 0.7 m and more, so of 100 px and more at 2 m."""
    x, y, _ = P.unbind(-1)
    return 120 + 40 * torch.sin(7 * x + 1) * torch.cos(5 * y) + 30 * torch.sin(4 * x - 6 * y) + 8 * x


def pixel_grid() -> Tensor:
    v, u = torch.meshgrid(torch.arange(CAMERA.height).double(), torch.arange(CAMERA.width).double(), indexing="ij")
    return torch.stack([u, v], dim=-1)


def render(T_cam_host: Tensor, plane: Tensor) -> tuple[Tensor, Tensor]:
    """Exact gray (H, W) and inverse depth (H, W) of the plane n . P_host = 1."""
    rays = backproject(CAMERA, pixel_grid(), torch.ones(CAMERA.height, CAMERA.width, dtype=torch.float64))
    T_host_cam = se3.inverse(T_cam_host)
    slope = rays @ (T_host_cam[:3, :3].mT @ plane)  # n . (R z ray + t) = 1
    inverse_depth = slope / (1 - plane @ T_host_cam[:3, 3])
    return texture(se3.transform(T_host_cam, rays / inverse_depth[..., None])), inverse_depth


def points(plane: Tensor, step: int = 18) -> tuple[Tensor, Tensor]:
    """Host pixels (N, 2) on a grid well inside, and their exact inverse depths (N,)."""
    uv = pixel_grid()[40:-40:step, 40:-40:step].reshape(-1, 2)
    return uv, backproject(CAMERA, uv, torch.ones(len(uv), dtype=torch.float64)) @ plane


def one_point() -> tuple[Tensor, Tensor]:
    return torch.tensor([200.0, 80.0], dtype=torch.float64), torch.tensor(0.47, dtype=torch.float64)


def derivative(f: Callable[[Tensor], Tensor]) -> Tensor:
    """df/dxi of a left increment at zero."""
    return jacfwd(lambda xi: f(se3.retract(xi, T_TARGET_HOST)))(torch.zeros(6, dtype=torch.float64))


def host_intensity(uv: Tensor, plane: Tensor, pattern: Tensor) -> Tensor:
    image, _ = render(torch.eye(4, dtype=torch.float64), plane)
    return sample_bilinear(image, uv[..., None, :] + pattern)[0]
