"""Eqs. 21 to 26: Schur complement against dense solutions, the linear prior by autograd, redundancy by brute force."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.func import hessian, jacfwd

from idrgbdo_torch.definitions.information import conditional_covariance, mutual_information_bits
from idrgbdo_torch.definitions.marginalization import (
    LinearPrior,
    marginalize,
    partition,
    prior_cost,
    prior_gradient,
    redundancy_bits,
    scaled_solve,
    schur_gradient,
    schur_information,
)

UNITS = torch.tensor([1e5, 1e5, 1e5, 3e4, 3e4, 3e4, 200.0, 0.1], dtype=torch.float64)  # 1 / sigma of a keyframe's state


def system(K: int = 3, seed: int = 0, unit: Tensor = UNITS) -> tuple[Tensor, Tensor]:
    """H and b of K keyframes of 8 numbers, in metres, radians and gray levels."""
    generator = torch.Generator().manual_seed(seed)
    n = K * len(unit)
    J = torch.randn(3 * n, n, generator=generator, dtype=torch.float64) * unit.repeat(K)
    return J.mT @ J, J.mT @ torch.randn(3 * n, generator=generator, dtype=torch.float64)


def some(n: int, *where: int) -> Tensor:
    mask = torch.zeros(n, dtype=torch.bool)
    mask[list(where)] = True
    return mask


MARGINAL = some(24, 0, 1, 2, 3, 4, 5, 6, 7, 15, 23)  # a whole keyframe and numbers in between


def test_partition_keeps_every_block() -> None:
    H, b = system()
    H_aa, H_ab, H_bb, b_a, b_b = partition(H, b, MARGINAL)
    order = torch.cat([(~MARGINAL).nonzero()[:, 0], MARGINAL.nonzero()[:, 0]])
    assert torch.equal(torch.cat([torch.cat([H_aa, H_ab], 1), torch.cat([H_ab.mT, H_bb], 1)]), H[order][:, order])
    assert torch.equal(torch.cat([b_a, b_b]), b[order])
    assert H_bb.shape == (10, 10)


def test_marginalising_does_not_change_the_step_of_the_kept() -> None:
    H, b = system()
    prior = marginalize(H, b, MARGINAL)
    dense = torch.linalg.solve(H, b)[~MARGINAL]
    torch.testing.assert_close(torch.linalg.solve(prior.H, prior.b), dense, rtol=1e-8, atol=0)


def test_marginalising_does_not_change_the_covariance_of_the_kept() -> None:
    H, b = system()
    expected = torch.linalg.inv(H)[~MARGINAL][:, ~MARGINAL]
    unit = expected.diagonal().rsqrt()
    mine = torch.linalg.inv(marginalize(H, b, MARGINAL).H)
    torch.testing.assert_close(unit[:, None] * mine * unit, unit[:, None] * expected * unit, rtol=0, atol=1e-10)


def test_one_by_one_is_all_at_once() -> None:
    """Ten eliminations in a row, with units eleven orders of magnitude apart, lose no digits that matter."""
    H, b = system()
    together = marginalize(H, b, MARGINAL)
    order = torch.cat([MARGINAL.nonzero()[:, 0], (~MARGINAL).nonzero()[:, 0]])
    step = LinearPrior(H[order][:, order], b[order])
    while len(step.b) > len(together.b):
        step = marginalize(step.H, step.b, some(len(step.b), 0))
    unit = together.H.diagonal().rsqrt()
    close = lambda x, y: torch.testing.assert_close(x, y, rtol=0, atol=1e-8 * float(y.abs().max()))
    close(unit[:, None] * step.H * unit, unit[:, None] * together.H * unit)
    close(unit * step.b, unit * together.b)


def test_the_quadratic_is_minimised_over_the_marginalised() -> None:
    """Eqs. 22 and 23 are what remains of the cost when the best beta is put in for every alpha."""
    H, b = system()
    prior = marginalize(H, b, MARGINAL)
    cost = lambda y: 0.5 * y @ H @ y - y @ b
    best = lambda alpha: torch.linalg.solve(H[MARGINAL][:, MARGINAL], b[MARGINAL] - H[MARGINAL][:, ~MARGINAL] @ alpha)
    generator = torch.Generator().manual_seed(1)
    values = []
    for _ in range(4):
        alpha = torch.randn(14, generator=generator, dtype=torch.float64) / UNITS.repeat(3)[~MARGINAL]
        y = torch.zeros(24, dtype=torch.float64)
        y[~MARGINAL], y[MARGINAL] = alpha, best(alpha)
        values.append(cost(y) - prior_cost(prior, alpha))
    torch.testing.assert_close(torch.stack(values), values[0].expand(4), rtol=1e-7, atol=0)


def test_the_result_is_symmetric_and_has_no_negative_direction() -> None:
    H, b = system()
    H[:, 9] = H[9] = 0.0  # a kept variable that nobody measures
    star = marginalize(H, b, MARGINAL).H
    assert torch.equal(star, star.mT)
    assert torch.linalg.eigvalsh(star).min() > -1e-9 * star.abs().max()
    none = torch.zeros(2, 0, dtype=torch.float64), torch.zeros(0, 0, dtype=torch.float64)
    for M, expected in (
        ([[2.0, 0.0], [0.0, -3.0]], [[2.0, 0.0], [0.0, 0.0]]),
        ([[2.0, 3.0], [3.0, 2.0]], [[2.5, 2.5], [2.5, 2.5]]),  # eigenvalues 5 and -1
    ):
        clipped = schur_information(torch.tensor(M).double(), *none)
        torch.testing.assert_close(clipped, torch.tensor(expected).double())


def test_an_unmeasured_variable_takes_nothing_along() -> None:
    """Zero rows in H_bb, as of a brightness that no point constrains, neither fail nor leave a trace."""
    H, b = system()
    for k in (3, 15):
        H[:, k] = H[k] = b[k] = 0.0
    known = MARGINAL & ~some(24, 3, 15)
    kept = ~some(24, 3, 15)
    expected = marginalize(H[kept][:, kept], b[kept], known[kept])
    prior = marginalize(H, b, MARGINAL)
    torch.testing.assert_close(prior.H, expected.H, rtol=1e-9, atol=1e-10 * float(expected.H.abs().max()))
    torch.testing.assert_close(prior.b, expected.b, rtol=1e-9, atol=1e-10 * float(expected.b.abs().max()))


def test_scaled_solve_of_very_different_units() -> None:
    unit = 10.0 ** torch.linspace(-6, 6, 8).double()
    H, b = system(1, unit=unit)
    x = scaled_solve(H, b[:, None])[:, 0]
    exact = scaled_solve(H / unit / unit[:, None], (b / unit)[:, None])[:, 0] / unit
    torch.testing.assert_close(x, exact, rtol=1e-9, atol=0)
    torch.testing.assert_close(H @ x / unit, b / unit, rtol=1e-9, atol=1e-9)


def test_units_do_not_matter_to_the_schur_complement() -> None:
    H, b = system()
    unit = UNITS.repeat(3)
    plain = marginalize(H / unit / unit[:, None], b / unit, MARGINAL)
    scaled = marginalize(H, b, MARGINAL)
    kept = unit[~MARGINAL]
    torch.testing.assert_close(scaled.H / kept / kept[:, None], plain.H, rtol=0, atol=1e-9 * float(plain.H.abs().max()))
    torch.testing.assert_close(scaled.b / kept, plain.b, rtol=0, atol=1e-9 * float(plain.b.abs().max()))


def test_gradient_without_coupling_is_unchanged() -> None:
    b_a, b_b = torch.randn(2, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    H_bb = torch.eye(4, dtype=torch.float64)
    assert torch.equal(schur_gradient(b_a, torch.zeros(4, 4, dtype=torch.float64), H_bb, b_b), b_a)


def test_prior_cost_and_gradient_belong_together() -> None:
    H, b = system(1)
    prior = LinearPrior(H, b)
    delta = torch.randn(8, generator=torch.Generator().manual_seed(2), dtype=torch.float64) / UNITS
    cost = lambda x: prior_cost(prior, x)
    torch.testing.assert_close(-jacfwd(cost)(delta), prior_gradient(prior, delta))
    torch.testing.assert_close(hessian(cost)(delta), H)
    assert prior_cost(prior, torch.zeros(8, dtype=torch.float64)) == 0
    # Eq. 25: seen from the moved state, the same quadratic up to a constant
    more = 0.3 * delta
    seen = 0.5 * more @ prior.H @ more - more @ prior_gradient(prior, delta)
    torch.testing.assert_close(cost(delta + more), cost(delta) + seen)
    best = torch.linalg.solve(H, b)
    assert (prior_gradient(prior, best).abs() < 1e-9 * b.abs()).all()


def brute_force_redundancy(information: Tensor) -> Tensor:
    """Eq. 26 by inverting everything: condition the pair on the rest (Eq. 14), mutual information of that (Eq. 15)."""
    K = len(information) // 6
    covariance = torch.linalg.inv(information)
    psi = torch.zeros(K, dtype=torch.float64)
    for j in range(K):
        for i in range(K):
            if i != j:
                rest = [k for k in range(K) if k not in (i, j)]
                order = torch.cat([torch.arange(6 * k, 6 * k + 6) for k in (i, j, *rest)])
                joint = covariance[order][:, order]
                pair = conditional_covariance(joint, 12) if rest else joint
                psi[j] += mutual_information_bits(pair, 6)
    return psi


@pytest.mark.parametrize("K", [2, 3, 5])
def test_redundancy_against_the_full_covariance(K: int) -> None:
    H, _ = system(K, unit=torch.ones(6, dtype=torch.float64))
    psi = redundancy_bits(H)
    assert psi.shape == (K,) and (psi > 0).all()
    torch.testing.assert_close(psi, brute_force_redundancy(H), rtol=1e-8, atol=0)


def test_redundancy_has_no_units() -> None:
    H, _ = system(4, unit=torch.ones(6, dtype=torch.float64))
    unit = torch.tensor([1e5, 1e5, 1e5, 57.3, 57.3, 57.3], dtype=torch.float64).repeat(4)
    torch.testing.assert_close(redundancy_bits(unit[:, None] * H * unit), redundancy_bits(H))


def test_redundancy_of_independent_keyframes_is_nothing() -> None:
    assert redundancy_bits(torch.eye(24, dtype=torch.float64)).abs().max() < 1e-12


def test_the_keyframe_tied_most_tightly_to_the_others_is_the_most_redundant() -> None:
    """A chain with one strong link: its two ends know most about each other, the loose end least."""
    tie = lambda K, i, j: torch.eye(K).double()[i] - torch.eye(K).double()[j]
    links = {(0, 1): 1.0, (1, 2): 10.0, (2, 3): 1.0, (3, 4): 0.1}
    L = 0.2 * torch.eye(5, dtype=torch.float64)
    for (i, j), strength in links.items():
        L = L + strength * torch.outer(tie(5, i, j), tie(5, i, j))
    psi = redundancy_bits(torch.kron(L, torch.eye(6, dtype=torch.float64)))
    assert sorted(psi.argsort()[-2:].tolist()) == [1, 2] and psi.argmin() == 4
