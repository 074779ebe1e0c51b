"""Pairs at once, as the package offers them: by the fused kernels on the CPU, by one kernel a round of the search on a
GPU where Triton is installed, by the definitions on any other device.

All give the same numbers, to the single precision in which images are read. What the kernels do not have goes to the
definitions: noise that differs from point to point, gradients of where points are picked and sampled, images so small
or of such types that only the definition has a word for them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import ceil

import torch
from torch import Tensor

from ..definitions import linearise as by_linearise
from ..definitions import points as by_points
from ..definitions.camera import Pinhole
from ..definitions.checks import believable, check_points
from ..definitions.convert import SMALLEST
from ..definitions.linearise import NormalEquations, ResidualNoise, Target
from ..definitions.pairs import AlignedPairs, aligned_by_definition, pairs_task, usable
from ..definitions.points import BORDER, TRACKED_LEVELS, HostPoints
from ..definitions.tracking import STEPS, Prior
from ..errors import door
from ..measurement import LEVELS, PIXELS
from . import gpu, gpu_images, image_operators, operators
from .batch import recorded, sigmas_of, uniform


@door
def align_pairs(
    points: HostPoints, gray: Tensor, camera: Pinhole, *, depth: Tensor | None = None,
    T_guess: Tensor | Prior | None = None, noise: ResidualNoise | None = None, steps: Sequence[int] = STEPS,
    gradient_steps: int = 1,
) -> AlignedPairs:  # fmt: skip
    """Align target images gray (B, H, W) to the keyframes of the points, all pairs at once.

    depth: (B, H, W) m of the targets, 0 where missing; without it brightness alone counts. T_guess: (B, 4, 4) of
    T_target_host, where the search starts, identity by default; a prior (see prior_at) is started from and held too.
    steps: most iterations per level, finest first. gradient_steps: what autograd sees. 0: nothing; 1: the result as an
    implicit function of its inputs, after the search has gone on until nothing moves; more: so many Gauss-Newton steps.
    On the CPU the pairs are shared out to torch.get_num_threads() threads; a pose does not depend on the other pairs.
    Raises IdRgbdoError for images of another size than the camera's, gray levels in 0..1, depth in millimetres.
    """
    task = pairs_task(points, gray, camera, depth, T_guess, noise, steps)
    smallest = min(camera.width, camera.height) >> max(len(task.steps) - 1, 0)
    if not (fusable(points, task.noise, task.gray) and smallest >= SMALLEST and 0 < len(task.steps) <= LEVELS):
        check_points(points, task.gray, task.depth)
        if gpu.has_it(task) and smallest >= SMALLEST:
            return gpu.aligned(task, gradient_steps)
        return aligned_by_definition(task, gradient_steps)
    tensors = operators.list_of(task)
    seen = gradient_steps > 0 and recorded(*tensors)
    if not seen:
        tensors = [x.detach() for x in tensors]
    numbers = operators.numbers_of(camera, task.noise)
    still = seen and gradient_steps == 1
    T, affine, certain, rms, iterations, contrast, _T, _a, scale, *_prior = operators.align(
        tensors, numbers, list(task.steps), gradient_steps, still
    )
    rms, scale = rms.detach(), scale.detach()
    kept = (rms >= 0) & (rms <= task.noise.outlier * scale[:, None])
    ok = usable(T, certain, kept) & believable(points, contrast.detach(), rms, affine)
    return AlignedPairs(T, affine, certain, rms, kept, iterations, ok)


@door
def linearise_pairs(
    points: HostPoints, target: Target, T_target_host: Tensor, affine: Tensor, noise: ResidualNoise,
    scale: float | Tensor = 1.0, limit: float = float("inf"), pixels: int = PIXELS,
) -> NormalEquations:  # fmt: skip
    """Residuals, Jacobians and robust weights of B pairs, summed into one system each.

    T_target_host (B, 4, 4); affine (B, 2), the brightness of the target relative to the host; scale: a number or (B,),
    the robust scale of the whitened residuals; limit: largest rms of a point that takes part, in units of scale;
    pixels: how many of the pattern's are compared. Images of double precision are the definition's, which keeps it.
    """
    image, level = target.image, target.level
    small = min(image.shape[-2:]) < SMALLEST
    if small or not (
        fusable(points, noise, image) and image.dtype == torch.float32 and pixels == PIXELS and level < LEVELS
    ):
        return by_linearise.linearise_pairs(points, target, T_target_host, affine, noise, scale, limit, pixels)
    scales = torch.as_tensor(scale, dtype=torch.float64).expand(len(points.uv))
    tensors = operators.list_of_linearisation(points, target, T_target_host, affine, noise, scales)
    numbers = [*operators.numbers_of(target.camera, noise), limit]
    H, b, energy, rms = operators.linearise(tensors, numbers, level)
    rms = rms.detach()
    return NormalEquations(H, b, energy, rms, (rms >= 0) & (rms <= limit * scales.detach()[:, None]))


@door
def pick_points(gray: Tensor, depth: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """About `count` pixels uv (B, N, 2) with their inverse depths (B, N): the strongest gradient of each square cell.

    gray (B, H, W) in levels, depth (B, H, W) in m, 0 where missing. Only pixels amid one surface count; a cell without
    any gives an inverse depth of 0, which is no point. N is the number of cells, near `count`. float64.
    """
    plain = all(x.device.type == "cpu" and x.dtype == torch.float32 and not recorded(x) for x in (gray, depth))
    inside = [size - 2 * BORDER for size in gray.shape[-2:]]
    there = gpu_images.can(gray, depth)
    if not (plain or there) or gray.ndim != 3 or gray.shape != depth.shape or count < 1 or min(inside) < 1:
        return by_points.pick_points(gray, depth, count)
    cell = by_points.cell_of(inside[0] * inside[1], count)
    if there:
        return gpu_images.pick(gray, depth, cell)
    uv, inverse_depth = image_operators.pick(gray, depth, cell, ceil(inside[0] / cell) * ceil(inside[1] / cell))
    return uv, inverse_depth


@door
def host_points(
    gray: Tensor, uv: Tensor, inverse_depth: Tensor, *, sigma: float | Tensor | None = None,
    weight: Tensor | None = None, levels: int = TRACKED_LEVELS,
) -> HostPoints:  # fmt: skip
    """Points uv (B, N, 2) px of keyframes gray (B, H, W) in levels 0..255 at inverse depth (B, N) in 1/m, 0 for none.

    sigma: of the inverse depths, 1/m, a number or (B, N); a Kinect's by default. weight: (B, N) or (B, N, 8), a factor
    above 0 on the information of a point or of its pixels, for example one that is learnt.
    """
    variance = by_points.checked_variance(gray, uv, inverse_depth, sigma)
    plain = gray.dtype == torch.float32 and gray.device.type == uv.device.type == "cpu" and not recorded(gray, uv)
    there = gpu_images.can(gray) and uv.is_cuda and not recorded(uv)
    if not (plain or there) or not 0 < levels <= LEVELS or min(gray.shape[-2:]) >> (levels - 1) < SMALLEST:
        return by_points.host_points(gray, uv, inverse_depth, sigma=sigma, weight=weight, levels=levels)
    if there:
        patches, gradients = gpu_images.sampled(gray, uv, levels)
        return HostPoints(uv, inverse_depth, variance, tuple(patches), tuple(gradients), weight)
    patch, gradient = (x.to(uv.dtype) for x in image_operators.sampled(gray, uv, levels))
    return HostPoints(uv, inverse_depth, variance, tuple(patch.unbind(1)), tuple(gradient.unbind(1)), weight)


@door
def tracking_pyramid(gray: Tensor, levels: int) -> tuple[Tensor, ...]:
    """Halvings of gray (B, H, W), finest first, the coarse ones blurred so that texture does not alias there."""
    plain = gray.ndim == 3 and gray.dtype == torch.float32 and gray.device.type == "cpu" and not recorded(gray)
    small = min(gray.shape[-2:]) >> max(levels - 1, 0) < SMALLEST
    if levels > 1 and not small and gpu_images.can(gray):
        return gpu_images.tracking_pyramid(gray, levels)
    if not plain or not 1 < levels <= LEVELS or small:
        return by_points.tracking_pyramid(gray, levels)
    return (gray, *image_operators.halved(gray, levels))


def fusable(points: HostPoints, noise: ResidualNoise, image: Tensor) -> bool:
    """Whether the kernels have it: everything on the CPU, whole patches, one noise for all points."""
    here: Iterable[Tensor] = (points.uv, points.inverse_depth, image, *points.patch[:1], *sigmas_of(noise))
    return uniform(points, noise) and all(x.device.type == "cpu" for x in here)
