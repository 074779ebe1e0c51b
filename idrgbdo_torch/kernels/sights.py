"""What a sight saw where points of another frame would be: they themselves, nothing, or something else."""

from __future__ import annotations

from math import floor

import numpy as np

from ..measurement import IN_FRONT
from .compiled import exact_kernel
from .photometric import moved
from .tracking import smallest

NEAREST_M = 1e-3
STEEP_PX = 2  # around a point, among which the steepest counts: points are on the steepest
MOST_AROUND = 3  # of five pixels around, of which none may say the contrary


@exact_kernel
def look(uv, inv_depth, intrinsics, T, depth, intrinsics_other, reach, gray, intrinsics_gray):
    """Of points (N, 2) px and (N,) 1/m of a frame: (foreign, same, value), (N,) each.

    foreign: the sight went through to something farther there, or met what is not of the world, all around (within
    reach px). same: it saw that depth. value: its gray level there, 0 where gray (h, w) is empty.
    T: (4, 4) to the sight. depth: (h, w) m, 0 unknown, negative where not of the world.
    """
    count = uv.shape[0]
    foreign, same = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    value = np.zeros(count, np.float32)
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    gx, gy, hx, hy = intrinsics_other[0], intrinsics_other[1], intrinsics_other[2], intrinsics_other[3]
    height, width = depth.shape
    for n in range(count):
        d = inv_depth[n]
        if d <= 0.0:
            continue
        x, y, z = moved(T, (uv[n, 0] - cx) / fx, (uv[n, 1] - cy) / fy, d)
        if z < NEAREST_M * d:
            continue
        x, y, z = x / z, y / z, z / d
        u, v = floor(gx * x + hx + 0.5), floor(gy * y + hy + 0.5)
        if u < 0 or v < 0 or u >= width or v >= height:
            continue
        there = np.float64(depth[v, u])
        same[n] = abs(there - z) < IN_FRONT * z
        if not 0.0 < there <= z * (1.0 + IN_FRONT):
            foreign[n] = looked_through(depth, u, v, z, reach)
        if same[n] and gray.size > 0:
            value[n] = between(
                gray, intrinsics_gray[0] * x + intrinsics_gray[2], intrinsics_gray[1] * y + intrinsics_gray[3]
            )
    return foreign, same, value


@exact_kernel
def looked_through(depth, u, v, z, reach):
    """Whether a pixel and its neighbours at a distance say that nothing of the world stands there, z m away."""
    height, width = depth.shape
    against = 0
    for du, dv in ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)):
        there = np.float64(depth[min(max(v + reach * dv, 0), height - 1), min(max(u + reach * du, 0), width - 1)])
        if there > z * (1.0 + IN_FRONT) or (there < 0.0 and z < -there * (1.0 + IN_FRONT)):
            against += 1
        elif there > 0.0:
            return False
    return against >= MOST_AROUND


@exact_kernel
def between(image, u, v):
    """An image at a place in px, between its pixels; its border's beyond it."""
    height, width = image.shape
    u, v = min(max(u, 0.0), width - 1.0), min(max(v, 0.0), height - 1.0)
    left, top = min(int(u), max(width - 2, 0)), min(int(v), max(height - 2, 0))
    right, below = min(left + 1, width - 1), min(top + 1, height - 1)
    across, down = u - left, v - top
    above = (1.0 - across) * image[top, left] + across * image[top, right]
    return (1.0 - down) * above + down * ((1.0 - across) * image[below, left] + across * image[below, right])


@exact_kernel
def sampled(image, uv, scale, shift):
    """(N,) of an image at places (N, 2) px times scale plus shift, as between()."""
    out = np.zeros(uv.shape[0], np.float32)
    for n in range(uv.shape[0]):
        out[n] = between(image, uv[n, 0] * scale + shift, uv[n, 1] * scale + shift)
    return out


@exact_kernel
def mark_unlike(here, value, same, known, judged, unlike, limits):
    """Mark points that look otherwise in a sight that saw their depth, and that this could be said of them.

    here, value: (N,) float32 gray levels of the points and of what the sight saw. same, known, judged, unlike: (N,)
    whether it saw that depth, whether they surely are of the world, and what was said so far, which is filled. limits:
    known points that it takes to tell the exposure, and that are enough; gray levels that are otherwise.
    """
    few, most, least = limits
    count = 0
    for n in range(same.shape[0]):
        count += same[n] and known[n]
    if count < few:
        return
    stride = (count + most - 1) // most
    a, b = np.empty(most, np.float32), np.empty(most, np.float32)
    told, turn = 0, 0
    for n in range(same.shape[0]):
        if same[n] and known[n]:
            if turn % stride == 0:
                a[told], b[told] = here[n], value[n]
                told += 1
            turn += 1
    a, b = a[:told], b[:told]
    middle_a, middle_b = median(a), median(b)
    for n in range(told):
        a[n], b[n] = abs(a[n] - middle_a), abs(b[n] - middle_b)
    gain = median(b) / max(median(a), np.float32(1.0))
    for n in range(same.shape[0]):
        if same[n] and not judged[n]:
            unlike[n] |= abs(value[n] - middle_b - gain * (here[n] - middle_a)) > least
            judged[n] = True


@exact_kernel
def median(values):
    """Of float32 values (N,), at least one, which are reordered."""
    count, half = values.shape[0], values.shape[0] // 2
    high = smallest(values, count, half)
    if count % 2 == 1:
        return high
    low = values[0]
    for n in range(1, half):
        low = max(low, values[n])
    return np.float32(0.5) * (low + high)


@exact_kernel
def median_slopes(uv, inv_depth, index, T, intrinsics, size, there, here):
    """(points inside, medians of the steepest slopes, gray levels/px): around where a frame sees some points of
    another, and around where those are in that one; both on level 1, half as large.

    uv (N, 2) px, inv_depth (N,) 1/m, index (M,): the points. T: (4, 4) to the frame. size: its height and width.
    """
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    count = 0
    seen, own = np.zeros(index.shape[0], np.float32), np.zeros(index.shape[0], np.float32)
    for n in range(index.shape[0]):
        p = index[n]
        d = inv_depth[p]
        if d <= 0.0:
            continue
        x, y, z = moved(T, (uv[p, 0] - cx) / fx, (uv[p, 1] - cy) / fy, d)
        if z <= NEAREST_M * d:
            continue
        u, v = np.rint(fx * (x / z) + cx), np.rint(fy * (y / z) + cy)
        if not (u >= 0 and v >= 0 and u < size[1] and v < size[0]):  # nor no number
            continue
        seen[count] = steepest(there, int(u), int(v))
        own[count] = steepest(here, int(uv[p, 0]), int(uv[p, 1]))
        count += 1
    if count == 0:
        return 0, np.float32(0.0), np.float32(0.0)
    return count, median(seen[:count]), median(own[:count])


@exact_kernel
def steepest(image, u, v):
    """Gray levels/px of the steepest slope of an image on level 1 around a pixel of the finest level."""
    height, width = image.shape
    most = np.float32(0.0)
    for dv in range(-STEEP_PX, STEEP_PX + 1):
        y = min(max((v >> 1) + dv, 1), height - 2)
        for du in range(-STEEP_PX, STEEP_PX + 1):
            x = min(max((u >> 1) + du, 1), width - 2)
            across, down = image[y, x + 1] - image[y, x - 1], image[y + 1, x] - image[y - 1, x]
            most = max(most, across * across + down * down)
    return np.sqrt(most) * np.float32(0.5)
