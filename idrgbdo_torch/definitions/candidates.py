"""Candidate extraction and local depth planes in torch: twin of kernels.candidates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, pad

from ..errors import IdRgbdoError
from ..measurement import PATTERNS, TIER, WEAKEST
from .convert import SMALLEST, Array
from .image import gradient as image_gradient
from .points import sample_patterns
from .solver import solve

BINS = 64  # gray levels per px; stronger gradients count as the last one
TRIES = 6  # pixels of a cell that are looked at for a depth plane


def gradient_squared(image: Array) -> Array:
    """Squared central-difference gradient (H, W) float32, zero on the border."""
    g = image_gradient(torch.from_numpy(image)).double()
    return np.asarray(g.square().sum(-3).float())


def block_thresholds(gradient2: Array, block: int, offset: float) -> Array:
    """Median gradient of each block, over every other pixel of every other row, plus offset, averaged 3x3, squared."""
    if block % 2:
        raise IdRgbdoError(f"block: expected an even number of px, got {block}; every other pixel counts")
    bins = torch.from_numpy(gradient2)[::2, ::2].sqrt().long().clamp(max=BINS - 1)
    block //= 2
    height, width = bins.shape
    rows, cols = -(-height // block), -(-width // block)
    number = (torch.arange(height) // block)[:, None] * cols + torch.arange(width) // block
    counts = torch.bincount((number * BINS + bins).flatten(), minlength=rows * cols * BINS).reshape(rows, cols, BINS)
    past_half = 2 * counts.cumsum(-1) > counts.sum(-1, keepdim=True)
    raw = past_half.long().argmax(-1) + offset  # the first bin that passes half
    smooth = avg_pool2d(raw.double()[None], 3, stride=1, padding=1, count_include_pad=False)[0]
    return np.asarray(smooth.square())


def planes_at(depth: Array, uv: Array, radius: int, sigma: float) -> tuple[Array, Array, Array]:
    """Planes through the neighbourhoods of pixels uv (N, 2): where there is one (N,), its inverse depth, its slope.

    Inverse depth (N,) in 1/m; slope (N, 2) in 1/m per px.
    """
    valid, inverse_depth, slope = _planes(torch.from_numpy(depth), torch.from_numpy(uv).long(), radius, sigma)
    return valid.numpy(), inverse_depth.numpy(), slope.numpy()


def candidate_scores(gradient2: Array, thresholds: Array, block: int, edges: Array, depth: Array) -> Array:
    """(H, W) float32: squared gradient plus TIER for each tier gained, -1 where there is no candidate."""
    g2, on_edge, z = torch.from_numpy(gradient2), torch.from_numpy(edges) > 0, torch.from_numpy(depth)
    height, width = g2.shape
    at_v, at_u = torch.arange(height) // block, torch.arange(width) // block
    limit = torch.from_numpy(thresholds).float()[at_v[:, None], at_u]
    above = g2 > limit
    score = g2 + TIER * above + TIER * (above & on_edge)
    return np.asarray(torch.where((g2 > WEAKEST**2 * limit) & (z > 0), score, -1.0))


def grid_candidates(
    scores: Array, depth: Array, cell: int, border: int, radius: int, sigma: float
) -> tuple[Array, Array, Array]:
    """One candidate a grid cell: uv (M, 2), inverse depth (M,), tier (M,), row by row. The scores stay as they are."""
    z = torch.from_numpy(depth)
    height, width = z.shape
    score = torch.from_numpy(scores)[border : height - border, border : width - border]

    rows, cols = -(-score.shape[0] // cell), -(-score.shape[1] // cell)
    padded = pad(score, (0, cols * cell - score.shape[1], 0, rows * cell - score.shape[0]), value=-1.0)
    cells = padded.reshape(rows, cell, cols, cell).permute(0, 2, 1, 3).reshape(rows * cols, cell * cell)
    best, order = cells.sort(dim=-1, descending=True, stable=True)  # of equals the first
    best, order = best[:, :TRIES], order[:, :TRIES]
    number = torch.arange(rows * cols)[:, None]
    u = border + (number % cols) * cell + order % cell
    v = border + (number // cols) * cell + order // cell
    uv = torch.stack([u, v], dim=-1)  # (cells, tries, 2)
    tried = best >= 0
    inside = torch.where(tried[..., None], uv, border)
    valid, inverse_depth, _ = _planes(z, inside.reshape(-1, 2), radius, sigma)
    valid = valid.reshape(tried.shape) & tried
    found = valid.any(-1)
    first = valid.long().argmax(-1, keepdim=True)

    def take(x: Tensor) -> Tensor:
        return x.gather(-1, first)[found, 0]

    chosen = torch.stack([take(u), take(v)], dim=-1).double()
    tiers = (take(best) / TIER).long()
    return chosen.numpy(), take(inverse_depth.reshape(tried.shape)).numpy(), tiers.numpy()


def sample_patches(
    images: Sequence[Array], uv: Array, index: Array, levels: range, pattern: int, patch: Array, gradient: Array
) -> None:
    """Fill reference intensities (L, N, P) and gradients (L, N, P, 2) of some points on some levels.

    pattern: of the finest level; the others have COMPACT ones.
    """
    # sides shrink with the level, so what is too small comes last
    pyramid = [torch.from_numpy(image) for image in images[: levels.stop] if min(image.shape) >= SMALLEST]
    offsets = torch.from_numpy(PATTERNS[pattern, : patch.shape[2]])
    patches, gradients = sample_patterns(pyramid, torch.from_numpy(uv[index]), offsets)
    patch[levels.start : levels.stop, index] = gradient[levels.start : levels.stop, index] = 0.0
    for level in range(levels.start, len(pyramid)):
        patch[level, index] = patches[level].float().numpy()
        gradient[level, index] = gradients[level].float().numpy()


def first_of_cells(cells: Array, order: Array, count: int) -> Array:
    """At most count of the points in order: the first of each cell (N,), then the rest; indices, ascending."""
    place = torch.empty(len(order), dtype=torch.int64)
    place[torch.from_numpy(order)] = torch.arange(len(order))
    cell = torch.from_numpy(cells)
    earliest = torch.full((int(cell.max()) + 1,), len(order)).scatter_reduce(0, cell, place, "amin")
    repeated = place != earliest[cell]
    ranked = (repeated * len(order) + place).argsort()
    return np.asarray(ranked[:count].sort().values)


def _planes(depth: Tensor, uv: Tensor, radius: int, sigma: float) -> tuple[Tensor, Tensor, Tensor]:
    """Twin of kernels.candidates.fit_plane at whole pixels uv (N, 2): validity (N,), inverse depth, slope (N, 2)."""
    height, width = depth.shape
    u, v = uv.unbind(-1)
    inside = (u >= radius) & (v >= radius) & (u < width - radius) & (v < height - radius)
    u, v = torch.where(inside, u, radius), torch.where(inside, v, radius)
    side = torch.arange(-radius, radius + 1)
    j, i = (x.flatten() for x in torch.meshgrid(side, side, indexing="ij"))
    z = depth.double()[v[:, None] + j, u[:, None] + i]  # (N, side^2)
    here = depth.double()[v, u]
    known = z > 0
    centre = 1 / torch.where(here > 0, here, 1.0)
    d = torch.where(known, 1 / torch.where(known, z, 1.0) - centre[:, None], 0.0)
    near = (i.abs() <= 2) & (j.abs() <= 2)
    gate = (0.06 * centre).clamp(min=5 * sigma)
    valid = inside & (here > 0) & (known | ~near).all(-1) & (d.abs() <= gate[:, None]).all(-1)
    valid = valid & (known.sum(-1) >= (2 * radius + 1) ** 2 * 3 // 4)
    J = torch.stack([torch.ones_like(i), i, j], dim=-1).double()  # (side^2, 3)
    A = (known.double()[:, :, None, None] * (J[:, :, None] * J[:, None])).sum(1)
    rhs = d @ J
    fit = solve(A, rhs)
    residual2 = (d.square().sum(-1) - (fit.y * rhs).sum(-1)) / known.sum(-1).clamp(min=1)
    valid = valid & fit.ok & (residual2 <= (2 * sigma) ** 2)
    return valid, torch.where(valid, centre + fit.y[:, 0], 0.0), torch.where(valid[:, None], fit.y[:, 1:], 0.0)
