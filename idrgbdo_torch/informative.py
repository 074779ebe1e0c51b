"""Informative measurements for anybody's estimator: a Jacobian in, the rows worth keeping out."""

from __future__ import annotations

import torch
from torch import Tensor

from .errors import IdRgbdoError
from .selection import select_informative

FLOOR = 1e-6  # of each parameter's information in all rows: the prior where none is given
SHARPNESS = 25.0  # of the spread: half weight at a fifth of the image radius


def select_rows(
    J: Tensor, count: int, *, sigma: Tensor | float = 1.0, information: Tensor | None = None,
    cells: Tensor | None = None, where: Tensor | None = None, distance: float = 0.0, radius: Tensor | None = None,
    spread: float = 0.25,
) -> Tensor:  # fmt: skip
    """Indices (<= count,) int64 of the measurements that leave the least entropy, greedily, the best first.

    J: (N, D), or (N, R, D) where a measurement has R residuals, derivatives of the residuals by the D parameters.
    sigma: their standard deviations, a number, (N,) or (N, R). information: (D, D), what is known before, positive
    definite; by default next to nothing. cells: (N,) integers, of each cell at most one is taken; or where (N, 2) and
    distance, nothing closer is. radius: (N,) from 0 to 1; with it Algorithm 1's preference of outer points first and
    inner ones last is added, up to `spread` bits. The choice is Algorithm 1: first the largest derivative of each
    parameter, then the largest gain 1/2 log2 |I + J Lambda^-1 J^T|, in float64. O(N count).
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
        return torch.zeros(0, dtype=torch.int64)
    if information is None:
        everything = rows.square().sum((0, 1))
        information = torch.diag(torch.where(everything > 0, FLOOR * everything, 1.0))
    if cells is not None:
        where, distance = cells.double()[:, None], 0.5  # of one cell is nearer than that
    no_radius = torch.zeros(len(rows), dtype=torch.float64)
    return select_informative(
        rows, no_radius if radius is None else radius.double(), count, information,
        spread=0.0 if radius is None else spread, c_z=SHARPNESS, where=where, distance=distance,
    )  # fmt: skip
