"""SE(3): group axioms over batch shapes, accuracy and gradients at 0 and near pi, against the matrix exponential."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.func import jacfwd, jacrev

from idrgbdo_torch.definitions import se3

SHAPES = st.lists(st.integers(1, 3), max_size=3).map(tuple)
SEEDS = st.integers(0, 2**31)
TOLERANCE = {torch.float32: 2e-5, torch.float64: 1e-12}


def twists(shape: tuple[int, ...], seed: int, angle: float = 3.0, dtype: torch.dtype = torch.float64) -> Tensor:
    """Random twists with translations of some metres and rotation angles up to `angle`."""
    generator = torch.Generator().manual_seed(seed)
    xi = torch.randn(*shape, 6, generator=generator, dtype=torch.float64)
    axis = xi[..., 3:] / xi[..., 3:].norm(dim=-1, keepdim=True)
    theta = angle * torch.rand(*shape, 1, generator=generator, dtype=torch.float64)
    return torch.cat([xi[..., :3], theta * axis], dim=-1).to(dtype)


def twist_matrix(xi: Tensor) -> Tensor:
    M = torch.zeros(4, 4, dtype=xi.dtype)
    M[:3, :3], M[:3, 3] = se3.hat(xi[3:]), xi[:3]
    return M


@settings(max_examples=40, deadline=None)
@given(SHAPES, SEEDS, st.sampled_from([torch.float32, torch.float64]))
def test_group_axioms(shape: tuple[int, ...], seed: int, dtype: torch.dtype) -> None:
    xi, yi, zi = (twists(shape, seed + k, dtype=dtype) for k in range(3))
    A, B, C = se3.exp(xi), se3.exp(yi), se3.exp(zi)
    tolerance = TOLERANCE[dtype]
    close = lambda x, y: torch.testing.assert_close(x, y, atol=tolerance * 10, rtol=tolerance * 10)
    eye = torch.eye(4, dtype=dtype).expand(*shape, 4, 4)
    assert A.shape == (*shape, 4, 4) and A.dtype == dtype
    close(A @ se3.inverse(A), eye)
    close(se3.inverse(A) @ A, eye)
    close((A @ B) @ C, A @ (B @ C))
    close(se3.exp(torch.zeros_like(xi)), eye)
    close(se3.log(A), xi)
    close(se3.exp(-xi), se3.inverse(A))
    close(se3.retract(xi, B), A @ B)
    close(A @ se3.exp(yi), se3.exp((se3.adjoint(A) @ yi[..., None])[..., 0]) @ A)
    close(se3.adjoint(A @ B), se3.adjoint(A) @ se3.adjoint(B))
    P = zi[..., :3]
    close(se3.transform(A, se3.transform(B, P)), se3.transform(A @ B, P))


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 1e-3, 0.1, 0.99, 1.0, 1.01, 2.0, 3.1, math.pi - 1e-7])
def test_exp_is_the_matrix_exponential_and_log_its_inverse(angle: float) -> None:
    for axis in (*torch.eye(3, dtype=torch.float64), torch.tensor([0.6, -0.64, 0.48], dtype=torch.float64)):
        xi = torch.cat([torch.tensor([0.3, -1.0, 2.0], dtype=torch.float64), angle * axis])
        torch.testing.assert_close(se3.exp(xi), torch.linalg.matrix_exp(twist_matrix(xi)), atol=1e-14, rtol=1e-13)
        torch.testing.assert_close(se3.log(se3.exp(xi)), xi, atol=1e-14, rtol=1e-12)


def test_log_at_pi_is_a_half_turn() -> None:
    for axis in (*torch.eye(3, dtype=torch.float64), torch.tensor([0.6, -0.64, 0.48], dtype=torch.float64)):
        T = se3.exp(torch.cat([torch.ones(3, dtype=torch.float64), math.pi * axis]))
        xi = se3.log(T)
        assert abs(float(xi[3:].norm()) - math.pi) < 1e-12
        torch.testing.assert_close(se3.exp(xi), T, atol=1e-12, rtol=0)


def test_log_keeps_small_motions_in_float32() -> None:
    xi = torch.tensor([1e-6, -2e-6, 3e-6, 1e-7, 2e-7, -3e-7])
    torch.testing.assert_close(se3.log(se3.exp(xi)), xi, rtol=1e-5, atol=0)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.02, 0.5, 1.5, 3.1, math.pi - 1e-4])
def test_gradients_are_finite_and_right(angle: float) -> None:
    axis = torch.tensor([0.6, -0.64, 0.48], dtype=torch.float64)
    xi = torch.cat([torch.tensor([0.3, -1.0, 2.0], dtype=torch.float64), angle * axis])
    round_trip = lambda x: se3.log(se3.exp(x))
    for jacobian in (jacfwd, jacrev):
        torch.testing.assert_close(jacobian(round_trip)(xi), torch.eye(6, dtype=torch.float64), atol=1e-9, rtol=0)


def test_derivative_of_a_moved_point() -> None:
    T = se3.exp(twists((), 3))
    P = torch.tensor([0.2, -0.4, 1.5], dtype=torch.float64)
    J = jacfwd(lambda xi: se3.transform(se3.retract(xi, T), P))(torch.zeros(6, dtype=torch.float64))
    moved = se3.transform(T, P)
    torch.testing.assert_close(J, torch.cat([torch.eye(3, dtype=torch.float64), -se3.hat(moved)], dim=-1))


def test_hat_is_the_cross_product() -> None:
    a, b = twists((5,), 1)[..., :3], twists((5,), 2)[..., :3]
    torch.testing.assert_close((se3.hat(a) @ b[..., None])[..., 0], torch.linalg.cross(a, b))
