"""Pose tracking of B frame pairs at once (section 4.2): coarse to fine, damped Gauss-Newton, robust."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn.functional import pad

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
from .convert import SMALLEST, Array, chosen, inverse_of_depth, matrix, noise_of_arrays, pinhole
from .linearise import NormalEquations, ResidualNoise, Target, linearise_pairs, robust_scale
from .points import HostPoints
from .se3 import inverse, log, retract
from .solver import brightness_information, nothing_left, solve

STEPS = (8, 10, 12, 12)  # most iterations per level, finest first
NOTHING = torch.zeros(0)
AFFINE_SIGMA = (0.1, 10.0)  # of gain and gray levels, about the guess


@dataclass(frozen=True)
class Prior:
    """What is known of B pairs beforehand: Gaussians about a pose and a brightness."""

    T_target_host: Tensor  # (B, 4, 4) float64
    information: Tensor  # (B, 6, 6) of a left increment of it
    affine: Tensor  # (B, 2)
    affine_information: Tensor  # (B, 2, 2)


@dataclass(frozen=True)
class Heard:
    """What the points of one level say of B poses: normal equations about where their search ended."""

    T_target_host: Tensor  # (B, 4, 4) float64
    H: Tensor  # (B, 6, 6) of a left increment
    b: Tensor  # (B, 6)


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
    heard: Heard | None = None  # what level 1 says of the pose, where it counts on the finest too


def prior_at(T_target_host: Tensor, information: Tensor | None = None, affine: Tensor | None = None) -> Prior:
    """What is known of B pairs beforehand: a Gaussian about poses (B, 4, 4) and brightness.

    information: (6, 6) or (B, 6, 6) of a left increment of the pose, none by default. affine: (B, 2), the brightness of
    the target relative to the host, the same by default; it is held to AFFINE_SIGMA about that.
    """
    B = len(T_target_host)
    T = T_target_host.double()
    known = T.new_zeros(6, 6) if information is None else information
    brightness = T.new_zeros(B, 2) if affine is None else affine
    spread = torch.diag(T.new_tensor(AFFINE_SIGMA) ** -2).expand(B, 2, 2)
    return Prior(T, known.double().expand(B, 6, 6), brightness.double(), spread)


@dataclass(frozen=True)
class Found:
    """Where a search has got to."""

    T: Tensor  # (B, 4, 4)
    affine: Tensor  # (B, 2)
    iterations: Tensor  # (B,) so far
    change: Tensor  # (B,) the last step in standard deviations
    rms: Tensor = NOTHING  # (B, N) of the points at the last pose that was tried
    H: Tensor = NOTHING  # (B, 8, 8) at the pose, prior included


# one round on one level: problem, start, prior, noise, robust scale (B,), what settles it, what level 1 said
Search = Callable[[Problem, Found, Prior, ResidualNoise, Tensor, float, Heard | None], Found]


def descend(
    problems: Sequence[Problem], prior: Prior, noise: ResidualNoise, coarse: float = 0.0, by: Search | None = None
) -> Estimate:
    """Damped Gauss-Newton from the prior's pose over the levels, finest first in `problems`, coarsest first in time.

    Each pair has its own damping, and rests once it has settled. A level takes the scale of its residuals from the one
    before; the finest has other points, so it finds its own, and a second round works with the outlier limit from the
    first. The brightness that the many points of level 1 agree on is the prior of the finest. coarse: the share of what
    they say of the pose that counts there too. by: what searches, search() by default.
    """
    by = by or search
    B, last = len(prior.affine), len(problems) - 1
    nothing = prior.affine.new_zeros(B)
    found = Found(prior.T_target_host, prior.affine, nothing.long(), nothing)
    scale = prior.affine.new_ones(B)
    heard = None
    for level in reversed(range(len(problems))):
        problem = problems[level]
        if level in (0, last):  # other points, or none so far to tell the scale
            start, every = replace(problem, steps=0), replace(noise, outlier=float("inf"))
            found = replace(found, rms=by(start, found, prior, every, torch.ones_like(scale), 0.0, None).rms)
        for settled in SETTLED if level == 0 else (SETTLED_COARSE,):
            scale = robust_scale(found.rms)
            found = by(problem, found, prior, noise, scale, settled, heard)
        if level == 1:
            if coarse > 0:
                system = _system(problem, found.T, found.affine, noise, scale)
                heard = heard_of_pose(system, found.T, found.affine, prior, coarse)
            learnt = brightness_information(found.H, prior.affine_information)
            prior = replace(prior, affine=found.affine, affine_information=learnt)
    return Estimate(found.T, found.affine, prior, scale, found.iterations, found.change, heard)


def search(
    problem: Problem, start: Found, prior: Prior, noise: ResidualNoise, scale: Tensor, settled: float,
    heard: Heard | None,
) -> Found:  # fmt: skip
    """One round on one level. With no steps it only says what the points' residuals are at the start."""
    T, affine, change, count = start.T, start.affine, start.change, start.iterations
    system = _system(problem, T, affine, noise, scale)
    H, b, energy = with_heard(with_prior(system, T, affine, prior), T, heard)
    rms, seen = system.rms, system.seen.sum(-1)
    eye = torch.eye(8, dtype=H.dtype, device=H.device)
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
        H_new, b_new, energy_new = with_heard(with_prior(system, T_new, affine_new, prior), T_new, heard)
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
        if nothing_left(active):
            break
    return Found(T, affine, count, change, rms, H)


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


def heard_of_pose(system: NormalEquations, T: Tensor, affine: Tensor, prior: Prior, share: float) -> Heard:
    """A share of what measurements say of poses, with brightness and its prior marginalised (the motion prior is not
    in it: it counts on every level of its own).
    """
    H, b, _ = with_prior(system, T, affine, replace(prior, information=torch.zeros_like(prior.information)))
    across = torch.linalg.solve(H[:, 6:, 6:], H[:, 6:, :6]).mT  # (B, 6, 2)
    about_pose = H[:, :6, :6] - across @ H[:, 6:, :6]
    return Heard(T, share * about_pose, share * (b[:, :6] - (across @ b[:, 6:, None])[..., 0]))


def with_heard(
    equations: tuple[Tensor, Tensor, Tensor], T: Tensor, heard: Heard | None
) -> tuple[Tensor, Tensor, Tensor]:
    """H, b and energy (B,), up to a constant, at poses T (B, 4, 4), and what another level said of them."""
    if heard is None:
        return equations
    H, b, energy = equations
    off = log(T @ inverse(heard.T_target_host))
    pull = (heard.H @ off[..., None])[..., 0]
    b = b + pad(heard.b - pull, (0, 2))
    return H + pad(heard.H, (0, 2, 0, 2)), b, energy + ((pull - 2 * heard.b) * off).sum(-1)


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
        found = descend(problems, known, sigma, noise.coarse)
        T, affine = found.T_target_host, found.affine
        system = linearise_pairs(
            few, problems[0].target, T, affine, sigma, found.scale, sigma.outlier, problems[0].pixels
        )
    H = system.H[0]
    H[6:, 6:] += found.prior.affine_information[0]
    if found.heard is not None:
        H[:6, :6] += found.heard.H[0]
    return Aligned(
        T[0].numpy(), affine[0].numpy(), H.numpy(), system.rms[0].numpy(), float(found.scale), int(found.iterations),
        int(system.seen.sum()), int(system.kept.sum()), float(found.change), found.prior.affine[0].numpy(),
        found.prior.affine_information[0].numpy(),
    )  # fmt: skip
