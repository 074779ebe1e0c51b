"""Keyframe marginalisation (section 5.2): Schur complement, linearised prior, redundancy by mutual information."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .information import cholesky, mutual_information_bits


def partition(H: Tensor, b: Tensor, marginal: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Eq. (21). The normal equations H (n, n) y = b (n,) split into kept (alpha) and marginalised (beta) blocks.

    marginal: (n,) bool, true for beta. Returns H_aa, H_ab, H_bb, b_a, b_b.
    """
    keep = ~marginal
    return H[keep][:, keep], H[keep][:, marginal], H[marginal][:, marginal], b[keep], b[marginal]


def schur_information(H_aa: Tensor, H_ab: Tensor, H_bb: Tensor) -> Tensor:
    """Eq. (22). H*_a = H_aa - H_ab H_bb^-1 H_ba, symmetric, negative eigenvalues clipped to zero.

    Computed on matrices of unit diagonal, because metres, radians and gray levels differ by many orders of magnitude.
    """
    H_star = H_aa - H_ab @ scaled_solve(H_bb, H_ab.mT)
    scale = to_unit_diagonal(H_star)
    unit = scale[:, None] * H_star * scale
    unit = 0.5 * (unit + unit.mT)
    if torch.linalg.cholesky_ex(unit).info == 0:  # positive definite, as it nearly always is: nothing to clip
        return 0.5 * (H_star + H_star.mT)
    eigenvalues, vectors = torch.linalg.eigh(unit)
    back = torch.where(scale > 0.0, 1.0 / scale, 0.0)
    clipped: Tensor = back[:, None] * ((vectors * eigenvalues.clamp(min=0.0)) @ vectors.mT) * back
    return 0.5 * (clipped + clipped.mT)


def schur_gradient(b_a: Tensor, H_ab: Tensor, H_bb: Tensor, b_b: Tensor) -> Tensor:
    """Eq. (23). b*_a = b_a - H_ab H_bb^-1 b_b."""
    return b_a - H_ab @ scaled_solve(H_bb, b_b[:, None])[:, 0]


def scaled_solve(A: Tensor, B: Tensor) -> Tensor:
    """A^-1 B of a symmetric positive semi-definite A (n, n), scaled to unit diagonal; pseudo-inverse if singular."""
    scale = to_unit_diagonal(A)
    unit, right = scale[:, None] * A * scale, scale[:, None] * B
    factor, info = torch.linalg.cholesky_ex(unit)
    if info == 0 and (factor.diagonal() > 1e-6).all():
        solution = torch.cholesky_solve(right, factor)
    else:
        solution = torch.linalg.pinv(unit, rtol=1e-12, hermitian=True) @ right
    return scale[:, None] * solution


def to_unit_diagonal(A: Tensor) -> Tensor:
    """The factors (n,) that scale rows and columns of A (n, n) to a diagonal of ones; 0 where nothing is known."""
    return torch.where(A.diagonal() > 1e-12, A.diagonal(), torch.inf).rsqrt()


@dataclass(frozen=True)
class LinearPrior:
    """What marginalised variables still say of the kept ones, a quadratic about a fixed linearisation point."""

    H: Tensor  # (n, n) float64
    b: Tensor  # (n,) float64, at the linearisation point


def prior_cost(prior: LinearPrior, delta: Tensor) -> Tensor:
    """Eq. (24). 1/2 delta^T H* delta - delta^T b*, at the deviation delta (n,) from the linearisation point."""
    return 0.5 * delta @ prior.H @ delta - delta @ prior.b


def prior_gradient(prior: LinearPrior, delta: Tensor) -> Tensor:
    """Eq. (25). The same quadratic seen from the state delta (n,): b* - H* delta; H* stays (first estimates)."""
    return prior.b - prior.H @ delta


def marginalize(H: Tensor, b: Tensor, marginal: Tensor) -> LinearPrior:
    """Marginalise the variables where `marginal` (n,) is true; the rest keeps its order (Eqs. 21 to 23)."""
    H_aa, H_ab, H_bb, b_a, b_b = partition(H, b, marginal)
    return LinearPrior(schur_information(H_aa, H_ab, H_bb), schur_gradient(b_a, H_ab, H_bb, b_b))


def redundancy_bits(information: Tensor) -> Tensor:
    """Eq. (26). psi(K_j) = sum_i MI(i, j | the rest) of keyframe poses, (K,) bits, from their (6K, 6K) information.

    The conditional covariance of a pair given the rest is the inverse of the pair's block of the information matrix;
    Eq. 15 of it is the mutual information. i = j is left out. (The twin inverts nothing: of a pair with information
    [[A, B], [B^T, D]] it is 1/2 log2(|A| |D| / |[[A, B], [B^T, D]]|), by the determinants of a block inverse.)
    """
    K = information.shape[0] // 6
    scale = information.diagonal().rsqrt()  # mutual information knows no units, so scale them away
    blocks = (scale[:, None] * information * scale).reshape(K, 6, K, 6).permute(0, 2, 1, 3)  # (K, K, 6, 6)
    i, j = torch.triu_indices(K, K, offset=1, device=information.device)
    top = torch.cat([blocks[i, i], blocks[i, j]], dim=-1)  # (M, 6, 12)
    bottom = torch.cat([blocks[j, i], blocks[j, j]], dim=-1)
    pair = cholesky(torch.cat([top, bottom], dim=-2), "information, the block of two keyframes")
    mutual = mutual_information_bits(torch.cholesky_inverse(pair), 6)
    return information.new_zeros(K).index_add(0, i, mutual).index_add(0, j, mutual)
