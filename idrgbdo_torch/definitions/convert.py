"""Between what the kernels read and what the batched torch functions read. Nothing is copied."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..measurement import WIDE, Noise, Points
from .camera import Pinhole
from .linearise import ResidualNoise
from .points import HostPoints

Array = NDArray[Any]
SMALLEST = 4  # px, side of an image in which anything can be sampled: coarse levels of small images are smaller


def pinhole(cam: Array, image: Array) -> Pinhole:
    """fx fy cx cy (4,) of an image (H, W) as a camera."""
    height, width = image.shape
    fx, fy, cx, cy = (float(x) for x in cam)
    return Pinhole(width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy)


def noise_of_arrays(noise: Noise) -> ResidualNoise:
    """The kernels' variances as standard deviations."""
    return ResidualNoise(
        sigma_intensity=noise.var_intensity**0.5,
        sigma_pixel=(noise.var_pixel / noise.shared) ** 0.5,
        sigma_depth=noise.var_depth**0.5,
        shared=noise.shared,
        c_h=noise.c_h,
        huber=noise.huber,
        outlier=noise.outlier,
        use_depth=noise.use_depth,
        mode="paper" if noise.paper_variance else "first_order",
        gradient_blend=noise.gradient_blend,
        wide=noise.pattern == WIDE,
    )


def chosen(points: Points, index: Array) -> HostPoints:
    """Some of the points as a batch of one."""
    at = torch.from_numpy(index)
    patch, gradient = torch.from_numpy(points.patch), torch.from_numpy(points.gradient)
    return HostPoints(
        torch.from_numpy(points.uv)[at][None],
        torch.from_numpy(points.inv_depth)[at][None],
        torch.from_numpy(points.var_inv_depth)[at][None],
        tuple(patch[:, at][:, None]),
        tuple(gradient[:, at][:, None]),
        slope=torch.from_numpy(points.slope)[at][None],
    )


def inverse_of_depth(depth: Array) -> Tensor:
    """(H, W) float64 1/m of a depth image in m, 0 where missing."""
    metres = torch.from_numpy(depth).double()
    return torch.where(metres > 0, 1 / metres, 0.0)


def matrix(values: Array) -> Tensor:
    """A float64 tensor of one batch entry."""
    return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float64))[None]
