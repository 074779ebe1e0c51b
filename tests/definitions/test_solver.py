"""Normal equations against least squares, robust weights against autograd, and failures that come back as values."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.func import jacfwd, vmap

from idrgbdo_torch.definitions.solver import huber_weight, normal_equations, robust_cost, solve


def system(*shape: int, n: int = 40, m: int = 6) -> tuple[Tensor, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(0)
    J = torch.randn(*shape, n, m, generator=generator, dtype=torch.float64)
    r = torch.randn(*shape, n, generator=generator, dtype=torch.float64)
    weight = torch.rand(*shape, n, generator=generator, dtype=torch.float64) + 0.1
    return J, r, weight


def test_step_is_the_weighted_least_squares_solution() -> None:
    J, r, weight = system(2, 3)
    H, b = normal_equations(J, r, weight)
    solution = solve(H, b)
    root = weight.sqrt()
    expected = torch.linalg.lstsq(root[..., None] * J, -(root * r)[..., None]).solution[..., 0]
    torch.testing.assert_close(solution.y, expected)
    assert solution.ok.shape == (2, 3) and solution.ok.all() and solution.reason == ""


def test_step_minimises_the_quadratic_cost() -> None:
    J, r, weight = system()
    H, b = normal_equations(J, r, weight)
    cost = lambda y: 0.5 * (weight * (r + J @ y) ** 2).sum()
    torch.testing.assert_close(jacfwd(cost)(torch.zeros(6, dtype=torch.float64)), -b)
    torch.testing.assert_close(jacfwd(jacfwd(cost))(torch.zeros(6, dtype=torch.float64)), H)
    assert jacfwd(cost)(solve(H, b).y).abs().max() < 1e-12


def test_prior_acts_like_more_rows_and_float32_is_summed_in_float64() -> None:
    J, r, weight = system()
    prior = normal_equations(J[30:], r[30:], weight[30:])
    H, b = normal_equations(J[:30], r[:30], weight[:30], prior)
    torch.testing.assert_close((H, b), normal_equations(J, r, weight))
    H32, _ = normal_equations(J.float(), r.float(), weight.float())
    assert H32.dtype == torch.float64
    torch.testing.assert_close(
        H32, normal_equations(J.float().double(), r.float().double(), weight.float().double())[0]
    )


def test_damping_shortens_towards_scaled_steepest_descent() -> None:
    H, b = normal_equations(*system())
    dense = torch.linalg.solve(H + 0.7 * torch.diag(H.diagonal()), b)
    torch.testing.assert_close(solve(H, b, damping=0.7).y, dense)
    torch.testing.assert_close(1e9 * solve(H, b, damping=1e9).y, b / H.diagonal(), rtol=1e-6, atol=0)
    pair = solve(H.expand(2, 6, 6), b.expand(2, 6), damping=torch.tensor([0.0, 0.7]).double())
    torch.testing.assert_close(pair.y, torch.stack([solve(H, b).y, dense]), rtol=1e-6, atol=1e-9)


def test_units_do_not_matter() -> None:
    J, r, weight = system()
    scale = torch.tensor([1e-8, 1.0, 1e8, 1e4, 1e-4, 1.0], dtype=torch.float64)
    y = solve(*normal_equations(J, r, weight)).y
    scaled = solve(*normal_equations(J * scale, r, weight))
    assert scaled.ok
    torch.testing.assert_close(scaled.y * scale, y)


def test_singular_systems_are_a_value_with_a_sentence() -> None:
    J, r, weight = system(3)
    J[1, :, 2] = J[1, :, 3] - 2 * J[1, :, 0]
    J[2, :, 4] = 0
    solution = solve(*normal_equations(J, r, weight))
    assert solution.ok.tolist() == [True, False, False]
    assert (solution.y[1:] == 0).all() and (solution.y[0] != 0).all()
    assert "singular" in solution.reason
    damped = solve(*normal_equations(J[1], r[1], weight[1]), damping=1e-3)
    assert damped.ok
    empty = solve(*normal_equations(J[0, :0], r[0, :0], weight[0, :0]))
    assert not empty.ok and "singular" in empty.reason
    indefinite = solve(torch.diag(torch.tensor([1.0, -1.0])), torch.ones(2))
    assert not indefinite.ok


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_values_that_are_not_finite_are_a_value_with_a_sentence(bad: float) -> None:
    H, b = normal_equations(*system(2))
    H[0, 1, 1] = bad
    solution = solve(H, b)
    assert solution.ok.tolist() == [False, True] and "not finite" in solution.reason
    assert torch.isfinite(solution.y).all()
    b[1, 0] = bad
    assert not solve(H, b).ok.any() and torch.isfinite(solve(H, b).y).all()


def test_solution_is_differentiable() -> None:
    H, b = normal_equations(*system())
    b.requires_grad_()
    solve(H, b).y.sum().backward()
    torch.testing.assert_close(b.grad, torch.linalg.solve(H, torch.ones(6, dtype=torch.float64)))


def test_weight_is_the_derivative_of_the_cost() -> None:
    r = torch.tensor([-30.0, -19.0, -9.1, -9.0, -1.0, 0.5, 8.9, 12.0, 21.0], dtype=torch.float64)
    slope = vmap(jacfwd(lambda x: robust_cost(x, 9.0, 20.0)))(r)
    torch.testing.assert_close(huber_weight(r, 9.0, 20.0) * r, slope)
    torch.testing.assert_close(huber_weight(torch.tensor([0.0, 18.0, 90.0]), 9.0), torch.tensor([1.0, 0.5, 0.1]))


def test_cost_is_quadratic_then_linear_then_flat() -> None:
    r = torch.tensor([0.0, 3.0, -9.0, 10.0, -20.0, 21.0, 1e6], dtype=torch.float64)
    expected = torch.tensor([0.0, 4.5, 40.5, 49.5, 139.5, 139.5, 139.5], dtype=torch.float64)
    torch.testing.assert_close(robust_cost(r, 9.0, 20.0), expected)
    assert robust_cost(r, 9.0)[-1] == 9 * (1e6 - 4.5)
