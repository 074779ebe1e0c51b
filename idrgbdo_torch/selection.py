"""Which points to track (section 4.1, step 3): the four modes, Algorithm 1, Eqs. 17 and 18.

A point is given by its whitened rows A (R, D): A^T A is what it adds to the information of the state. Any Jacobian
divided by its standard deviation will do, so these functions serve other trackers too.
"""

from __future__ import annotations

from math import log

import numpy as np
import torch
from numpy.random import Generator
from numpy.typing import NDArray
from torch import Tensor

from .backends import FUSED, TORCH, Backend
from .config import SelectionConfig
from .errors import IdRgbdoError
from .frame import Keyframe
from .kernels.model import Noise

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ROUNDING = 1e-6  # px; candidates are whole pixels and may lie on the margin, where rounding must not decide


def determinant_gain(rows: Tensor, information: Tensor) -> Tensor:
    """Eq. (17). Delta_p |Lambda| = |Lambda| (|I + A_p Lambda^-1 A_p^T| - 1) (...), rows A (..., R, D), Lambda (D, D).

    For a single row it is the printed sigma^-2 j Lambda^adj j^T. Float64: |Lambda| of a pose is about 1e41.
    """
    gain: Tensor = torch.linalg.det(information) * torch.expm1(log(2.0) * 2.0 * gain_bits(rows, information))
    return gain


def gain_bits(rows: Tensor, information: Tensor) -> Tensor:
    """What each point takes off the entropy, 1/2 log2 |I + A Lambda^-1 A^T| (...) in bits: Eq. 17 without its unit.

    The same point is best by either, this one has no units, cannot overflow, and can only shrink as points join.
    """
    AC = rows @ torch.linalg.inv(information)  # (..., R, D)
    inner = torch.eye(rows.shape[-2], dtype=rows.dtype) + AC @ rows.mT
    bits: Tensor = 0.5 * torch.linalg.slogdet(inner).logabsdet / log(2.0)
    return bits


def point_value(gain: Tensor, radius: Tensor, z: float, c_z: float, spread: float = 1.0) -> Tensor:
    """Eq. (18). f(p, z, Lambda) = Delta_p |Lambda| + 1 / (c_z (z_p - z)^2 + 1) (...).

    gain: determinant_gain with spread 1 is the function as printed; gain_bits with a weighted spread is the default,
    because the printed sum adds 1e41 to at most 1. radius: z_p (...), 0 at the principal point, 1 farthest out.
    """
    return gain + spread / (c_z * (radius - z) ** 2 + 1.0)


def select_informative(
    rows: Tensor, radius: Tensor, m: int, information: Tensor, *, objective: str = "bits", spread: float = 0.5,
    c_z: float = 25.0, where: Tensor | None = None, distance: float = 0.0,
) -> Tensor:  # fmt: skip
    """Algorithm 1. Indices (<= m,) of the most informative points, in order of choice, from rows A (N, R, D).

    information: (D, D) positive definite to begin with, the prior's. radius: (N,). objective: "bits" or "paper", see
    point_value. where (N, 2) and distance: no two chosen points are closer (px). This is the definition, O(N m);
    kernels.choice.select is its fused twin for poses.
    """
    if rows.ndim != 3 or m < 1 or information.shape != (rows.shape[-1],) * 2:
        raise IdRgbdoError(
            f"rows: expected (N, R, D) with information (D, D) and m >= 1, got {tuple(rows.shape)}, "
            f"{tuple(information.shape)} and m = {m}; a single Jacobian row a point is (N, 1, D)"
        )
    rows, information = rows.double(), information.double().clone()
    free = torch.ones(len(rows), dtype=torch.bool)
    chosen: list[int] = []

    def take(best: int) -> None:
        chosen.append(best)
        free[best] = False
        if where is not None and distance > 0.0:
            free.logical_and_((where - where[best]).square().sum(dim=-1) >= distance**2)
        information.add_(rows[best].mT @ rows[best])

    for k in range(rows.shape[-1]):  # the largest derivative of each degree of freedom
        size = rows[..., k].square().sum(dim=-1).where(free, -torch.inf)
        if len(chosen) < m and free.any() and size.max() > 0.0:
            take(int(size.argmax()))
    z = 1.0
    step = 1.0 / max(1, m - rows.shape[-1])
    while free.any() and len(chosen) < m:
        gain = gain_bits(rows, information) if objective == "bits" else determinant_gain(rows, information)
        value = point_value(gain, radius, z, c_z, spread if objective == "bits" else 1.0)
        take(int(value.where(free, -torch.inf).argmax()))
        z = max(0.0, z - step)
    return torch.tensor(chosen, dtype=torch.int64)


