"""B frame pairs aligned at once (section 4.2): coarse to fine, damped Gauss-Newton, robust; differentiable if asked."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..errors import IdRgbdoError, door
from ..measurement import (
    FLOOR,
    PIXELS,
    SETTLED,
    SETTLED_COARSE,
    Aligned,
    MotionPrior,
    Noise,
    Points,
    State,
    Subset,
    View,
)
from .camera import Pinhole
from .checks import believable, checked_targets
from .convert import SMALLEST, Array, chosen, inverse_of_depth, matrix, noise_of_arrays, pinhole
from .implicit import implicit_root
from .linearise import NormalEquations, ResidualNoise, Target, linearise_pairs, residual_noise, robust_scale
from .points import HostPoints, tracking_pyramid
from .se3 import inverse, log, retract
from .solver import brightness_information, pose_information, solve

STEPS = (8, 10, 12, 12)  # most iterations per level, finest first
NOTHING = torch.zeros(0)
FEWEST = 6  # points, for six degrees of freedom
AFFINE_SIGMA = (0.1, 10.0)  # of gain and gray levels, about the guess


@dataclass(frozen=True)
class Prior:
    """What is known of B pairs beforehand: Gaussians about a pose and a brightness."""

    T_target_host: Tensor  # (B, 4, 4) float64
    information: Tensor  # (B, 6, 6) of a left increment of it
    affine: Tensor  # (B, 2)
    affine_information: Tensor  # (B, 2, 2)


@dataclass(frozen=True)
class Problem:
    """One pyramid level of B pairs."""

    points: HostPoints
    target: Target
    steps: int  # most iterations
    pixels: int = PIXELS  # of the patch that are compared


@dataclass(frozen=True)
class Estimate:
    """Where B pairs have got to."""

    T_target_host: Tensor  # (B, 4, 4) float64
    affine: Tensor  # (B, 2) float64
    prior: Prior
    scale: Tensor  # (B,) robust scale of the finest level
    iterations: Tensor  # (B,) over all levels
    change: Tensor  # (B,) the last step in standard deviations


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


def prior_at(T_target_host: Tensor, information: Tensor | None = None, affine: Tensor | None = None) -> Prior:
    """What is known of B pairs beforehand: a Gaussian about poses (B, 4, 4) and brightness.

    information: (6, 6) or (B, 6, 6) of a left increment of the pose, none by default. affine: (B, 2), the brightness of
    the target relative to the host, the same by default; it is held to AFFINE_SIGMA about that.
    """
    B = len(T_target_host)
    known = torch.zeros(6, 6) if information is None else information
    brightness = torch.zeros(B, 2) if affine is None else affine
    spread = torch.diag(torch.tensor(AFFINE_SIGMA, dtype=torch.float64) ** -2).expand(B, 2, 2)
    return Prior(T_target_host.double(), known.double().expand(B, 6, 6), brightness.double(), spread)


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
    Raises IdRgbdoError for images of another size than the camera's, gray levels in 0..1, depth in millimetres.
    """
    B = len(points.uv)
    gray, depth = torch.as_tensor(gray), None if depth is None else torch.as_tensor(depth)
    if gray.ndim != 3 or len(gray) != B or len(points.patch) < len(steps):
        raise IdRgbdoError(
            f"align_pairs: expected gray ({B}, H, W) and points with {len(steps)} levels, got {tuple(gray.shape)} and "
            f"{len(points.patch)}; pass as many images as pairs, and levels to host_points"
        )
    gray, depth = checked_targets(points, gray, depth, camera)
    noise = noise or residual_noise()
    guess = torch.eye(4, dtype=torch.float64).expand(B, 4, 4) if T_guess is None else T_guess
    prior = guess if isinstance(guess, Prior) else prior_at(guess)
    inverse_depth = None if depth is None else torch.where(depth > 0, 1 / depth.clamp(min=1e-6), 0.0)
    images = tracking_pyramid(gray, len(steps))
    problems = [Problem(points, Target(k, images[k], camera, inverse_depth), steps[k]) for k in range(len(steps))]

    with torch.no_grad():
        found = descend(problems, prior, noise)
    T, a = found.T_target_host, found.affine

    def system_at(T: Tensor, a: Tensor) -> NormalEquations:
        return linearise_pairs(points, problems[0].target, T, a, noise, found.scale, noise.outlier)

    system = system_at(T, a)
    implicit = gradient_steps == 1 and system.b.requires_grad
    for _ in range(gradient_steps):
        T, a = _converged(system_at, T, a, found.prior) if implicit else _stepped(system, T, a, found.prior)
        system = system_at(T, a)
    certain = pose_information(system.H, found.prior.affine_information)
    finite = T.isfinite().all(-1).all(-1) & certain.isfinite().all(-1).all(-1)
    ok = finite & (system.kept.sum(-1) >= FEWEST) & believable(points, gray, system.rms, a)
    return AlignedPairs(T, a, certain, system.rms, system.kept, found.iterations, ok)


