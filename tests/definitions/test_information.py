"""Information measures against numerical integration, closed forms, sampling and autograd."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.func import jacfwd

from idrgbdo_torch.definitions.information import (
    conditional_covariance,
    entropy_bits,
    entropy_reduction_bits,
    information_from_rows,
    log2_det,
    mutual_information_bits,
    split_joint,
)
from idrgbdo_torch.errors import IdRgbdoError


def covariance(*shape: int, size: int = 6, seed: int = 0) -> Tensor:
    A = torch.randn(*shape, size, size + 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return A @ A.mT


def test_entropy_is_the_integral_of_the_density() -> None:
    sigma = 0.37
    x = torch.linspace(-12 * sigma, 12 * sigma, 20001, dtype=torch.float64)
    p = torch.exp(-0.5 * (x / sigma) ** 2) / (sigma * math.sqrt(2 * math.pi))
    integral = torch.trapezoid(-p * torch.log2(p), x)
    torch.testing.assert_close(entropy_bits(torch.tensor([[sigma**2]])), integral, atol=1e-6, rtol=0)


def test_entropy_adds_over_independent_parts_and_batches() -> None:
    S = covariance(2, 3)
    H = entropy_bits(S)
    assert H.shape == (2, 3) and H.dtype == torch.float64
    joint = torch.block_diag(S[0, 0], S[1, 2])
    torch.testing.assert_close(entropy_bits(joint), H[0, 0] + H[1, 2])
    torch.testing.assert_close(entropy_bits(4 * S), H + 6)  # twice the standard deviation: a bit for each dimension
    assert entropy_bits(S.float()).dtype == torch.float64


def test_entropy_reduction() -> None:
    X, Y = covariance(4), covariance(4, seed=1)
    torch.testing.assert_close(entropy_reduction_bits(X, Y), entropy_bits(X) - entropy_bits(Y))
    torch.testing.assert_close(entropy_reduction_bits(X, X / 4), torch.full((4,), 6.0, dtype=torch.float64))


def test_split_joint_covers_the_matrix() -> None:
    joint = covariance(3, size=8)
    xx, xy, yx, yy = split_joint(joint, 3)
    assert xx.shape == (3, 3, 3) and yy.shape == (3, 5, 5)
    torch.testing.assert_close(torch.cat([torch.cat([xx, xy], -1), torch.cat([yx, yy], -1)], -2), joint)
    for n in (0, 8, 9):
        with pytest.raises(IdRgbdoError, match="joint"):
            split_joint(joint, n)


def test_conditional_covariance_is_the_inverse_of_the_information_block() -> None:
    joint = covariance(5, size=8)
    conditional = conditional_covariance(joint, 3)
    torch.testing.assert_close(conditional, torch.linalg.inv(torch.linalg.inv(joint)[..., :3, :3]))
    torch.testing.assert_close(conditional, conditional.mT, atol=0, rtol=0)


def test_mutual_information_of_two_correlated_scalars() -> None:
    for rho in (0.0, 0.5, -0.99):
        joint = torch.tensor([[4.0, 2 * 3 * rho], [2 * 3 * rho, 9.0]], dtype=torch.float64)
        assert float(mutual_information_bits(joint, 1)) == pytest.approx(-0.5 * math.log2(1 - rho**2), abs=1e-12)


def test_mutual_information_is_symmetric_and_the_missing_entropy() -> None:
    joint = covariance(4, size=7)
    MI = mutual_information_bits(joint, 3)
    order = [3, 4, 5, 6, 0, 1, 2]
    torch.testing.assert_close(MI, mutual_information_bits(joint[:, order][:, :, order], 4))
    xx, _, _, yy = split_joint(joint, 3)
    torch.testing.assert_close(MI, entropy_bits(xx) + entropy_bits(yy) - entropy_bits(joint))
    assert (MI > 0).all()


def test_information_is_the_sum_over_rows() -> None:
    generator = torch.Generator().manual_seed(0)
    j = torch.randn(2, 20, 6, generator=generator, dtype=torch.float64)
    variance = torch.rand(2, 20, generator=generator, dtype=torch.float64) + 0.1
    total = torch.zeros(2, 6, 6, dtype=torch.float64)
    for batch in range(2):
        for row, v in zip(j[batch], variance[batch], strict=True):
            total[batch] += torch.outer(row, row) / v
    torch.testing.assert_close(information_from_rows(j, variance), total)
    variance[:, 5:] = math.inf
    torch.testing.assert_close(information_from_rows(j, variance), information_from_rows(j[:, :5], variance[:, :5]))


def test_information_is_the_inverse_covariance_of_least_squares() -> None:
    generator = torch.Generator().manual_seed(3)
    j = torch.randn(12, 3, generator=generator, dtype=torch.float64)
    sigma = torch.rand(12, generator=generator, dtype=torch.float64) + 0.5
    information = information_from_rows(j, sigma**2)
    r = sigma[:, None] * torch.randn(12, 100_000, generator=generator, dtype=torch.float64)
    x = torch.linalg.solve(information, j.mT @ (r / sigma[:, None] ** 2))
    torch.testing.assert_close(torch.cov(x), torch.linalg.inv(information), rtol=0.05, atol=0.002)


def test_huge_determinants_do_not_overflow() -> None:
    torch.testing.assert_close(
        log2_det(2.0**200 * torch.eye(6, dtype=torch.float64)), torch.tensor(1200.0, dtype=torch.float64)
    )


def test_gradient_of_the_entropy_is_the_inverse() -> None:
    S = covariance()
    expected = 0.5 / math.log(2) * torch.linalg.inv(S)
    x = S.clone().requires_grad_()
    entropy_bits(x).backward()
    torch.testing.assert_close(x.grad, expected)
    directional = jacfwd(lambda t: entropy_bits(S + t * torch.eye(6, dtype=torch.float64)))(torch.zeros(()).double())
    torch.testing.assert_close(directional, expected.trace())


def test_matrices_that_are_not_covariances_say_so() -> None:
    with pytest.raises(IdRgbdoError, match="covariance: expected positive definite"):
        entropy_bits(torch.diag(torch.tensor([1.0, -1.0])))
    with pytest.raises(IdRgbdoError, match="covariance: expected finite"):
        entropy_bits(torch.full((2, 2), math.nan))
    j = torch.tensor([[1.0, 2.0, 3.0], [0.3, -0.1, 0.7]], dtype=torch.float64)
    with pytest.raises(IdRgbdoError, match="positive definite"):  # of rank 2, whatever rounding makes of it
        log2_det(information_from_rows(j, torch.ones(2)))
    with pytest.raises(IdRgbdoError, match="joint, block yy"):
        conditional_covariance(torch.diag(torch.tensor([1.0, 0.0])), 1)
