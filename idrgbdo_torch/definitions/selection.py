"""Which points to track (section 4.1, step 3): what each tells, Eqs. 17 and 18, Algorithm 1.

A point is given by its whitened rows A (R, D): A^T A is what it adds to the information of the state. Any Jacobian
divided by its standard deviation will do, so these functions serve other estimators too (select_rows).
"""

from __future__ import annotations

from dataclasses import replace
from math import log
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..config import SelectionConfig
from ..errors import IdRgbdoError, door
from ..measurement import GRADIENT_NOISE, Noise, Points, Rows
from .camera import Pinhole, inside
from .convert import Array, chosen, noise_of_arrays
from .information import entropy_reduction_bits, information_from_rows
from .photometric import (
    PATTERN_1,
    distortion_weight,
    gradient_information,
    photometric_variance,
    projective_distortion,
    residual_variance,
    warp,
)

FLOOR = 1e-6  # of each parameter's information in all rows: the prior where none is given
DEFAULTS = SelectionConfig()


def whitened_rows(camera: Pinhole, margin: float, points: Points, index: Array, T: Array, noise: Noise) -> Rows:
    """Twin of kernels.selection.whitened_rows: what some points tell about a pose T_target_host (4, 4)."""
    some = chosen(points, index)
    uv, d, var_d = some.uv[0], some.inverse_depth[0], some.variance[0]
    T_target_host = torch.from_numpy(T)
    warped = warp(camera, uv, d, T_target_host, PATTERN_1)
    P = torch.where(warped.valid[:, None], warped.P, 1.0)
    h, front = distortion_weight(projective_distortion(d, P, T_target_host), noise.c_h)
    seen = warped.valid & front & inside(camera, warped.centre, margin)

    gradient = some.gradient[0][0].double()
    sigma = noise_of_arrays(noise)
    sigmas: dict[str, Any] = {"sigma_intensity": sigma.sigma_intensity, "sigma_pixel": sigma.sigma_pixel}
    phi = photometric_variance(gradient, warped.duv_dd, var_d.sqrt(), mode=sigma.mode, shared=sigma.shared, **sigmas)
    # noise alone looks like a gradient too: on a bare wall it must not pass for information
    signal = 1 - GRADIENT_NOISE * noise.var_intensity / (gradient.square().sum(-1) + 1e-9)
    G = gradient_information(gradient, signal.clamp(min=0) / residual_variance(h, phi))
    patch = _factor(G).mT @ warped.duv_dxi  # (M, 2, 6)

    z = P[:, 2]
    trust = (noise.var_depth + var_d / (z * d) ** 4).rsqrt() if noise.use_depth else torch.zeros_like(d)
    depth = (trust / z**2)[:, None] * warped.dP_dxi[:, 2]
    rows = torch.cat([patch, depth[:, None]], dim=1)
    rows = torch.where(seen[:, None, None], rows, 0.0)
    where = torch.where(seen[:, None], warped.centre, 0.0)
    return Rows(rows.numpy(), seen.numpy(), where.numpy())


def _factor(G: Tensor) -> Tensor:
    """Lower triangular L (..., 2, 2) with L L^T = G, zero where nothing is known."""
    L00 = G[..., 0, 0].sqrt()
    L10 = torch.where(L00 > 0, G[..., 0, 1] / torch.where(L00 > 0, L00, 1.0), 0.0)
    L11 = (G[..., 1, 1] - L10.square()).clamp(min=0).sqrt()
    return torch.stack([L00, torch.zeros_like(L00), L10, L11], dim=-1).reshape(*G.shape)


@door
def select_rows(
    J: Tensor, count: int, *, sigma: Tensor | float = 1.0, information: Tensor | None = None,
    cells: Tensor | None = None, where: Tensor | None = None, distance: float = 0.0, radius: Tensor | None = None,
) -> Tensor:  # fmt: skip
    """Indices (<= count,) int64 of the measurements that leave the least entropy, greedily, the best first.

    J: (N, D), or (N, R, D) where a measurement has R residuals, derivatives of the residuals by the D parameters.
    sigma: their standard deviations, a number, (N,) or (N, R). information: (D, D), what is known before, positive
    definite; by default next to nothing. cells: (N,) integers, of each cell at most one is taken; or where (N, 2) and
    distance, nothing closer is. radius: (N,) from 0 to 1; with it Algorithm 1's preference of outer points first and
    inner ones last is added, up to a quarter of a bit (select_informative takes other weights). The choice is
    Algorithm 1: first the largest derivative of each parameter, then the largest gain 1/2 log2 |I + J Lambda^-1 J^T|,
    in float64. O(N count).
    """
    if J.ndim not in (2, 3) or count < 1 or not bool(torch.isfinite(J).all()):
        raise IdRgbdoError(
            f"J: expected finite (N, D) or (N, R, D) and count >= 1, got {tuple(J.shape)} and {count}; "
            "leave out rows that are not measured"
        )
    if cells is not None and where is not None:
        raise IdRgbdoError("cells: expected either cells or where with a distance, got both; choose one of the two")
    rows = (J[:, None] if J.ndim == 2 else J).double()  # (N, R, D)
    deviation = torch.as_tensor(sigma, dtype=torch.float64, device=J.device)
    deviation = deviation[:, None] if deviation.ndim == 1 else deviation
    rows = rows / deviation[..., None].expand(*rows.shape[:2], 1)
    if not len(rows):
        return torch.zeros(0, dtype=torch.int64, device=J.device)
    if information is None:
        everything = rows.square().sum((0, 1))
        information = torch.diag(torch.where(everything > 0, FLOOR * everything, 1.0))
    if cells is not None:
        where, distance = cells.double()[:, None], 0.5  # of one cell is nearer than that
    config = replace(DEFAULTS, distance=distance)
    if radius is None:
        radius, config = rows.new_zeros(len(rows)), replace(config, spread=0.0)
    return select_informative(rows, radius.double(), count, information, config, where)


