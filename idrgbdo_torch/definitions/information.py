"""Information of Gaussians in bits, batched over (..., k, k) matrices (paper, section 3.2). Computed in float64.

Determinants go through Cholesky factors, so that |Lambda| may be 1e41. A matrix that is not positive definite is an
IdRgbdoError that names it.
"""

from __future__ import annotations

from math import e, log2, pi

import torch
from torch import Tensor

from ..errors import IdRgbdoError, door


@door
def entropy_bits(covariance: Tensor) -> Tensor:
    """Eq. (11). H(X) = 1/2 log2((2 pi e)^k |Sigma_X|) (...) in bits, from a covariance (..., k, k)."""
    k = covariance.shape[-1]
    return 0.5 * (k * log2(2 * pi * e) + log2_det(covariance, "covariance"))


@door
def entropy_reduction_bits(covariance_x: Tensor, covariance_y: Tensor) -> Tensor:
    """Eq. (12). Delta H(X, Y) = H(X) - H(Y) = 1/2 log2(|Sigma_X| / |Sigma_Y|) (...) in bits: positive if Y is surer."""
    return 0.5 * (log2_det(covariance_x, "covariance_x") - log2_det(covariance_y, "covariance_y"))


def split_joint(joint: Tensor, n: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Eq. (13). Sigma_Z = [[Sigma_xx, Sigma_xy], [Sigma_yx, Sigma_yy]]: the blocks in this order, x the first n."""
    if joint.shape[-1] != joint.shape[-2] or not 0 < n < joint.shape[-1]:
        raise IdRgbdoError(
            f"joint: expected a square matrix of more than n = {n} > 0 rows, got shape {tuple(joint.shape)}; "
            "n counts the rows of x"
        )
    return joint[..., :n, :n], joint[..., :n, n:], joint[..., n:, :n], joint[..., n:, n:]


@door
def conditional_covariance(joint: Tensor, n: int) -> Tensor:
    """Eq. (14). Sigma_x* = Sigma_xx - Sigma_xy Sigma_yy^-1 Sigma_yx (..., n, n), of the first n given the rest."""
    xx, xy, yx, yy = split_joint(joint.double(), n)
    conditional = xx - xy @ torch.cholesky_solve(yx, cholesky(yy, "joint, block yy"))
    return 0.5 * (conditional + conditional.mT)


@door
def mutual_information_bits(joint: Tensor, n: int) -> Tensor:
    """Eq. (15). MI(x, y) = 1/2 log2(|Sigma_xx| / |Sigma_x*|) (...) in bits, x the first n variables of the joint."""
    xx, _, _, _ = split_joint(joint, n)
    return 0.5 * (log2_det(xx, "joint, block xx") - log2_det(conditional_covariance(joint, n), "joint"))


@door
def information_from_rows(j: Tensor, variance: Tensor) -> Tensor:
    """Eq. (16). Lambda_x = sum over p of j_p^T sigma_p^-2 j_p (..., m, m), rows j (..., N, m), variance (..., N).

    A row of infinite variance counts nothing, which is how to mask one.
    """
    j, variance = j.double(), variance.double()
    return j.mT @ (variance.reciprocal()[..., None] * j)


def freedom_entropies_bits(information: Tensor) -> Tensor:
    """Entropy (..., m) in bits of each variable given the others, from their information (..., m, m).

    The paper's H* (section 5.1): Eq. 11 of Eq. 14's conditional covariance, one variable after the other. It equals
    Eq. 11 of 1 / Lambda_kk, which is what runs where the information cannot be inverted; infinite without information.
    """
    information = information.double()
    precision = information.diagonal(dim1=-2, dim2=-1)
    known = precision > 0
    conditional = torch.where(known, precision, 1.0).reciprocal()
    scale = conditional.sqrt()
    unit = scale[..., :, None] * information * scale[..., None, :]
    factor, failed = torch.linalg.cholesky_ex(unit)
    if bool(known.all() & (failed == 0).all() & (factor.diagonal(dim1=-2, dim2=-1) > 1e-4).all()):
        joint = scale[..., :, None] * torch.cholesky_inverse(factor) * scale[..., None, :]
        m = precision.shape[-1]
        turns = [[k, *(other for other in range(m) if other != k)] for k in range(m)]  # the variable, then the rest
        blocks = [conditional_covariance(joint[..., turn, :][..., turn], 1)[..., 0, 0] for turn in turns]
        conditional = torch.stack(blocks, dim=-1)
    return torch.where(known, entropy_bits(conditional[..., None, None]), torch.inf)


def log2_det(matrix: Tensor, name: str = "matrix") -> Tensor:
    """log2 |M| (...) of positive definite M (..., k, k), float64."""
    return 2 * cholesky(matrix, name).diagonal(dim1=-2, dim2=-1).log2().sum(-1)


def cholesky(matrix: Tensor, name: str = "matrix") -> Tensor:
    """Lower Cholesky factor (..., k, k) in float64 of a symmetric positive definite matrix."""
    matrix = matrix.double()
    if not bool(torch.isfinite(matrix).all()):
        raise IdRgbdoError(f"{name}: expected finite values, got some that are not; check what it was made from")
    factor: Tensor
    factor, failed = torch.linalg.cholesky_ex(matrix)
    pivots, diagonal = (M.diagonal(dim1=-2, dim2=-1) for M in (factor, matrix))
    rounding = matrix.shape[-1] * torch.finfo(matrix.dtype).eps
    if bool((failed != 0).any()) or bool((pivots.square() <= rounding * diagonal).any()):
        raise IdRgbdoError(
            f"{name}: expected positive definite {tuple(matrix.shape)}, got one with a direction of no or negative "
            "variance or information; add a prior or more measurements"
        )
    return factor