def select_points(
    keyframe: Keyframe,
    T_frame_kf: Array,
    m: int,
    information: Array,
    config: SelectionConfig,
    noise: Noise,
    rng: Generator,
    backend: Backend = FUSED,
) -> Index:
    """At most m candidates of a keyframe for a frame at the pose T_frame_kf, by the configured mode."""
    camera = keyframe.frame.camera
    everyone = np.arange(len(keyframe.points.uv))
    A, seen, where = backend.choice.whitened_rows(
        keyframe.frame.intrinsics[0], camera.width, camera.height, config.margin - ROUNDING, keyframe.points, everyone,
        T_frame_kf, noise,
    )  # fmt: skip
    if config.mode == "rand":
        key = rng.random(len(everyone)) + ~seen  # one point more or less in view changes no other's luck
        return np.sort(np.argsort(key)[: min(m, int(seen.sum()))])
    if config.mode == "grid":
        return strongest_of_cells(where, seen, keyframe, m)
    if config.objective == "paper" or backend is TORCH:
        visible = np.flatnonzero(seen)
        chosen = select_informative(
            torch.from_numpy(A[visible]), torch.from_numpy(keyframe.radius[visible]), m, torch.from_numpy(information),
            objective=config.objective, spread=config.spread, c_z=config.c_z, where=torch.from_numpy(where[visible]),
            distance=config.distance,
        )  # fmt: skip
        return np.asarray(visible[chosen.numpy()])
    fused: Index = backend.choice.select(
        A, seen, where, keyframe.radius, m, information, config.spread, config.c_z, config.distance
    )
    return fused


def strongest_of_cells(where: Array, seen: NDArray[np.bool_], keyframe: Keyframe, m: int) -> Index:
    """The strongest visible gradient of each of about m grid cells, then the strongest of the rest."""
    visible = np.flatnonzero(seen)
    camera = keyframe.frame.camera
    strength = (keyframe.points.gradient[0, visible, 0] ** 2).sum(axis=1)
    order = visible[np.argsort(-strength, kind="stable")]
    _, first = np.unique(grid_cells(where[order], m, camera.width, camera.height), return_index=True)
    cells = order[np.sort(first)]
    return np.concatenate([cells, order[~np.isin(order, cells)]])[:m]


def grid_cells(uv: Array, count: int, width: int, height: int) -> Index:
    """The number (N,) of the square cell each pixel lies in, with about `count` cells over the image."""
    side = float(np.sqrt(width * height / max(count, 1)))
    columns = int(width / side) + 1
    cells: Index = (uv[:, 1] // side).astype(np.int64) * columns + (uv[:, 0] // side).astype(np.int64)
    return cells


def point_bits(
    keyframe: Keyframe, T_frame_kf: Array, index: Index, noise: Noise, backend: Backend = FUSED
) -> tuple[Tensor, Tensor]:
    """Where a frame sees some candidates, (M, 2) px, and what each adds to all the others, (M,) bits; unseen left out.

    Unlike the gain at its choice, this does not depend on the order: what would be lost without that one point.
    """
    camera = keyframe.frame.camera
    A, seen, where = backend.choice.whitened_rows(
        keyframe.frame.intrinsics[0], camera.width, camera.height, 0.0, keyframe.points, index, T_frame_kf, noise
    )
    rows = torch.from_numpy(A[seen])  # (M, 3, 6)
    each = rows.mT @ rows  # (M, 6, 6)
    everything = each.sum(dim=0)
    floor = torch.diag(1e-6 * everything.diagonal())  # so that few points leave a matrix to invert
    return torch.from_numpy(where[seen]), gain_bits(rows, everything + floor - each)
