"""The fused batch as torch operators: whole for torch.compile, differentiable by the definitions, with a vmap rule.

An operator takes a list of tensors, numbers and integers. Its gradient is one of the definition, evaluated where the
kernels ended, an operator too: so compiled graphs hold one node for a search and one for its gradient.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor
from torch.library import custom_op

from ..definitions.camera import Pinhole
from ..definitions.linearise import ResidualNoise, Target
from ..definitions.linearise import linearise_pairs as linearise_by_definition
from ..definitions.pairs import PairsTask, concluded, inverse_of
from ..definitions.points import HostPoints
from ..definitions.solver import pose_information
from ..definitions.tracking import Estimate, Prior
from . import batch

NUMBERS = 14  # of camera and noise at the head of the others
SIGMAS = 3  # scalars at the head of every list: of intensity, pixel and depth
LATER = 5  # results of a search that its gradient starts from: pose, brightness, scale, centre and spread of the prior


def tensors_of(points: HostPoints, noise: ResidualNoise) -> list[Tensor]:
    """Points and noise as the head of a list: SIGMAS scalars, then what has the pairs first; no numbers for None."""
    like = points.uv
    sigmas = (noise.sigma_intensity, noise.sigma_pixel, noise.sigma_depth)
    scalars = [torch.as_tensor(x, dtype=torch.float64, device=like.device).reshape(()) for x in sigmas]
    optional = [like.new_zeros(len(like), 0) if x is None else x for x in (points.weight, points.slope)]
    return [*scalars, points.uv, points.inverse_depth, points.variance, *optional, *points.patch, *points.gradient]


def points_of(tensors: Sequence[Tensor], levels: int) -> tuple[HostPoints, list[Tensor]]:
    """The points, and what follows them in the list."""
    uv, inverse_depth, variance, weight, slope, *rest = tensors[SIGMAS:]
    patch, gradient, rest = rest[:levels], rest[levels : 2 * levels], rest[2 * levels :]
    points = HostPoints(
        uv, inverse_depth, variance, tuple(patch), tuple(gradient), weight if weight.numel() else None,
        slope if slope.numel() else None,
    )  # fmt: skip
    return points, rest


def numbers_of(camera: Pinhole, noise: ResidualNoise) -> list[float]:
    """Camera and noise without its deviations."""
    size = [float(camera.width), float(camera.height), camera.fx, camera.fy, camera.cx, camera.cy]
    rest = [noise.shared, noise.c_h, noise.huber, noise.outlier, float(noise.use_depth), float(noise.mode == "paper")]
    return [*size, *rest, noise.gradient_blend, float(noise.wide)]


def camera_and_noise(tensors: Sequence[Tensor], numbers: Sequence[float]) -> tuple[Pinhole, ResidualNoise]:
    """The inverse of numbers_of and of the head of tensors_of."""
    width, height, fx, fy, cx, cy, shared, c_h, huber, outlier, depth, paper, blend, wide = numbers[:NUMBERS]
    camera = Pinhole(width=int(width), height=int(height), fx=fx, fy=fy, cx=cx, cy=cy)
    intensity, pixel, reading = tensors[:SIGMAS]
    mode: Any = "paper" if paper else "first_order"
    noise = ResidualNoise(
        intensity, pixel, reading, shared, c_h, huber, outlier, bool(depth), mode, blend, bool(wide)
    )  # fmt: skip
    return camera, noise


def task_of(tensors: Sequence[Tensor], numbers: Sequence[float], steps: Sequence[int]) -> PairsTask:
    """What align_pairs is asked."""
    points, rest = points_of(tensors, len(steps))
    gray, depth, T, information, affine, affine_information = rest
    camera, noise = camera_and_noise(tensors, numbers)
    prior = Prior(T, information, affine, affine_information)
    return PairsTask(points, gray, depth if depth.numel() else None, camera, prior, noise, tuple(steps))


def list_of(task: PairsTask) -> list[Tensor]:
    """The inverse of task_of."""
    depth = task.gray.new_zeros(len(task.gray), 0) if task.depth is None else task.depth
    prior = task.prior
    rest = [task.gray, depth, prior.T_target_host, prior.information, prior.affine, prior.affine_information]
    levels = len(task.steps)
    few = replace(task.points, patch=task.points.patch[:levels], gradient=task.points.gradient[:levels])
    return [*tensors_of(few, task.noise), *rest]


@custom_op("idrgbdo::align_pairs", mutates_args=(), device_types="cpu")
def align(
    tensors: list[Tensor], numbers: list[float], steps: list[int], gradient_steps: int, still: bool
) -> list[Tensor]:
    """Pose, brightness, information, rms, iterations, contrast; then what the gradient starts from (LATER)."""
    out, contrast = batch.search(task_of(tensors, numbers, steps), gradient_steps, still)
    T, affine, H, rms, iterations, *later = (torch.from_numpy(x) for x in out)
    if still:  # the gradient is that of where nothing moves
        later[:2] = T.clone(), affine.clone()
    return [T, affine, pose_information(H, later[-1]), rms, iterations, torch.from_numpy(contrast), *later]


@align.register_fake
def _(tensors: list[Tensor], numbers: list[float], steps: list[int], gradient_steps: int, still: bool) -> list[Tensor]:
    inverse_depth = tensors[SIGMAS + 1]
    B, N = inverse_depth.shape

    def new(*shape: int) -> Tensor:
        return inverse_depth.new_empty(shape, dtype=torch.float64)

    pose = [new(B, 4, 4), new(B, 2)]
    counts = inverse_depth.new_empty(B, dtype=torch.int64)
    later = [new(B, 4, 4), new(B, 2), new(B), new(B, 2), new(B, 2, 2)]
    return [*pose, new(B, 6, 6), new(B, N), counts, new(B), *later]


@custom_op("idrgbdo::align_pairs_backward", mutates_args=(), device_types="cpu")
def align_backward(
    grads: list[Tensor], tensors: list[Tensor], later: list[Tensor], numbers: list[float], steps: list[int],
    gradient_steps: int,
) -> list[Tensor]:  # fmt: skip
    """Of pose, brightness and information, (3,) grads, with respect to all tensors."""

    def results(leaves: Sequence[Tensor]) -> list[Tensor]:
        task = task_of(leaves, numbers, steps)
        T, affine, scale, centre, spread = later
        prior = Prior(task.prior.T_target_host, task.prior.information, centre, spread)
        found = Estimate(T, affine, prior, scale, scale, scale)
        target = Target(0, task.gray, task.camera, inverse_of(task.depth))
        T, a, system = concluded(task.points, target, task.noise, found, gradient_steps)
        return [T, a, pose_information(system.H, spread)]

    return gradients(results, tensors, grads)


@align_backward.register_fake
def _(
    grads: list[Tensor], tensors: list[Tensor], later: list[Tensor], numbers: list[float], steps: list[int],
    gradient_steps: int,
) -> list[Tensor]:  # fmt: skip
    return [torch.empty_like(x) for x in tensors]


def gradients(
    results: Callable[[Sequence[Tensor]], list[Tensor]], tensors: Sequence[Tensor], grads: Sequence[Tensor]
) -> list[Tensor]:
    """What autograd says of results(tensors), zero where they do not depend on a tensor."""

    def found() -> list[Tensor]:
        leaves = [x.detach().clone().requires_grad_(x.is_floating_point()) for x in tensors]
        some = [pair for pair in zip(results(leaves), grads, strict=True) if pair[0].requires_grad]
        asked = [leaf for leaf in leaves if leaf.requires_grad]
        out, given = zip(*some, strict=True)
        values = iter(torch.autograd.grad(out, asked, given, allow_unused=True))
        each = [next(values) if leaf.requires_grad else None for leaf in leaves]
        return [torch.zeros_like(x) if value is None else value for x, value in zip(tensors, each, strict=True)]

    # inside an operator autograd records nothing; a thread of its own is outside
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(found).result()


def _keep(ctx: Any, inputs: tuple[Any, ...], output: list[Tensor]) -> None:
    tensors, *ctx.plain = inputs
    ctx.count = len(tensors)
    ctx.save_for_backward(*tensors, *output[-LATER:])


def _align_gradient(ctx: Any, grads: list[Tensor | None]) -> tuple[Any, ...]:
    tensors, later = ctx.saved_tensors[: ctx.count], ctx.saved_tensors[ctx.count :]
    numbers, steps, gradient_steps, _still = ctx.plain
    B = len(later[0])
    shapes = (B, 4, 4), (B, 2), (B, 6, 6)
    given = [later[0].new_zeros(shape) if g is None else g for g, shape in zip(grads, shapes, strict=False)]
    return align_backward(given, list(tensors), list(later), numbers, steps, gradient_steps), None, None, None, None


align.register_autograd(_align_gradient, setup_context=_keep)


@custom_op("idrgbdo::linearise_pairs", mutates_args=(), device_types="cpu")
def linearise(tensors: list[Tensor], numbers: list[float], level: int) -> list[Tensor]:
    """H, b, energy, rms."""
    out = batch.systems(*_linearise_task(tensors, numbers, level))
    return [torch.from_numpy(x) for x in out]


def _linearise_task(
    tensors: Sequence[Tensor], numbers: Sequence[float], level: int
) -> tuple[HostPoints, Target, Tensor, Tensor, ResidualNoise, Tensor, float]:
    """The arguments of linearise_pairs; the lists hold one level, which stands for those before it too."""
    one, rest = points_of(tensors, 1)
    points = HostPoints(
        one.uv, one.inverse_depth, one.variance, one.patch * (level + 1), one.gradient * (level + 1), one.weight,
        one.slope,
    )  # fmt: skip
    image, inverse_depth, T, affine, scale = rest
    camera, noise = camera_and_noise(tensors, numbers)
    target = Target(level, image, camera, inverse_depth if inverse_depth.numel() else None)
    return points, target, T, affine, noise, scale, numbers[-1]


def list_of_linearisation(
    points: HostPoints, target: Target, T: Tensor, affine: Tensor, noise: ResidualNoise, scale: Tensor
) -> list[Tensor]:
    """The inverse of _linearise_task, but for the numbers."""
    level, none = target.level, target.image.new_zeros(len(target.image), 0)
    one = replace(points, patch=points.patch[level : level + 1], gradient=points.gradient[level : level + 1])
    depth = none if target.inverse_depth is None else target.inverse_depth
    return [*tensors_of(one, noise), target.image, depth, T, affine, scale]


@linearise.register_fake
def _(tensors: list[Tensor], numbers: list[float], level: int) -> list[Tensor]:
    inverse_depth = tensors[SIGMAS + 1]
    B, N = inverse_depth.shape
    return [inverse_depth.new_empty(shape, dtype=torch.float64) for shape in ((B, 8, 8), (B, 8), (B,), (B, N))]


@custom_op("idrgbdo::linearise_pairs_backward", mutates_args=(), device_types="cpu")
def linearise_backward(grads: list[Tensor], tensors: list[Tensor], numbers: list[float], level: int) -> list[Tensor]:
    """Of H, b and energy, (3,) grads, with respect to all tensors."""

    def results(leaves: Sequence[Tensor]) -> list[Tensor]:
        system = linearise_by_definition(*_linearise_task(leaves, numbers, level))
        return [system.H, system.b, system.energy]

    return gradients(results, tensors, grads)


@linearise_backward.register_fake
def _(grads: list[Tensor], tensors: list[Tensor], numbers: list[float], level: int) -> list[Tensor]:
    return [torch.empty_like(x) for x in tensors]


def _keep_tensors(ctx: Any, inputs: tuple[Any, ...], output: list[Tensor]) -> None:
    tensors, *ctx.plain = inputs
    ctx.save_for_backward(*tensors)


def _linearise_gradient(ctx: Any, grads: list[Tensor | None]) -> tuple[Any, ...]:
    numbers, level = ctx.plain
    tensors = list(ctx.saved_tensors)
    B = len(tensors[SIGMAS])
    shapes = (B, 8, 8), (B, 8), (B,)
    like = tensors[SIGMAS].new_zeros(0, dtype=torch.float64)
    given = [like.new_zeros(shape) if g is None else g for g, shape in zip(grads, shapes, strict=False)]
    return linearise_backward(given, tensors, numbers, level), None, None


linearise.register_autograd(_linearise_gradient, setup_context=_keep_tensors)


def folded(operator: Any) -> Callable[..., Any]:
    """A vmap rule: the mapped dimension joins that of the pairs, which know nothing of each other."""

    def rule(info: Any, in_dims: tuple[Any, ...], tensors: list[Tensor], *rest: Any) -> tuple[list[Tensor], list[int]]:
        dims: Sequence[int | None] = in_dims[0] if isinstance(in_dims[0], list | tuple) else [in_dims[0]] * len(tensors)
        if any(dim is not None for dim in dims[:SIGMAS]):
            raise NotImplementedError(
                "vmap: expected one noise for all pairs, got one for each; loop over them, or call the definition"
            )
        joined = []
        for x, dim in zip(tensors[SIGMAS:], dims[SIGMAS:], strict=True):
            each = x.expand(info.batch_size, *x.shape) if dim is None else x.movedim(dim, 0)
            joined.append(each.flatten(0, 1))
        out = operator([*tensors[:SIGMAS], *joined], *rest)
        return [x.unflatten(0, (info.batch_size, -1)) for x in out], [0] * len(out)

    return rule


align.register_vmap(folded(align))
linearise.register_vmap(folded(linearise))
