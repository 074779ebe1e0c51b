"""A batch of pairs on a GPU: the search of definitions/tracking.py, a launch of kernels/gpu a round instead of a step.

Where Triton is missing the definitions do it all. Gradients are the definitions' in either case.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..definitions import points as by_points
from ..definitions.linearise import ResidualNoise
from ..definitions.pairs import AlignedPairs, PairsTask, concluded, inverse_of, problems_of, result_of
from ..definitions.points import HostPoints
from ..definitions.tracking import Estimate, Found, Heard, Prior, Problem, descend
from ..measurement import COMPACT, PATTERNS, PIXELS, WIDE
from . import gpu_images
from .batch import recorded, sigmas_of, uniform

BLOCK, WARPS = 32, 1  # points at a time, a lane each with its eight pixels


def has_it(task: PairsTask) -> bool:
    """Whether the kernels have a task: everything on one GPU, whole patches, one noise for all points."""
    here = (x.device == task.gray.device for x in tensors_of(task))
    return gpu_images.TRITON and task.gray.is_cuda and all(here) and uniform(task.points, task.noise)


def tensors_of(task: PairsTask) -> list[Tensor]:
    """All that a task is made of, but for the noise, whose numbers may lie anywhere."""
    values = [task.gray, task.depth, *(x for one in (task.points, task.prior) for x in vars(one).values())]
    flat = [x for one in values for x in (one if isinstance(one, tuple) else (one,))]
    return [x for x in flat if isinstance(x, Tensor)]


def aligned(task: PairsTask, gradient_steps: int) -> AlignedPairs:
    """The search and its conclusion; where autograd looks, the conclusion is the definition's."""
    seen = gradient_steps > 0 and recorded(*tensors_of(task), *sigmas_of(task.noise))
    levels, plain = len(task.steps), gpu_images.can(task.gray, *([] if task.depth is None else [task.depth]))
    images = (gpu_images if plain else by_points).tracking_pyramid(task.gray, levels)
    there = gpu_images.inverse_of(task.depth) if plain and task.depth is not None else inverse_of(task.depth)
    problems = problems_of(task, images, there)
    by = OnGpu(problems, task.noise)
    with torch.no_grad():
        found = descend(problems, task.prior, task.noise, by=by.search)
    if seen:
        T, a, system = concluded(task.points, problems[0].target, task.noise, found, gradient_steps)
        return result_of(task, found, T, a, system.H, system.rms, system.kept)
    return result_of(task, found, *by.concluded(problems[0], task.noise, found, gradient_steps))