def determinant_gain(rows: Tensor, information: Tensor) -> Tensor:
    """Eq. (17). Delta_p |Lambda| = |Lambda| (|I + A_p Lambda^-1 A_p^T| - 1) (...), rows A (..., R, D), Lambda (D, D).

    For a single row it is the printed sigma^-2 j Lambda^adj j^T. Float64: |Lambda| of a pose is about 1e41.
    """
    gain: Tensor = torch.linalg.det(information) * torch.expm1(log(2.0) * 2.0 * gain_bits(rows, information))
    return gain


def gain_bits(rows: Tensor, information: Tensor) -> Tensor:
    """What each point takes off the entropy, 1/2 log2 |I + A Lambda^-1 A^T| (...) in bits: Eq. 17 without its unit.

    The same point is best by either, this one has no units, cannot overflow, and can only shrink as points join. It is
    the entropy reduction (Eq. 12) of the pose, and by symmetry that of the point's whitened residual once the pose is
    known: from I + A Lambda^-1 A^T to I.
    """
    AC = rows @ torch.linalg.inv(information)  # (..., R, D)
    noise = torch.eye(rows.shape[-2], dtype=rows.dtype, device=rows.device)
    predicted = noise + AC @ rows.mT
    return entropy_reduction_bits(0.5 * (predicted + predicted.mT), noise)


def point_value(gain: Tensor, radius: Tensor, z: float, c_z: float, spread: float = 1.0) -> Tensor:
    """Eq. (18). f(p, z, Lambda) = Delta_p |Lambda| + 1 / (c_z (z_p - z)^2 + 1) (...).

    gain: determinant_gain with spread 1 is the function as printed; gain_bits with a weighted spread is the default,
    because the printed sum adds 1e41 to at most 1. radius: z_p (...), 0 at the principal point, 1 farthest out.
    """
    return gain + spread / (c_z * (radius - z) ** 2 + 1.0)


def select_informative(
    rows: Tensor,
    radius: Tensor,
    m: int,
    information: Tensor,
    config: SelectionConfig = DEFAULTS,
    where: Tensor | None = None,
    most: int = 0,
) -> Tensor:
    """Algorithm 1. Indices of the m most informative points, in order of choice, from rows A (N, R, D); fewer if N < m.

    information: (D, D) positive definite to begin with, the prior's. radius: (N,). config: objective ("bits" or
    "paper"), spread and c_z, see point_value; with where (N, 2) no two chosen points are closer than its distance (px).
    After m points it goes on, up to `most`, while worst_entropy_bits is above config.bits.
    This is the definition, O(N m); kernels.selection.select is its fused twin for poses.
    """
    if rows.ndim != 3 or m < 1 or information.shape != (rows.shape[-1],) * 2:
        raise IdRgbdoError(
            f"rows: expected (N, R, D) with information (D, D) and m >= 1, got {tuple(rows.shape)}, "
            f"{tuple(information.shape)} and m = {m}; a single Jacobian row a point is (N, 1, D)"
        )
    rows, information = rows.double(), information.double().clone()
    free = torch.ones(len(rows), dtype=torch.bool, device=rows.device)
    chosen: list[int] = []

    def take(best: int) -> None:
        chosen.append(best)
        free[best] = False
        if where is not None and config.distance > 0.0:
            free.logical_and_((where - where[best]).square().sum(dim=-1) >= config.distance**2)
        information.add_(information_from_rows(rows[best], rows.new_ones(rows.shape[1])))

    for k in range(rows.shape[-1]):  # the largest derivative of each degree of freedom
        size = rows[..., k].square().sum(dim=-1).where(free, -torch.inf)
        if len(chosen) < m and free.any() and size.max() > 0.0:
            take(int(size.argmax()))
    in_bits = config.objective == "bits"
    z = 1.0
    step = 1.0 / max(1, m - rows.shape[-1])

    def wanted() -> bool:
        return len(chosen) < m or (len(chosen) < most and worst_entropy_bits(information) > config.bits)

    while free.any() and wanted():
        gain = gain_bits(rows, information) if in_bits else determinant_gain(rows, information)
        value = point_value(gain, radius, z, config.c_z, config.spread if in_bits else 1.0)
        take(int(value.where(free, -torch.inf).argmax()))
        z = max(0.0, z - step)
    return torch.tensor(chosen, dtype=torch.int64, device=rows.device)


def worst_entropy_bits(information: Tensor) -> float:
    """log2 of the largest standard deviation that an information (D, D) leaves, in the units of the parameters."""
    return 0.5 * float(torch.linalg.inv(information).diagonal().max().log2())


def select_by_definition(
    rows: Rows, radius: Array, m: int, most: int, information: Array, config: SelectionConfig
) -> Array:
    """Algorithm 1 with the configured objective over the rows that are seen: indices (<= most,) in order of choice."""
    visible = np.flatnonzero(rows.seen)
    order = select_informative(
        torch.from_numpy(rows.A[visible]), torch.from_numpy(radius[visible]), m, torch.from_numpy(information), config,
        torch.from_numpy(rows.where[visible]), most,
    )  # fmt: skip
    return np.asarray(visible[order.numpy()])
