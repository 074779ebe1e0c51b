"""Fused candidate extraction (steps 1 and 2 of section 4.1) and local depth planes."""

from __future__ import annotations

from math import sqrt

import numpy as np

from ..measurement import COMPACT, PATTERNS, TIER, WEAKEST
from .compiled import kernel
from .image import sample


@kernel
def gradient_squared(image):
    """Squared central-difference gradient, zero on the border."""
    height, width = image.shape
    out = np.zeros((height, width), dtype=np.float32)
    for v in range(1, height - 1):
        for u in range(1, width - 1):
            gu = 0.5 * (image[v, u + 1] - image[v, u - 1])
            gv = 0.5 * (image[v + 1, u] - image[v - 1, u])
            out[v, u] = gu * gu + gv * gv
    return out


@kernel
def block_thresholds(gradient2, block, offset):
    """Region-adaptive threshold: median gradient of a block plus offset, smoothed 3x3; squared like the gradient.

    The median is that of every other pixel of every other row.
    """
    height, width = gradient2.shape
    rows = (height + block - 1) // block
    cols = (width + block - 1) // block
    raw = np.zeros((rows, cols))
    histogram = np.zeros(64, dtype=np.int64)
    for r in range(rows):
        for c in range(cols):
            histogram[:] = 0
            count = 0
            for v in range(r * block, min((r + 1) * block, height), 2):
                for u in range(c * block, min((c + 1) * block, width), 2):
                    histogram[min(63, int(sqrt(gradient2[v, u])))] += 1
                    count += 1
            below = 0
            for k in range(64):
                below += histogram[k]
                if 2 * below > count:
                    raw[r, c] = k + offset
                    break
    out = np.empty((rows, cols))
    for r in range(rows):
        for c in range(cols):
            total = 0.0
            count = 0
            for i in range(max(0, r - 1), min(rows, r + 2)):
                for j in range(max(0, c - 1), min(cols, c + 2)):
                    total += raw[i, j]
                    count += 1
            out[r, c] = (total / count) ** 2
    return out


@kernel
def fit_plane(depth, u, v, radius, sigma):
    """Inverse depth at pixel (u, v) from a plane through its neighbourhood.

    Inverse depth is linear in pixel coordinates on a plane, so the fit is unbiased on any flat surface.
    Returns (valid, inverse depth, d/du, d/dv). Invalid at holes, jumps and clearly curved places.
    sigma: noise of one reading in 1/m.
    """
    height, width = depth.shape
    if u < radius or v < radius or u >= width - radius or v >= height - radius or depth[v, u] <= 0.0:
        return False, 0.0, 0.0, 0.0
    centre = 1.0 / np.float64(depth[v, u])
    gate = max(5.0 * sigma, 0.06 * centre)
    n = 0.0
    sx = sy = sxx = sxy = syy = sd = sxd = syd = sdd = 0.0
    for j in range(-radius, radius + 1):
        for i in range(-radius, radius + 1):
            z = depth[v + j, u + i]
            if z <= 0.0:
                if abs(i) <= 2 and abs(j) <= 2:
                    return False, 0.0, 0.0, 0.0
                continue
            d = 1.0 / np.float64(z) - centre
            if abs(d) > gate:
                return False, 0.0, 0.0, 0.0
            n += 1.0
            sx += i
            sy += j
            sxx += i * i
            sxy += i * j
            syy += j * j
            sd += d
            sxd += i * d
            syd += j * d
            sdd += d * d
    if n < (2 * radius + 1) ** 2 * 3 // 4:
        return False, 0.0, 0.0, 0.0
    # 3x3 normal equations by elimination
    sxx_ = sxx - sx * sx / n
    sxy_ = sxy - sx * sy / n
    sxd_ = sxd - sx * sd / n
    syy_ = syy - sy * sy / n - sxy_ * sxy_ / sxx_
    slope_v = (syd - sy * sd / n - sxy_ * sxd_ / sxx_) / syy_
    slope_u = (sxd_ - sxy_ * slope_v) / sxx_
    offset = (sd - sx * slope_u - sy * slope_v) / n
    residual2 = (sdd - offset * sd - slope_u * sxd - slope_v * syd) / n
    if residual2 > (2.0 * sigma) ** 2:
        return False, 0.0, 0.0, 0.0
    return True, centre + offset, slope_u, slope_v


