"""B frame pairs aligned at once: units checked, the search, and its result as a function of what it was made of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ..errors import IdRgbdoError
from ..measurement import FLOOR
from .camera import Pinhole
from .checks import believable, check_points, checked_targets
from .implicit import implicit_root
from .linearise import NormalEquations, ResidualNoise, Target, linearise_pairs, residual_noise
from .points import HostPoints, tracking_pyramid
from .se3 import retract
from .solver import pose_information, solve
from .tracking import STEPS, Estimate, Prior, Problem, descend, prior_at, with_prior

FEWEST = 6  # points, for six degrees of freedom


@dataclass(frozen=True)
class AlignedPairs:
    """B poses, how certain they are, and what became of the points."""

    T_target_host: Tensor  # (B, 4, 4) float64
    affine: Tensor  # (B, 2) brightness of the target relative to the host: gain e^a, offset b
    information: Tensor  # (B, 6, 6) of a left increment of the pose, brightness marginalised, prior excluded
    rms: Tensor  # (B, N) whitened residual of each point, -1 where it is not seen
    kept: Tensor  # (B, N) bool, points that took part
    iterations: Tensor  # (B,)
    ok: Tensor  # (B,) bool: everything finite, most points seen, their residuals what the noise lets expect


@dataclass(frozen=True)
class PairsTask:
    """What align_pairs is asked, its defaults filled in and its shapes found right."""

    points: HostPoints
    gray: Tensor  # (B, H, W)
    depth: Tensor | None  # (B, H, W) m
    camera: Pinhole
    prior: Prior
    noise: ResidualNoise
    steps: tuple[int, ...]  # most iterations per level, finest first


def pairs_task(
    points: HostPoints, gray: Tensor, camera: Pinhole, depth: Tensor | None, T_guess: Tensor | Prior | None,
    noise: ResidualNoise | None, steps: Sequence[int],
) -> PairsTask:  # fmt: skip
    """The arguments of align_pairs. Raises IdRgbdoError for numbers and sizes of images that do not fit."""
    B = len(points.uv)
    # arrays become tensors; tensors stay where they are, whatever torch's default device is
    gray = gray if isinstance(gray, Tensor) else torch.as_tensor(gray)
    depth = depth if depth is None or isinstance(depth, Tensor) else torch.as_tensor(depth)
    if gray.ndim != 3 or len(gray) != B or len(points.patch) < len(steps):
        raise IdRgbdoError(
            f"align_pairs: expected gray ({B}, H, W) and points with {len(steps)} levels, got {tuple(gray.shape)} and "
            f"{len(points.patch)}; pass as many images as pairs, and levels to host_points"
        )
    gray, depth = checked_targets(points, gray, depth, camera)
    eye = torch.eye(4, dtype=torch.float64, device=gray.device)
    guess = eye.expand(B, 4, 4) if T_guess is None else T_guess
    prior = guess if isinstance(guess, Prior) else prior_at(guess)
    return PairsTask(points, gray, depth, camera, prior, noise or residual_noise(), tuple(steps))


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
    Raises IdRgbdoError for images of another size than the camera's, gray levels in 0..1, depth in millimetres.

    The definition: on any device, and what tracker.pairs.align_pairs, which is the public one, is held against.
    """
    task = pairs_task(points, gray, camera, depth, T_guess, noise, steps)
    check_points(points, task.gray, task.depth)
    return aligned_by_definition(task, gradient_steps)


def aligned_by_definition(task: PairsTask, gradient_steps: int) -> AlignedPairs:
    """The search and its conclusion. On a GPU nothing in it waits for a result."""
    images = tracking_pyramid(task.gray, len(task.steps))
    problems = problems_of(task, images, inverse_of(task.depth))
    with torch.no_grad():
        found = descend(problems, task.prior, task.noise)
    T, a, system = concluded(task.points, problems[0].target, task.noise, found, gradient_steps)
    return result_of(task, found, T, a, system.H, system.rms, system.kept)


def problems_of(task: PairsTask, images: Sequence[Tensor], inverse_depth: Tensor | None) -> list[Problem]:
    """One a level, finest first, from a pyramid and the inverse of the task's depth."""
    return [
        Problem(task.points, Target(level, images[level], task.camera, inverse_depth), steps)
        for level, steps in enumerate(task.steps)
    ]


def result_of(
    task: PairsTask, found: Estimate, T: Tensor, affine: Tensor, H: Tensor, rms: Tensor, kept: Tensor
) -> AlignedPairs:
    """What align_pairs says of poses (B, 4, 4) and brightness (B, 2); H (B, 8, 8), rms and kept (B, N) as there."""
    certain = pose_information(H, found.prior.affine_information)
    contrast = task.gray.flatten(1).std(-1)
    ok = usable(T, certain, kept) & believable(task.points, contrast, rms, affine)
    return AlignedPairs(T, affine, certain, rms, kept, found.iterations, ok)


def usable(T: Tensor, information: Tensor, kept: Tensor) -> Tensor:
    """(B,) bool: everything is finite, and enough points took part."""
    finite = T.isfinite().all(-1).all(-1) & information.isfinite().all(-1).all(-1)
    return finite & (kept.sum(-1) >= FEWEST)


def inverse_of(depth: Tensor | None) -> Tensor | None:
    """1/m of m; 0 where it is missing, NaN, infinite or negative."""
    if depth is None:
        return None
    there = depth.isfinite() & (depth > 0)
    return torch.where(there, 1 / torch.where(there, depth, 1.0), 0.0)


def concluded(
    points: HostPoints, target: Target, noise: ResidualNoise, found: Estimate, gradient_steps: int
) -> tuple[Tensor, Tensor, NormalEquations]:
    """Pose (B, 4, 4), brightness (B, 2) and the system there, as align_pairs lets autograd see them.

    target: the finest level.
    """
    T, a = found.T_target_host, found.affine

    def system_at(T: Tensor, a: Tensor) -> NormalEquations:
        return linearise_pairs(points, target, T, a, noise, found.scale, noise.outlier)

    system = system_at(T, a)
    implicit = gradient_steps == 1 and system.b.requires_grad
    for _ in range(gradient_steps):
        T, a = _converged(system_at, T, a, found.prior) if implicit else _stepped(system, T, a, found.prior)
        system = system_at(T, a)
    return T, a, system


def _stepped(system: NormalEquations, T: Tensor, a: Tensor, prior: Prior) -> tuple[Tensor, Tensor]:
    """One Gauss-Newton step."""
    H, b, _ = with_prior(system, T, a, prior)
    step = solve(H + FLOOR * torch.eye(8, dtype=H.dtype, device=H.device), b).y
    return retract(step[:, :6], T), a + step[:, 6:]


def _converged(
    system_at: Callable[[Tensor, Tensor], NormalEquations], T: Tensor, a: Tensor, prior: Prior
) -> tuple[Tensor, Tensor]:
    """The pose and brightness nearby at which nothing moves, with their gradient."""
    floor = FLOOR * torch.eye(8, dtype=torch.float64, device=a.device)

    def equation(x: Tensor) -> tuple[Tensor, Tensor]:
        moved = retract(x[:, :6], T), a + x[:, 6:]
        H, b, _energy = with_prior(system_at(*moved), *moved, prior)
        return H + floor, b

    x = implicit_root(equation, a.new_zeros(len(a), 8))
    return retract(x[:, :6], T), a + x[:, 6:]