def _stepped(system: NormalEquations, T: Tensor, a: Tensor, prior: Prior) -> tuple[Tensor, Tensor]:
    """One Gauss-Newton step."""
    H, b, _ = with_prior(system, T, a, prior)
    step = solve(H + FLOOR * torch.eye(8, dtype=H.dtype), b).y
    return retract(step[:, :6], T), a + step[:, 6:]


def _converged(
    system_at: Callable[[Tensor, Tensor], NormalEquations], T: Tensor, a: Tensor, prior: Prior
) -> tuple[Tensor, Tensor]:
    """The pose and brightness nearby at which nothing moves, with their gradient."""
    floor = FLOOR * torch.eye(8, dtype=torch.float64)

    def equation(x: Tensor) -> tuple[Tensor, Tensor]:
        moved = retract(x[:, :6], T), a + x[:, 6:]
        H, b, _energy = with_prior(system_at(*moved), *moved, prior)
        return H + floor, b

    x = implicit_root(equation, a.new_zeros(len(a), 8))
    return retract(x[:, :6], T), a + x[:, 6:]


def descend(problems: Sequence[Problem], prior: Prior, noise: ResidualNoise) -> Estimate:
    """Damped Gauss-Newton from the prior's pose over the levels, finest first in `problems`, coarsest first in time.

    Each pair has its own damping, and rests once it has settled. A level takes the scale of its residuals from the one
    before; the finest has other points, so it finds its own, and a second round works with the outlier limit from the
    first. The brightness that the many points of level 1 agree on is the prior of the finest.
    """
    B, last = len(prior.affine), len(problems) - 1
    found = _Found(prior.T_target_host, prior.affine, torch.zeros(B, dtype=torch.int64), prior.affine.new_zeros(B))
    scale = prior.affine.new_ones(B)
    for level in reversed(range(len(problems))):
        problem = problems[level]
        if level in (0, last):  # other points, or none so far to tell the scale
            first = linearise_pairs(problem.points, problem.target, found.T, found.affine, noise, pixels=problem.pixels)
            found = replace(found, rms=first.rms)
        for settled in SETTLED if level == 0 else (SETTLED_COARSE,):
            scale = robust_scale(found.rms)
            found = _search(problem, found, prior, noise, scale, settled)
        if level == 1:
            learnt = brightness_information(found.H, prior.affine_information)
            prior = replace(prior, affine=found.affine, affine_information=learnt)
    return Estimate(found.T, found.affine, prior, scale, found.iterations, found.change)


@dataclass(frozen=True)
class _Found:
    """Where a search has got to."""

    T: Tensor  # (B, 4, 4)
    affine: Tensor  # (B, 2)
    iterations: Tensor  # (B,) so far
    change: Tensor  # (B,) the last step in standard deviations
    rms: Tensor = NOTHING  # (B, N) of the points at the last pose that was tried
    H: Tensor = NOTHING  # (B, 8, 8) at the pose, prior included


def _search(
    problem: Problem, start: _Found, prior: Prior, noise: ResidualNoise, scale: Tensor, settled: float
) -> _Found:
    """One round on one level."""
    T, affine, change, count = start.T, start.affine, start.change, start.iterations
    system = _system(problem, T, affine, noise, scale)
    H, b, energy = with_prior(system, T, affine, prior)
    rms, seen = system.rms, system.seen.sum(-1)
    eye = torch.eye(8, dtype=H.dtype)
    damping = torch.zeros_like(energy)
    active = torch.ones_like(energy, dtype=torch.bool)
    for _ in range(problem.steps):
        count = count + active
        solution = solve(H + FLOOR * eye, b, damping)
        active = active & solution.ok
        step = solution.y
        change = torch.where(active, (step * b).sum(-1).clamp(min=0).sqrt(), change)
        T_new, affine_new = retract(step[:, :6], T), affine + step[:, 6:]
        system = _system(problem, T_new, affine_new, noise, scale)
        H_new, b_new, energy_new = with_prior(system, T_new, affine_new, prior)
        rms = torch.where(active[:, None], system.rms, rms)
        seen_new = system.seen.sum(-1)
        # a point that leaves the image must not look like a gain
        lost = (seen - seen_new).clamp(min=0) * problem.pixels
        better = energy_new.isfinite() & (energy_new + lost <= energy)
        take = active & better
        T, affine = torch.where(take[:, None, None], T_new, T), torch.where(take[:, None], affine_new, affine)
        H, b = torch.where(take[:, None, None], H_new, H), torch.where(take[:, None], b_new, b)
        energy, seen = torch.where(take, energy_new, energy), torch.where(take, seen_new, seen)
        shrunk = torch.where(damping < 4e-4, 0.0, 0.25 * damping)
        damping = torch.where(better, shrunk, (4 * damping).clamp(min=0.1))
        active = active & (better | (damping <= 1e4)) & (change >= settled)
        if not bool(active.any()):
            break
    return _Found(T, affine, count, change, rms, H)


