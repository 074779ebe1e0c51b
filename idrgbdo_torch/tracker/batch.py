"""A batch of pairs by the fused kernels, on as many threads as torch has: pyramids, units and search pair by pair.

Every pair goes through what a single one goes through, so a pose does not depend on the batch it came in.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import ceil, inf

import cv2
import numpy as np
import torch
from torch import Tensor

from ..definitions.camera import Pinhole
from ..definitions.checks import FARTHEST_M, GRAY_ROOM, check_gray, check_levels, check_metres
from ..definitions.linearise import ResidualNoise, Target
from ..definitions.pairs import PairsTask
from ..definitions.points import ONE_SURFACE, HostPoints
from ..frame import gray_pyramid
from ..kernels import pairs
from ..kernels.candidates import sample_patches
from ..kernels.pairs import After, At, Search, Starts, Systems, Targets
from ..measurement import COMPACT, LEVELS, PIXELS, WIDE, Array, Noise, Points

CHUNK = 8  # pairs at most that a thread takes at once: their pyramids stay in its cache


def recorded(*tensors: Tensor) -> bool:
    """Whether autograd looks at any of them."""
    return torch.is_grad_enabled() and any(x.requires_grad for x in tensors)


def sigmas_of(noise: ResidualNoise) -> list[Tensor]:
    """Those of its deviations that are tensors."""
    return [x for x in (noise.sigma_intensity, noise.sigma_pixel, noise.sigma_depth) if isinstance(x, Tensor)]


def uniform(points: HostPoints, noise: ResidualNoise) -> bool:
    """Whether patches are whole, and the noise is one for all points: what kernels of a batch take."""
    return all(patch.shape[-1] == PIXELS for patch in points.patch) and all(x.numel() == 1 for x in sigmas_of(noise))


def in_threads(work: Callable[[int, int], None], count: int) -> None:
    """work(first, end) over 0 to count, in pieces, on torch.get_num_threads() threads."""
    threads = min(torch.get_num_threads(), count)
    piece = max(1, min(CHUNK, ceil(count / (2 * max(threads, 1)))))
    starts = range(0, count, piece)
    ends = [min(start + piece, count) for start in starts]
    if threads <= 1:
        for start, end in zip(starts, ends, strict=True):
            work(start, end)
        return
    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(work, starts, ends):
            pass


def single(image: Tensor) -> Array:
    """A tensor as the contiguous float32 array that the kernels are compiled for."""
    out: Array = np.ascontiguousarray(image.detach().numpy(), np.float32)
    return out


def double(values: Tensor) -> Array:
    """The same in float64."""
    out: Array = np.ascontiguousarray(values.detach().numpy(), np.float64)
    return out


def pyramids(gray: Array, levels: int) -> tuple[Array, ...]:
    """Pyramids of images (n, H, W), finest first: six levels, the last one again where fewer are asked for."""
    each = [gray_pyramid(image, levels) for image in gray]
    stacked = [gray, *(np.stack(images) for images in list(zip(*each, strict=True))[1:])]
    return (*stacked, *(stacked[-1],) * (LEVELS - levels))


def kernel_points(points: HostPoints) -> tuple[Points, Array | None]:
    """The points of a batch as arrays with the pairs first, and their weights (B, N, P) if there are any."""
    B, N = points.inverse_depth.shape
    slope = np.zeros((B, N, 2)) if points.slope is None else double(points.slope)
    patch, gradient = (single(torch.stack(levels, 1)) for levels in (points.patch, points.gradient))
    arrays = Points(double(points.uv), double(points.inverse_depth), double(points.variance), patch, gradient, slope)
    if points.weight is None:
        return arrays, None
    weight = points.weight[..., None] if points.weight.ndim == 2 else points.weight
    return arrays, double(weight.expand(B, N, PIXELS))


def kernel_noise_of(noise: ResidualNoise, depth: bool) -> Noise:
    """The plain numbers of a noise none of which varies from point to point."""
    intensity, pixel, reading = (float(x) for x in (noise.sigma_intensity, noise.sigma_pixel, noise.sigma_depth))
    return Noise(
        intensity**2, noise.shared * pixel**2, reading**2, noise.shared, noise.c_h, noise.huber, noise.outlier,
        noise.use_depth and depth, noise.mode == "paper", noise.gradient_blend, 0.0, WIDE if noise.wide else COMPACT,
    )  # fmt: skip


def intrinsics(camera: Pinhole, levels: int = LEVELS) -> Array:
    """(L, 4) float64: fx fy cx cy of every level."""
    size = 0.5 ** np.arange(levels)[:, None]
    focal, centre = np.array([[camera.fx, camera.fy]]), np.array([[camera.cx, camera.cy]])
    return np.concatenate([focal * size, (centre + 0.5) * size - 0.5], axis=1)


@dataclass(frozen=True)
class Seen:
    """What the images of a batch were like."""

    low: Array  # (B,) least and
    high: Array  # (B,) largest gray level
    contrast: Array  # (B,) their standard deviation
    farthest: Array  # (B,) m

    @staticmethod
    def empty(B: int) -> Seen:
        """Room for B pairs."""
        return Seen(*(np.zeros(B) for _ in range(4)))

    def look(self, at: int, gray: Array) -> None:
        """At an image (H, W)."""
        self.low[at], self.high[at] = gray.min(), gray.max()
        self.contrast[at] = cv2.meanStdDev(gray)[1][0, 0]

    def metres(self, first: int, depth: Array) -> Array:
        """Some depth images (n, H, W), 0 where it is none."""
        clean = True
        for at, image in enumerate(depth, first):
            nearest, farthest = float(image.min()), float(image.max())
            self.farthest[at] = farthest
            clean &= nearest >= 0 and farthest < inf  # and not NaN
        return depth if clean else np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0.0))

    def check(self, task: PairsTask) -> None:
        """Raises IdRgbdoError for the units that check_points refuses."""
        lowest, highest = float(self.low.min()), float(self.high.max())
        if lowest < -GRAY_ROOM or highest > 255 + GRAY_ROOM or highest <= 1:
            check_gray(task.gray)
        check_levels(task.points, highest)
        if task.depth is not None and not float(self.farthest.max()) <= FARTHEST_M:  # nor NaN
            check_metres(task.depth)


def search(task: PairsTask, more: int, still: bool) -> tuple[Search, Array]:
    """The twin of definitions.pairs: B pairs aligned, and the contrast (B,) of their targets.

    more: Gauss-Newton steps after the search; still: until nothing moves instead. Raises IdRgbdoError for wrong units.
    """
    B, N = task.points.inverse_depth.shape
    points, weight = kernel_points(task.points)
    noise = kernel_noise_of(task.noise, task.depth is not None)
    prior = task.prior
    starts = Starts(
        *(double(x) for x in (prior.T_target_host, prior.information, prior.affine, prior.affine_information))
    )
    gray, depth = single(task.gray), None if task.depth is None else single(task.depth)
    cameras, steps = intrinsics(task.camera), np.array(task.steps, np.int64)
    seen, out = Seen.empty(B), Search.empty(B, N)

    def work(first: int, end: int) -> None:
        images = pyramids(gray[first:end], len(task.steps))
        for b in range(first, end):
            seen.look(b, gray[b])
        metres = np.zeros((end - first, 1, 1), np.float32)
        if depth is not None:
            metres = seen.metres(first, depth[first:end])
        targets = Targets(images, metres, cameras)
        pairs.align_pairs(targets, points, weight, starts, noise, steps, After(more, still), first, out)

    in_threads(work, B)
    if B:
        seen.check(task)
    return out, seen.contrast


def systems(
    points: HostPoints, target: Target, T: Tensor, affine: Tensor, noise: ResidualNoise, scale: Tensor, limit: float
) -> Systems:
    """The twin of definitions.linearise.linearise_pairs, for whole patches; scale (B,)."""
    B, N = points.inverse_depth.shape
    arrays, weight = kernel_points(points)
    plain = kernel_noise_of(noise, target.inverse_depth is not None)
    at = At(double(T), double(affine), double(scale), limit)
    image, cameras, out = single(target.image), intrinsics(target.camera), Systems.empty(B, N)
    inverse_depth = None if target.inverse_depth is None else single(target.inverse_depth)

    def work(first: int, end: int) -> None:
        depth = np.zeros((end - first, 1, 1), np.float32)
        if inverse_depth is not None:
            some = inverse_depth[first:end]
            depth = np.divide(1, some, out=np.zeros_like(some), where=some > 0)
        targets = Targets((image[first:end],) * LEVELS, depth, cameras)
        pairs.linearise_pairs(targets, target.level, arrays, weight, at, plain, first, out)

    in_threads(work, B)
    return out


def pick(gray: Tensor, depth: Tensor, cell: int, count: int) -> tuple[Tensor, Tensor]:
    """The twin of definitions.points.pick_points: uv (B, count, 2) and inverse depths (B, count) of square cells."""
    images, metres = single(gray), single(depth)
    uv, inverse_depth = np.empty((len(gray), count, 2)), np.empty((len(gray), count))

    def work(first: int, end: int) -> None:
        for b in range(first, end):
            pairs.strongest_of_cells(images[b], metres[b], cell, ONE_SURFACE, uv[b], inverse_depth[b])

    in_threads(work, len(gray))
    return torch.from_numpy(uv), torch.from_numpy(inverse_depth)


def sampled(gray: Tensor, uv: Tensor, levels: int) -> tuple[Tensor, Tensor]:
    """What host_points sees of gray (B, H, W) around uv: patches (B, L, N, P), gradients (B, L, N, P, 2), float32."""
    images, at, index = single(gray), double(uv), np.arange(uv.shape[1])
    patch = np.empty((len(gray), levels, len(index), PIXELS), np.float32)
    gradient = np.empty((*patch.shape, 2), np.float32)

    def work(first: int, end: int) -> None:
        for b in range(first, end):
            each = gray_pyramid(images[b], levels)
            some = (*each, *each[-1:] * (LEVELS - levels))
            sample_patches(some, at[b], index, 0, levels, COMPACT, patch[b], gradient[b])

    in_threads(work, len(gray))
    return torch.from_numpy(patch), torch.from_numpy(gradient)


def halved(gray: Tensor, levels: int) -> tuple[Tensor, ...]:
    """The twin of definitions.points.tracking_pyramid."""
    images = single(gray)
    height, width = images.shape[1:]
    out = [images, *(np.empty((len(gray), height >> k, width >> k), np.float32) for k in range(1, levels))]

    def work(first: int, end: int) -> None:
        for b in range(first, end):
            for level, image in enumerate(gray_pyramid(images[b], levels)[1:], 1):
                out[level][b] = image

    in_threads(work, len(gray))
    return tuple(torch.from_numpy(level) for level in out)