@kernel
def candidate_scores(gradient2, thresholds, block, edges, depth):
    """(H, W) float32: squared gradient plus TIER for each tier gained (section 4.1), -1 where there is no candidate.

    A pixel needs depth and WEAKEST of the threshold's gradient; above the threshold it gains a tier, on a Canny edge
    another.
    """
    height, width = gradient2.shape
    out = np.empty((height, width), dtype=np.float32)
    limits = np.empty(width, dtype=np.float32)
    for v in range(height):
        if v % block == 0:
            for u in range(width):
                limits[u] = thresholds[v // block, u // block]
        score_row(gradient2[v], limits, edges[v], depth[v], out[v])
    return out


@kernel
def score_row(gradient2, limits, edges, depth, out):
    """Fill a row of scores."""
    weakest, nothing, zero = np.float32(WEAKEST * WEAKEST), np.float32(-1.0), np.float32(0.0)
    one_tier, none = np.float32(TIER), np.uint8(0)
    for u in range(out.shape[0]):  # no branches, so that this becomes SIMD
        g2, limit = gradient2[u], limits[u]
        above = one_tier if g2 > limit else zero
        edge = above if edges[u] > none else zero
        score = g2 + above + edge
        score = score if g2 > weakest * limit else nothing
        out[u] = score if depth[u] > zero else nothing


@kernel
def grid_candidates(scores, depth, cell, border, radius, sigma):
    """One candidate a grid cell: the highest score among the first six that have a valid local depth plane.

    A score that was tried in vain is overwritten. Returns uv (M, 2), inverse depth (M,) and tier (M,): 2 Canny edge,
    1 above the threshold, 0 weaker.
    """
    height, width = scores.shape
    capacity = ((height + cell - 1) // cell) * ((width + cell - 1) // cell)
    uv = np.empty((capacity, 2))
    inv_depth = np.empty(capacity)
    tiers = np.empty(capacity, dtype=np.int64)
    most = np.empty(width, np.float32)  # of each column
    count = 0
    for v0 in range(border, height - border, cell):
        rows = scores[v0 : min(v0 + cell, height - border)]
        most[:] = np.float32(-1.0)
        for v in range(rows.shape[0]):
            raise_to(rows[v], most)
        for u0 in range(border, width - border, cell):
            u1 = min(u0 + cell, width - border)
            for _ in range(6):
                best, best_u, best_v = highest(rows, most, u0, u1)
                if best < 0.0:
                    break
                ok, d, _gu, _gv = fit_plane(depth, best_u, v0 + best_v, radius, sigma)
                if ok:
                    uv[count, 0] = best_u
                    uv[count, 1] = v0 + best_v
                    inv_depth[count] = d
                    tiers[count] = int(best / TIER)
                    count += 1
                    break
                rows[best_v, best_u] = -1.0
                most[best_u] = np.float32(-1.0)
                for v in range(rows.shape[0]):
                    most[best_u] = max(most[best_u], rows[v, best_u])
    return uv[:count], inv_depth[:count], tiers[:count]


@kernel
def raise_to(row, most):
    """Raise each of the largest so far to that of a row."""
    for u in range(most.shape[0]):  # no branches, so that this becomes SIMD
        most[u] = row[u] if row[u] > most[u] else most[u]


@kernel
def highest(rows, most, u0, u1):
    """(score, u, row) of the highest in some columns, the first of equals row by row; -1 where there is none.

    most: the largest of each column.
    """
    best = np.float32(-1.0)
    for u in range(u0, u1):
        best = max(best, most[u])
    best_u, best_v = -1, rows.shape[0]
    if best < 0.0:
        return best, best_u, -1
    for u in range(u0, u1):
        if most[u] == best:
            for v in range(best_v):  # an equal one to the right must be higher up
                if rows[v, u] == best:
                    best_u, best_v = u, v
                    break
    return best, best_u, best_v


@kernel
def planes_at(depth, uv, radius, sigma):
    """fit_plane at many pixels: (valid (N,), inverse depth (N,), its slope (N, 2) in 1/m per px)."""
    n = uv.shape[0]
    valid = np.zeros(n, dtype=np.bool_)
    inv_depth = np.zeros(n)
    slope = np.zeros((n, 2))
    for i in range(n):
        valid[i], inv_depth[i], slope[i, 0], slope[i, 1] = fit_plane(depth, int(uv[i, 0]), int(uv[i, 1]), radius, sigma)
    return valid, inv_depth, slope


@kernel
def sample_patches(images, uv, index, first, end, pattern, patch, gradient):
    """Fill reference intensities (L, N, P) and gradients (L, N, P, 2) of some points on levels first to end.

    pattern: of the finest level; the others have COMPACT ones.
    """
    pixels = patch.shape[2]
    for level in range(first, end):
        image = images[level]
        size = 0.5**level
        which = pattern if level == 0 else COMPACT
        for n in range(index.shape[0]):
            i = index[n]
            u0 = (uv[i, 0] + 0.5) * size - 0.5
            v0 = (uv[i, 1] + 0.5) * size - 0.5
            for k in range(pixels):
                # clamped near the border: coarse levels have less room, and a clamped pixel is still a fair guess
                u = min(max(u0 + PATTERNS[which, k, 0], 1.0), image.shape[1] - 2.001)
                v = min(max(v0 + PATTERNS[which, k, 1], 1.0), image.shape[0] - 2.001)
                _ok, value, gu, gv = sample(image, u, v)
                patch[level, i, k] = value
                gradient[level, i, k, 0] = gu
                gradient[level, i, k, 1] = gv


@kernel
def first_of_cells(cells, order, count):
    """At most count of the points in order: the first of each cell (N,), then the rest."""
    taken = np.zeros(cells.shape[0], dtype=np.bool_)
    last = 0
    for i in range(cells.shape[0]):
        last = max(last, cells[i])
    seen = np.zeros(last + 1, dtype=np.bool_)
    left = count
    for i in order:
        if left > 0 and not seen[cells[i]]:
            seen[cells[i]] = True
            taken[i] = True
            left -= 1
    for i in order:
        if left > 0 and not taken[i]:
            taken[i] = True
            left -= 1
    return np.flatnonzero(taken)


@kernel
def isolated_holes(depth, step):
    """Share of the pixels inside a depth image, on every so many rows from the second on, that alone have no depth."""
    height, width = depth.shape
    zero, holes, count = np.float32(0.0), 0, 0
    for v in range(1, height - 1, step):
        holes += alone(depth[v - 1], depth[v], depth[v + 1], zero)
        count += width - 2
    return holes / count if count > 0 else 0.0


@kernel
def alone(above, here, below, zero):
    """How many pixels of a row have no depth while the four around have."""
    holes = 0
    for u in range(1, here.shape[0] - 1):
        beside = (here[u - 1] > zero) & (here[u + 1] > zero) & (above[u] > zero) & (below[u] > zero)
        holes += 1 if (here[u] <= zero) & beside else 0
    return holes
