"""Whole images of a batch: pyramids, inverse depths, picked points and their patches; twins of definitions/points.py.

Images are (B, H, W) float32, contiguous. One program makes a row of an image, or looks through a cell, or samples BLOCK
points of a pair. Operations round as written (launched without fusion), so the bits are those of kernels/.
"""

from __future__ import annotations

import triton
import triton.language as tl

from .linearise import PIXELS, sampled

BORDER = tl.constexpr(4)  # px, as definitions.points.BORDER


@triton.jit(do_not_specialize=["height", "width", "coarse_height", "coarse_width"])
def halve(finer, height, width, coarse, coarse_height, coarse_width, COLUMNS: tl.constexpr):
    """Means of 2x2 pixels: program b * coarse_height + v makes row v of image b."""
    row, u = tl.program_id(0), tl.arange(0, COLUMNS)
    b, v = (row // coarse_height).to(tl.int64), row % coarse_height
    inside = u < coarse_width
    at = finer + (b * height + 2 * v) * width + 2 * u
    upper = tl.load(at, mask=inside, other=0.0) + tl.load(at + 1, mask=inside, other=0.0)
    lower = tl.load(at + width, mask=inside, other=0.0) + tl.load(at + width + 1, mask=inside, other=0.0)
    tl.store(coarse + row.to(tl.int64) * coarse_width + u, (upper + lower) * 0.25, mask=inside)


@triton.jit(do_not_specialize=["height", "width"])
def blur(image, height, width, taps, out, COLUMNS: tl.constexpr):
    """Weights of a pixel and of those 1 and 2 px away, both ways, mirrored at the border.

    Program b * height + v makes row v of image b; sums are in the order of kernels/pyramid.py.
    """
    row, u = tl.program_id(0), tl.arange(0, COLUMNS)
    b, v = (row // height).to(tl.int64), row % height
    inside = u < width
    first = image + b * height * width
    middle, near, far = tl.load(taps), tl.load(taps + 1), tl.load(taps + 2)
    here = down(first, height, width, v, u, inside, middle, near, far)
    left = down(first, height, width, v, reflected(u - 1, width), inside, middle, near, far)
    right = down(first, height, width, v, reflected(u + 1, width), inside, middle, near, far)
    left2 = down(first, height, width, v, reflected(u - 2, width), inside, middle, near, far)
    right2 = down(first, height, width, v, reflected(u + 2, width), inside, middle, near, far)
    total = middle * here + near * (left + right) + far * (left2 + right2)
    tl.store(out + row.to(tl.int64) * width + u, total, mask=inside)


@triton.jit
def down(first, height, width, v, u, inside, middle, near, far):
    """The weighted sum of a column's pixels about row v."""
    here = tl.load(first + v * width + u, mask=inside, other=0.0)
    above1 = tl.load(first + reflected(v - 1, height) * width + u, mask=inside, other=0.0)
    below1 = tl.load(first + reflected(v + 1, height) * width + u, mask=inside, other=0.0)
    above2 = tl.load(first + reflected(v - 2, height) * width + u, mask=inside, other=0.0)
    below2 = tl.load(first + reflected(v + 2, height) * width + u, mask=inside, other=0.0)
    return middle * here + near * (above1 + below1) + far * (above2 + below2)


@triton.jit
def reflected(i, size):
    """An index that may lie beyond either end."""
    i = tl.abs(i)
    return tl.minimum(i, 2 * (size - 1) - i)


@triton.jit
def inverse(depth, count, out, COLUMNS: tl.constexpr):
    """1/m of m, 0 where it is missing: COLUMNS numbers of all."""
    n = tl.program_id(0).to(tl.int64) * COLUMNS + tl.arange(0, COLUMNS)
    z = tl.load(depth + n, mask=n < count, other=0.0)
    there = (z > 0.0) & (z < float("inf"))
    tl.store(out + n, tl.where(there, tl.div_rn(1.0, tl.where(there, z, 1.0)), 0.0), mask=n < count)


@triton.jit(do_not_specialize=["images", "cells"])
def pick(images, cells, spread, picked, COLUMNS: tl.constexpr):
    """Program (b, n) picks the strongest gradient amid one surface of cell n of an image.

    images: gray and depth (B, H, W), H, W; cells: px of a side, how many across and down; picked: uv (B, N, 2) and
    inverse depth (B, N), which it fills.
    """
    gray, depth, height, width = images
    cell, across, down = cells
    uv, inverse_depth = picked
    pair, n = tl.program_id(0).to(tl.int64), tl.program_id(1)
    u = BORDER + (n % across) * cell + tl.arange(0, COLUMNS)
    inside = (tl.arange(0, COLUMNS) < cell) & (u < width - BORDER)
    v = BORDER + (n // across) * cell
    last = tl.minimum(v + cell, height - BORDER)
    best, place = tl.load(spread) * 0.0, v * width + BORDER + (n % across) * cell
    gray += pair * height * width
    depth += pair * height * width
    while v < last:
        at = v * width + u
        gu = 0.5 * (tl.load(gray + at + 1, mask=inside, other=0.0) - tl.load(gray + at - 1, mask=inside, other=0.0))
        gv = 0.5 * (
            tl.load(gray + at + width, mask=inside, other=0.0) - tl.load(gray + at - width, mask=inside, other=0.0)
        )
        low = tl.load(depth + at, mask=inside, other=0.0)
        high = low
        for j in tl.static_range(-2, 3):  # a point must stand amid one surface
            for i in tl.static_range(-2, 3):
                z = tl.load(depth + at + j * width + i, mask=inside, other=0.0)
                low = tl.where(z > 0.0, tl.minimum(low, z), 0.0)
                high = tl.maximum(high, z)
        score = tl.where(inside & (low > 0.0) & (high <= tl.load(spread) * low), gu * gu + gv * gv, 0.0)
        strongest = tl.max(score)
        if strongest > best:
            best = strongest
            place = tl.min(tl.where(score == strongest, at, height * width))
        v += 1
    out = pair * across * down + n
    tl.store(uv + 2 * out, (place % width).to(tl.float64))
    tl.store(uv + 2 * out + 1, (place // width).to(tl.float64))
    z = tl.load(depth + place).to(tl.float64)
    there = (best > 0.0) & (z > 0.0)
    tl.store(inverse_depth + out, tl.where(there, 1.0 / tl.where(there, z, 1.0), 0.0))


@triton.jit(do_not_specialize=["images", "points"])
def sample(images, points, scale, pattern, sampled_to, BLOCK: tl.constexpr):
    """Patches and gradients of one level around points, clamped to the image.

    images: (B, h, w), h, w; points: (B, N, 2) px of level 0, N; scale (2,): of the level, 2^-level, and how far from
    the far border they are clamped; pattern (2, 8); sampled_to: patch (B, N, 8) and gradient (B, N, 8, 2), which it
    fills. Program (b, k) samples BLOCK points from k * BLOCK on.
    """
    image, height, width = images
    uv, N = points
    patch, gradient = sampled_to
    pair, n = tl.program_id(0), tl.program_id(1) * BLOCK + tl.arange(0, BLOCK)
    k, there = tl.arange(0, PIXELS), (n < N)[:, None]
    size = tl.load(scale)
    at = uv + (pair * N + n) * 2
    u = (tl.load(at, mask=n < N, other=0.0) + 0.5) * size - 0.5
    v = (tl.load(at + 1, mask=n < N, other=0.0) + 0.5) * size - 0.5
    u, v = u[:, None] + tl.load(pattern + k)[None, :], v[:, None] + tl.load(pattern + PIXELS + k)[None, :]
    u = tl.minimum(tl.maximum(u, 1.0), width - tl.load(scale + 1))
    v = tl.minimum(tl.maximum(v, 1.0), height - tl.load(scale + 1))
    value, gu, gv = sampled(image, pair, height, width, u, v, there & (u == u))
    out = (pair * N + n[:, None]) * PIXELS + k[None, :]
    tl.store(patch + out, value, mask=there)
    tl.store(gradient + 2 * out, gu, mask=there)
    tl.store(gradient + 2 * out + 1, gv, mask=there)
