"""Normal equations, robust weights, damped steps, batched; failure is a value with a sentence, never an exception."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

ASKED = frozenset({"cpu"})  # devices that know at once whether a search may end
MIN_PIVOT = 1e-13  # of a unit-diagonal matrix: the share of a variable's information that the others do not explain


@dataclass(frozen=True)
class Solution:
    """The step of one linear system, or of a batch of them."""

    y: Tensor  # (..., m) float64; zero where not ok
    ok: Tensor  # (...) bool
    finite: Tensor  # (...) bool: the equations were

    @property
    def reason(self) -> str:
        """One sentence about the first failure; empty when all are ok. A GPU is waited for only where this is asked."""
        if bool(self.ok.all()):
            return ""
        if not bool(self.finite.all()):
            return "the normal equations contain a value that is not finite"
        return "the normal equations are singular: the measurements leave a direction free"


def normal_equations(
    J: Tensor, r: Tensor, weight: Tensor, prior: tuple[Tensor, Tensor] | None = None
) -> tuple[Tensor, Tensor]:
    """Eq. (4). (J^T Sigma_r^-1 J) y = -J^T Sigma_r^-1 r: both sides H (..., m, m) and b (..., m), float64.

    J (..., n, m), r (..., n), weight (..., n) the diagonal of Sigma_r^-1 (times robust weights; 0 leaves a row out),
    prior = (H_0, b_0) is added.
    """
    J, r, weight = J.double(), r.double(), weight.double()
    JtW = J.mT * weight[..., None, :]
    H = JtW @ J
    b = -(JtW @ r[..., None])[..., 0]
    if prior is not None:
        H, b = H + prior[0], b + prior[1]
    return H, b


def solve(H: Tensor, b: Tensor, damping: float | Tensor = 0.0) -> Solution:
    """The step y with (H + damping diag H) y = b, by Cholesky on the unit-diagonal system; H (..., m, m), b (..., m).

    damping is a number or (...), 0 being Gauss-Newton. Not ok: a number that is not finite, or a singular H.
    """
    H, b = H.double(), b.double()
    finite = torch.isfinite(H).all(-1).all(-1) & torch.isfinite(b).all(-1)
    factor, scale, regular = _factored(torch.where(finite[..., None, None], H, 0.0), damping)
    ok = finite & regular
    rhs = torch.where(ok[..., None], scale * b, 0.0)
    y = scale * torch.cholesky_solve(rhs[..., None], factor)[..., 0]
    return Solution(y, ok, finite)


def _factored(H: Tensor, damping: float | Tensor = 0.0) -> tuple[Tensor, Tensor, Tensor]:
    """The Cholesky factor of H (..., m, m) in units (..., m) that make its diagonal 1, and whether it has one (...).

    The identity where it has not.
    """
    diagonal = H.diagonal(dim1=-2, dim2=-1)
    observed = (diagonal > 0).all(-1)
    scale = torch.where(diagonal > 0, diagonal, 1.0).rsqrt()  # units drop out: metres and radians, any magnitude
    unit = scale[..., :, None] * H * scale[..., None, :]
    extra = torch.as_tensor(damping, dtype=H.dtype, device=H.device)[..., None, None]
    eye = torch.eye(H.shape[-1], dtype=H.dtype, device=H.device)
    factor, failed = torch.linalg.cholesky_ex(unit + extra * eye)
    pivots = factor.diagonal(dim1=-2, dim2=-1).square().amin(-1)
    regular = observed & (failed == 0) & (pivots > MIN_PIVOT)
    return torch.where(regular[..., None, None], factor, eye), scale, regular


def nothing_left(active: Tensor) -> bool:
    """Whether a search may end, since none of it is active: where a device is ASKED.

    Elsewhere the answer would wait for every kernel that was launched before, step by step, so it is never asked; what
    has settled is masked, and the steps that are left change nothing.
    """
    return active.device.type in ASKED and not bool(active.any())


def huber_weight(r: Tensor, threshold: float | Tensor, limit: float | Tensor = float("inf")) -> Tensor:
    """Weight rho'(r) / r of `robust_cost`, in r's shape: 1, k / |r| past the threshold k, 0 past the limit."""
    size = r.abs()
    weight = threshold / torch.maximum(size, torch.as_tensor(threshold, dtype=r.dtype, device=r.device))
    return torch.where(size <= limit, weight, 0.0)


def robust_cost(r: Tensor, threshold: float | Tensor, limit: float | Tensor = float("inf")) -> Tensor:
    """Huber's rho, saturated: r^2 / 2, k (|r| - k / 2) past the threshold k, constant past the limit.

    In r's shape. The limit must not be below the threshold.
    """
    size = torch.minimum(r.abs(), torch.as_tensor(limit, dtype=r.dtype, device=r.device))
    return torch.where(size <= threshold, 0.5 * size * size, threshold * (size - 0.5 * threshold))


def pose_information(H: Tensor, affine_information: Tensor) -> Tensor:
    """(B, 6, 6): brightness, with its prior (B, 2, 2), marginalised from the measurements' H (B, 8, 8)."""
    brightness = H[:, 6:, 6:] + affine_information
    across, _ = torch.linalg.solve_ex(brightness, H[:, 6:, :6])  # does not wait for a GPU to say whether it could
    out: Tensor = H[:, :6, :6] - H[:, :6, 6:] @ across
    return 0.5 * (out + out.mT)


def brightness_information(H: Tensor, least: Tensor) -> Tensor:
    """(B, 2, 2) of the brightness, the pose marginalised from H (B, 8, 8); `least` (B, 2, 2) where that fails."""
    finite = torch.isfinite(H).all(-1).all(-1)
    H = torch.where(finite[:, None, None], H, 0.0)
    factor, scale, regular = _factored(H[:, :6, :6])
    across = H[:, :6, 6:]
    x = scale[..., None] * torch.cholesky_solve(scale[..., None] * across, factor)  # (B, 6, 2)
    out = H[:, 6:, 6:] - across.mT @ x
    out = 0.5 * (out + out.mT)
    positive = (out[:, 0, 0] > 0) & (out[:, 0, 0] * out[:, 1, 1] > out[:, 0, 1] ** 2) & finite & regular
    return torch.where(positive[:, None, None], out, least)