def _system(problem: Problem, T: Tensor, affine: Tensor, noise: ResidualNoise, scale: Tensor) -> NormalEquations:
    return linearise_pairs(problem.points, problem.target, T, affine, noise, scale, noise.outlier, problem.pixels)


def motion_prior_terms(xi_frame: Tensor, xi_predicted: Tensor, information: Tensor) -> tuple[Tensor, Tensor]:
    """Eq. (19). What the motion prior adds to the normal equations: Sigma_m^-1 and Sigma_m^-1 (x_{t-1} - x_t^(k)).

    xi_frame (..., 6): the frame's motion at this iteration, xi_predicted (..., 6): the previous frame's motion (both
    log(T_t T_{t-1}^-1), constant velocity), information (6, 6): Sigma_m^-1. The prior belongs to the cost that a step
    must lower, not to the entropy that is reported.
    """
    return information, (information @ (xi_predicted - xi_frame)[..., None])[..., 0]


def with_prior(system: NormalEquations, T: Tensor, affine: Tensor, prior: Prior) -> tuple[Tensor, Tensor, Tensor]:
    """H (B, 8, 8), b (B, 8) and energy (B,) of the measurements and the prior, at a pose and a brightness."""
    off = log(T @ inverse(prior.T_target_host))  # (B, 6), the frame's motion beyond the predicted one
    known, push = motion_prior_terms(off, torch.zeros_like(off), prior.information)
    off_affine = affine - prior.affine
    pull_affine = (prior.affine_information @ off_affine[..., None])[..., 0]
    H = system.H + pad(known, (0, 2, 0, 2)) + pad(prior.affine_information, (6, 0, 6, 0))
    b = system.b + torch.cat([push, -pull_affine], dim=-1)
    return H, b, system.energy - (off * push).sum(-1) + (off_affine * pull_affine).sum(-1)


def align(
    view: View, points: Points, coarse: Subset, fine: Subset, start: State, prior: MotionPrior, noise: Noise,
    steps: Array,
) -> Aligned:  # fmt: skip
    """Twin of kernels.tracking.align: a batch of one. The search starts at the prior's pose, as the tracker has it."""
    camera = pinhole(view.cameras[0], view.images[0])
    inverse_depth = inverse_of_depth(view.depth)[None]
    many, few = chosen(points, coarse.which), chosen(points, fine.which)
    sigma = noise_of_arrays(noise)
    problems = []
    for level in range(len(steps)):
        some, pixels = (many, coarse.pixels) if level else (few, fine.pixels)
        image = torch.from_numpy(view.images[level])
        if min(image.shape) < SMALLEST:  # no point is seen
            some = replace(some, inverse_depth=torch.zeros_like(some.inverse_depth))
            image = torch.zeros(SMALLEST, SMALLEST)
        problems.append(Problem(some, Target(level, image[None], camera, inverse_depth), int(steps[level]), pixels))
    known = Prior(
        inverse(matrix(prior.T_inverse)), matrix(prior.information), matrix(start.affine),
        matrix(prior.affine_information),
    )  # fmt: skip
    with torch.no_grad():
        found = descend(problems, known, sigma)
        T, affine = found.T_target_host, found.affine
        system = linearise_pairs(
            few, problems[0].target, T, affine, sigma, found.scale, sigma.outlier, problems[0].pixels
        )
    H = system.H[0]
    H[6:, 6:] += found.prior.affine_information[0]
    return Aligned(
        T[0].numpy(), affine[0].numpy(), H.numpy(), system.rms[0].numpy(), float(found.scale), int(found.iterations),
        int(system.seen.sum()), int(system.kept.sum()), float(found.change),
    )  # fmt: skip
