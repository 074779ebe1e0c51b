"""The solution of b(x, theta) = 0 as a function of theta, for autograd: the implicit function theorem."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from .solver import nothing_left, solve

STEPS = 8  # at most, from where a search settled to where nothing moves
STILL = 1e-20  # squared standard deviations; a smaller step is rounding


def implicit_root(equation: Callable[[Tensor], tuple[Tensor, Tensor]], x: Tensor) -> Tensor:
    """B roots (B, n) near x, with dx/dtheta = -(db/dx)^-1 db/dtheta for whatever theta the equation was made of.

    equation: for x (B, n), the normal equations' H (B, n, n) and right-hand side b (B, n), whose root is meant; that of
    a pair depends on its own x alone. db/dx is not -H, the matrix of Gauss-Newton: second derivatives of the images,
    robust weights and variances that move with the pose have their share. Autograd has it all. Steps with it come
    first, as long as they make b smaller in units of H; a pair with no such root nearby takes H instead.
    """
    J = _slope(equation, x)
    with torch.no_grad():
        H, b = equation(x)
        size = (b * solve(H, b).y).sum(-1)
        active = torch.ones_like(size, dtype=torch.bool)
        for _ in range(STEPS):
            x_new = x + _divided(J, b)
            H, b_new = equation(x_new)
            size_new = (b_new * solve(H, b_new).y).sum(-1)
            better = active & (size_new < size)
            x, b = torch.where(better[:, None], x_new, x), torch.where(better[:, None], b_new, b)
            size = torch.where(better, size_new, size)
            active = better & (size > STILL)
            if nothing_left(active):
                break
    return x + _divided(_slope(equation, x), equation(x)[1])


def _slope(equation: Callable[[Tensor], tuple[Tensor, Tensor]], x: Tensor) -> Tensor:
    """-db/dx (B, n, n), or H where that belongs to no minimum."""
    with torch.enable_grad():
        x = x.detach().requires_grad_()
        H, b = equation(x)
        rows = [torch.autograd.grad(b[:, k].sum(), x, retain_graph=True)[0] for k in range(b.shape[1])]
    J = -torch.stack(rows, dim=1)
    usable = J.isfinite().all(-1).all(-1) & (torch.linalg.det(J.nan_to_num()) > 0)
    return torch.where(usable[:, None, None], J, H.detach())


def _divided(J: Tensor, b: Tensor) -> Tensor:
    """J^-1 b, (B, n); nan where J has no inverse."""
    y, info = torch.linalg.solve_ex(J, b)
    return torch.where((info == 0)[:, None], y, torch.nan)
