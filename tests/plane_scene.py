"""What the kernels read, made of plane_world: a noisy target image, its depth with faults, and points of the host."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import torch
from plane_world import CAMERA, SLANTED, T_TARGET_HOST, render
from torch import Tensor

from idrgbdo_torch.definitions.image import pyramid, sample_surface, sample_with_gradient
from idrgbdo_torch.definitions.photometric import PATTERN
from idrgbdo_torch.measurement import Points, View

P = len(PATTERN)
LEVELS = 3
SIGMA_D = 0.004  # 1/m
EYE = torch.eye(4, dtype=torch.float64)


def close(actual: Any, expected: Any, relative: float = 1e-10) -> None:
    """Equal to `relative` of the largest expected value."""
    expected = torch.as_tensor(expected)
    size = float(expected.abs().max()) or 1.0
    torch.testing.assert_close(torch.as_tensor(actual), expected, rtol=0, atol=relative * size)


@dataclass(frozen=True)
class Scene:
    """A plane seen twice, with points everywhere: in view and out of it, on good and on wrong depth."""

    images: tuple[np.ndarray, ...]  # of the target, float32
    depth: np.ndarray  # of the target, float32 m
    points: Points

    @property
    def view(self) -> View:
        """The target."""
        return View(self.images, self.depth, np.stack([intrinsics(level) for level in range(LEVELS)]))

    def tensor(self, name: str, index: np.ndarray) -> Tensor:
        return torch.from_numpy(getattr(self.points, name)[index])


@cache
def plane_scene() -> Scene:
    """Rendered once; sensor noise in the images, 2 % in the depths."""
    rng = np.random.default_rng(5)
    fuzz = [torch.from_numpy(6 * rng.standard_normal((CAMERA.height, CAMERA.width))) for _ in range(2)]
    host, target = ((gray + noise).float() for (gray, _), noise in zip(both(), fuzz, strict=True))
    d_host, d_target = (d for _, d in both())
    depth = (1 / d_target).float()
    depth[torch.from_numpy(rng.uniform(size=depth.shape) < 0.01)] = 0.0
    depth[60:100, 200:260] *= 1.5  # another surface
    n = 200
    uv = torch.from_numpy(rng.uniform([4, 4], [CAMERA.width - 5, CAMERA.height - 5], (n, 2)))
    d = sample_surface(d_host, uv)[0] * torch.from_numpy(1 + 0.02 * rng.standard_normal(n))
    patches, gradients = [], []
    for level, image in enumerate(pyramid(host, LEVELS)):
        at = ((uv + 0.5) * 0.5**level - 0.5)[:, None] + PATTERN
        value, g, _ = sample_with_gradient(image, at)
        patches.append(value.float())
        gradients.append(g.float())
    variance = SIGMA_D**2 * torch.from_numpy(rng.uniform(0.3, 2.0, n))
    points = Points(
        uv.numpy(), d.numpy(), variance.numpy(), torch.stack(patches).numpy(), torch.stack(gradients).numpy(),
        0.001 * rng.standard_normal((n, 2)),
    )  # fmt: skip
    return Scene(tuple(image.numpy() for image in pyramid(target, LEVELS)), depth.numpy(), points)


def both() -> tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor]]:
    return render(EYE, SLANTED), render(T_TARGET_HOST, SLANTED)


def intrinsics(level: int) -> np.ndarray:
    c = CAMERA.at_level(level)
    return np.array([c.fx, c.fy, c.cx, c.cy])
