"""Pose tracking in torch: twin of kernels.alignment, a batch of one through idrgbdo_torch.alignment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch

from ..alignment import Prior, Problem, descend
from ..batched import Target, linearise_pairs
from ..batched import robust_scale as batched_scale
from ..kernels.model import Noise, Points
from ..se3 import inverse
from .convert import SMALLEST, Array, chosen, inverse_of_depth, matrix, pinhole, residual_noise


def align(
    images: Sequence[Array], depth: Array, cams: Array, points: Points, index_coarse: Array, pixels_coarse: int,
    index_fine: Array, T0: Array, affine0: Array, prior: Array, T_prior_inv: Array, affine_prior: Array, noise: Noise,
    steps: Array,
) -> tuple[Array, Array, Array, Array, float, int, int, int, float]:  # fmt: skip
    """Twin of kernels.alignment.align, with its arguments and results.

    One difference: T_prior_inv is the inverse of T0 in every use, and the search starts at the prior's pose.
    """
    camera = pinhole(cams[0], images[0])
    inverse_depth = inverse_of_depth(depth)[None]
    coarse, fine = chosen(points, index_coarse), chosen(points, index_fine)
    sigma = residual_noise(noise)
    problems = []
    for level in range(len(steps)):
        some, pixels = (coarse, pixels_coarse) if level else (fine, points.patch.shape[2])
        image = torch.from_numpy(images[level])
        if min(image.shape) < SMALLEST:  # no point is seen
            some = replace(some, inverse_depth=torch.zeros_like(some.inverse_depth))
            image = torch.zeros(SMALLEST, SMALLEST)
        problems.append(Problem(some, Target(level, image[None], camera, inverse_depth), int(steps[level]), pixels))
    known = Prior(inverse(matrix(T_prior_inv)), matrix(prior), matrix(affine0), matrix(affine_prior))
    with torch.no_grad():
        found = descend(problems, known, sigma)
        T, affine = found.T_target_host, found.affine
        system = linearise_pairs(
            fine, problems[0].target, T, affine, sigma, found.scale, sigma.outlier, problems[0].pixels
        )
    H = system.H[0]
    H[6:, 6:] += found.prior.affine_information[0]
    return (
        T[0].numpy(), affine[0].numpy(), H.numpy(), system.rms[0].numpy(), float(found.scale), int(found.iterations),
        int(system.seen.sum()), int(system.kept.sum()), float(found.change),
    )  # fmt: skip


def robust_scale(rms: Array) -> float:
    """Twin of kernels.alignment.robust_scale."""
    return float(batched_scale(torch.from_numpy(rms)[None]))