class OnGpu:
    """search() and what follows it, of one batch; what its points are is arranged once."""

    def __init__(self, problems: Sequence[Problem], noise: ResidualNoise) -> None:
        self._points = Points.of(problems[0].points)
        self._numbers = numbers_of(problems, noise)

    def search(
        self, problem: Problem, start: Found, prior: Prior, noise: ResidualNoise, scale: Tensor, settled: float,
        heard: Heard | None,
    ) -> Found:  # fmt: skip
        """Twin of definitions.tracking.search, for whole patches and without what another level said of the pose."""
        assert heard is None and problem.pixels == PIXELS
        out = self._launch(problem, State(start.T, start.affine, scale), prior, noise, Round(noise.outlier, settled))
        change = out.change if problem.steps else start.change
        return Found(out.T, out.affine, start.iterations + out.iterations, change, out.rms, out.H)

    def concluded(
        self, problem: Problem, noise: ResidualNoise, found: Estimate, steps: int
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Twin of definitions.pairs.concluded without gradients: so many Gauss-Newton steps on the finest level.

        Pose (B, 4, 4), brightness (B, 2), the measurements' H (B, 8, 8), the points' rms and kept (B, N).
        """
        start, prior = State(found.T_target_host, found.affine, found.scale), found.prior
        out = self._launch(replace(problem, steps=steps), start, prior, noise, Round(noise.outlier, 0.0, every=True))
        kept = (out.rms >= 0) & (out.rms <= noise.outlier * found.scale[:, None])
        H = out.H - pad(prior.information, (0, 2, 0, 2)) - pad(prior.affine_information, (6, 0, 6, 0))
        return out.T, out.affine, H, out.rms, kept

    def _launch(self, problem: Problem, start: State, prior: Prior, noise: ResidualNoise, turn: Round) -> Answer:
        """kernels/gpu/search.search, a program a pair."""
        from ..kernels.gpu.search import search  # needs Triton

        points, level, target = self._points, problem.target.level, problem.target
        used = bool(noise.use_depth and target.inverse_depth is not None)
        image = target.image.contiguous()
        depth = target.inverse_depth.contiguous() if target.inverse_depth is not None and used else image
        B, N = points.rows.shape[0], points.rows.shape[-1]
        answer = Answer.empty(B, N, points.rows)
        known = (prior.T_target_host, prior.information, prior.affine, prior.affine_information)
        with gpu_images.on_its_device(image):
            search[(B,)](
                images=(image, *image.shape[-2:], depth, *depth.shape[-2:]),
                points=(
                    points.rows, points.patch[level], points.gradient[level], points.weight, self._numbers[level], N,
                ),
                start_at=(plain(start.T), plain(start.affine), plain(start.scale)),
                prior=tuple(map(plain, known)), turn=(turn.limit, turn.settled, problem.steps, int(turn.every)),
                answer=tuple(answer), DEPTH=used, PAPER=noise.mode == "paper", BLOCK=BLOCK, num_warps=WARPS,
                enable_fp_fusion=False,
            )  # fmt: skip
        return answer


def plain(x: Tensor) -> Tensor:
    """In double precision, one after the other."""
    return x.double().contiguous()


class Points(NamedTuple):
    """What kernels/gpu/linearise.py takes of the points."""

    rows: Tensor  # (B, 6, N) float64
    patch: tuple[Tensor, ...]  # a level: (B, N, 8)
    gradient: tuple[Tensor, ...]  # a level: (B, N, 8, 2)
    weight: Tensor  # (B, N, 8)

    @staticmethod
    def of(points: HostPoints) -> Points:
        """Arranged so."""
        d, weight = points.inverse_depth.detach().double(), points.weight
        slope = d.new_zeros(*d.shape, 2) if points.slope is None else points.slope
        about = [*points.uv.unbind(-1), d, points.variance.expand_as(d), *slope.unbind(-1)]
        rows = torch.stack([x.detach().double() for x in about], dim=1)
        if weight is None:
            each = d.new_ones(*d.shape, PIXELS)
        else:
            each = weight.detach()[..., None] if weight.ndim == 2 else weight.detach()
        patch = tuple(x.detach().contiguous() for x in points.patch)
        gradient = tuple(x.detach().contiguous() for x in points.gradient)
        return Points(rows, patch, gradient, each.expand(*d.shape, PIXELS).contiguous())


def numbers_of(problems: Sequence[Problem], noise: ResidualNoise) -> Tensor:
    """(L, 28): camera, noise and pattern of each level, in the order of kernels/gpu/linearise.NUMBERS."""
    lines = []
    for problem in problems:
        level, camera = problem.target.level, problem.target.camera.at_level(problem.target.level)
        known = [camera.fx, camera.fy, camera.cx, camera.cy, 2.0**level]
        pattern = PATTERNS[WIDE if noise.wide and level == 0 else COMPACT]
        rest = [noise.shared, noise.c_h, noise.huber, noise.gradient_blend]
        lines.append([*known, 0.0, 0.0, 0.0, *rest, *pattern.T.ravel().tolist()])
    numbers = torch.tensor(lines, dtype=torch.float64)
    sigmas = (noise.sigma_intensity, noise.sigma_pixel, noise.sigma_depth)
    if not sigmas_of(noise):
        numbers[:, 5:8] = torch.tensor([sigma**2 for sigma in sigmas])
        return numbers.to(problems[0].target.image.device)
    numbers = numbers.to(problems[0].target.image.device)
    for k, sigma in enumerate(sigmas, start=5):  # they may lie on the device
        numbers[:, k] = (sigma.detach() if isinstance(sigma, Tensor) else sigma) ** 2
    return numbers


class State(NamedTuple):
    """Where B pairs start."""

    T: Tensor  # (B, 4, 4)
    affine: Tensor  # (B, 2)
    scale: Tensor  # (B,)


class Round(NamedTuple):
    """What a launch does: the limit of a point's residual, what settles a pair, and whether every step is taken."""

    limit: float
    settled: float
    every: bool = False


class Answer(NamedTuple):
    """What a launch fills."""

    T: Tensor  # (B, 4, 4)
    affine: Tensor  # (B, 2)
    change: Tensor  # (B,)
    H: Tensor  # (B, 8, 8) with the prior
    rms: Tensor  # (B, N)
    iterations: Tensor  # (B,)

    @staticmethod
    def empty(B: int, N: int, like: Tensor) -> Answer:
        """Room for B pairs of N points."""
        new = like.new_empty
        return Answer(new(B, 4, 4), new(B, 2), new(B), new(B, 8, 8), new(B, N), new(B, dtype=torch.int64))
