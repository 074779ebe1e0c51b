"""Points of B keyframes for the batched functions: picked, sampled on every pyramid level, or taken from elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, sqrt

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d, pad

from ..config import NoiseConfig, TrackingConfig
from ..errors import IdRgbdoError, door
from ..measurement import COARSE_BLUR, inverse_depth_sigma
from .image import gradient, pyramid, sample_with_gradient
from .photometric import PATTERN

TRACKED_LEVELS = TrackingConfig().levels  # of a pyramid by default
ONE_SURFACE = 1.05  # largest over smallest depth around a picked point
BORDER = 4  # px, room for the patch and its gradients


@dataclass(frozen=True)
class HostPoints:
    """N points of each of B keyframes, with what the keyframes show there on every pyramid level."""

    uv: Tensor  # (B, N, 2) px, level 0
    inverse_depth: Tensor  # (B, N) 1/m; 0 is no point
    variance: Tensor  # (B, N) (1/m)^2 of it
    patch: tuple[Tensor, ...]  # a level: (B, N, P) gray levels
    gradient: tuple[Tensor, ...]  # a level: (B, N, P, 2) gray levels per px
    weight: Tensor | None = None  # (B, N) or (B, N, P) factor on the information, above 0; 1 if None
    slope: Tensor | None = None  # (B, N, 2) 1/m per px of level 0, of the inverse depth over the patch; 0 if None


@door
def pick_points(gray: Tensor, depth: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """About `count` pixels uv (B, N, 2) with their inverse depths (B, N): the strongest gradient of each square cell.

    gray (B, H, W) in levels, depth (B, H, W) in m, 0 where missing. Only pixels amid one surface count; a cell without
    any gives an inverse depth of 0, which is no point. N is the number of cells, near `count`. float64.
    """
    if gray.ndim != 3 or gray.shape != depth.shape or count < 1:
        raise IdRgbdoError(
            f"pick_points: expected gray and depth (B, H, W) and count >= 1, got {tuple(gray.shape)}, "
            f"{tuple(depth.shape)}, {count}; one image is gray[None]"
        )
    height, width = gray.shape[-2:]
    farthest = max_pool2d(depth, 5, stride=1, padding=2)
    nearest = -max_pool2d(torch.where(depth > 0, -depth, 0.0), 5, stride=1, padding=2)
    score = gradient(gray).square().sum(-3)
    score = torch.where((nearest > 0) & (farthest <= ONE_SURFACE * nearest), score, 0.0)
    inner = score[:, BORDER : height - BORDER, BORDER : width - BORDER]
    cell = cell_of(inner.shape[-1] * inner.shape[-2], count)
    best, index = max_pool2d(inner[:, None], cell, ceil_mode=True, return_indices=True)
    best, index = best.flatten(1), index.flatten(1)  # (B, N)
    u = BORDER + index % inner.shape[-1]
    v = BORDER + torch.div(index, inner.shape[-1], rounding_mode="floor")
    z = depth.flatten(1).gather(1, v * width + u).double()
    there = (best > 0) & (z > 0)
    inverse_depth = torch.where(there, 1 / torch.where(there, z, 1.0), 0.0)
    return torch.stack([u, v], dim=-1).double(), inverse_depth


def cell_of(pixels: int, count: int) -> int:
    """Side in px of about so many square cells."""
    return max(1, round(sqrt(pixels / count)))


@door
def host_points(
    gray: Tensor, uv: Tensor, inverse_depth: Tensor, *, sigma: float | Tensor | None = None,
    weight: Tensor | None = None, levels: int = TRACKED_LEVELS,
) -> HostPoints:  # fmt: skip
    """Points uv (B, N, 2) px of keyframes gray (B, H, W) in levels 0..255 at inverse depth (B, N) in 1/m, 0 for none.

    sigma: of the inverse depths, 1/m, a number or (B, N); a Kinect's by default. weight: (B, N) or (B, N, 8), a factor
    above 0 on the information of a point or of its pixels, for example one that is learnt.
    """
    variance = checked_variance(gray, uv, inverse_depth, sigma)
    patches, gradients = sample_patterns(tracking_pyramid(gray, levels), uv, PATTERN)
    return HostPoints(uv, inverse_depth, variance, tuple(patches), tuple(gradients), weight)


def checked_variance(gray: Tensor, uv: Tensor, inverse_depth: Tensor, sigma: float | Tensor | None) -> Tensor:
    """(B, N) variance of the inverse depths of host_points. Raises IdRgbdoError for shapes that do not fit."""
    if gray.ndim != 3 or uv.shape != (*inverse_depth.shape, 2) or uv.shape[0] != gray.shape[0]:
        raise IdRgbdoError(
            f"host_points: expected gray (B, H, W), uv (B, N, 2), inverse_depth (B, N), got {tuple(gray.shape)}, "
            f"{tuple(uv.shape)}, {tuple(inverse_depth.shape)}; pad shorter pairs with an inverse depth of 0"
        )
    kinect = inverse_depth_sigma(NoiseConfig().focal_baseline, NoiseConfig().sigma_disparity)
    spread = torch.as_tensor(kinect if sigma is None else sigma, dtype=uv.dtype, device=uv.device)
    return spread.square().expand_as(inverse_depth)


@door
def tracking_pyramid(gray: Tensor, levels: int) -> tuple[Tensor, ...]:
    """Halvings of gray (B, H, W), finest first, the coarse ones blurred so that texture does not alias there."""
    images = pyramid(gray, levels)
    return (images[0], *(_blurred(image) for image in images[1:]))


def sample_patterns(images: Sequence[Tensor], uv: Tensor, pattern: Tensor) -> tuple[list[Tensor], list[Tensor]]:
    """Intensities (*B, N, P) and gradients (*B, N, P, 2) of pyramid images (*B, H, W) around level-0 pixels (*B, N, 2).

    pattern (P, 2): of the finest level; the others have PATTERN. Clamped near the border: coarse levels have less room,
    and a clamped pixel is still a fair guess.
    """
    patches, gradients = [], []
    for level, image in enumerate(images):
        last = uv.new_tensor([image.shape[-1] - 2.001, image.shape[-2] - 2.001])
        offsets = PATTERN[: len(pattern)] if level else pattern
        at = (at_level(uv, level)[..., None, :] + offsets.to(uv)).clamp(min=1.0).minimum(last)
        intensity, gradient, _ = sample_with_gradient(image, at)
        patches.append(intensity)
        gradients.append(gradient)
    return patches, gradients


def at_level(uv: Tensor, level: int) -> Tensor:
    """Pixels (..., 2) of level 0 on a pyramid level."""
    return (uv + 0.5) * 0.5**level - 0.5


def _blurred(image: Tensor) -> Tensor:
    """A 5x5 Gaussian of COARSE_BLUR px, reflected at the border; image (B, H, W).

    As sums of shifted images: a GPU's convolutions round to ten bits.
    """
    at = [exp(-0.5 * (k / COARSE_BLUR) ** 2) for k in range(-2, 3)]
    weights = [x / sum(at) for x in at]
    padded = pad(image[:, None], (2, 2, 2, 2), mode="reflect")[:, 0]
    rows = shifted_sum(padded, weights, -1)
    return shifted_sum(rows, weights, -2)


def shifted_sum(image: Tensor, weights: Sequence[float], dim: int) -> Tensor:
    """Sum over k of weights[k] times the image shifted by k along a dimension, which shrinks by what is left over."""
    size = image.shape[dim] - len(weights) + 1
    total = weights[0] * image.narrow(dim, 0, size)
    for k in range(1, len(weights)):
        total = total.add(image.narrow(dim, k, size), alpha=weights[k])
    return total
