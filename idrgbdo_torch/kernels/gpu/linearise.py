"""Normal equations of one pair on one level: twin of definitions/linearise.py, BLOCK points at a time.

rows (B, 6, N) are a point's u, v (px of level 0), inverse depth, its variance, its slopes along u and v (1/m per px of
level 0); patch (B, N, 8), gradient (B, N, 8, 2) and weight (B, N, 8) those of the level; numbers are NUMBERS, then the
pattern's u and v. All is computed in double precision.
"""

from __future__ import annotations

import triton
import triton.language as tl

from ... import measurement

PIXELS = tl.constexpr(measurement.PIXELS)
MIN_DEPTH = tl.constexpr(1e-3)  # m, of definitions/camera.py
AGREEMENT = tl.constexpr(0.05)  # of definitions/image.py
OTHER_SURFACE = tl.constexpr(measurement.OTHER_SURFACE)
CAP = tl.constexpr(4.0)  # of definitions/photometric.distortion_weight

# the level's camera, the side of its pixels in those of level 0, then the noise
NUMBERS = (
    "fx", "fy", "cx", "cy", "size", "var_intensity", "var_pixel", "var_depth", "shared", "c_h", "huber", "blend",
)  # fmt: skip
PATTERN_AT = tl.constexpr(len(NUMBERS))


@triton.jit
def linearise(pair, images, level, T, a, c, scale, limit, BLOCK: tl.constexpr):
    """H (8, 8), b (8,), energy and the points seen, at the pose T and the brightness (a, c); rms goes to level's.

    images: (image, height, width, inverse depth, its height and width, whether there is any, printed variance or not).
    level: (rows, patch, gradient, weight, numbers, rms, N).
    """
    rows, patch, gradient, weights, numbers, rms, N = level
    image, height, width = images[0], images[1], images[2]
    fx, fy = tl.load(numbers), tl.load(numbers + 1)
    cx, cy, size = tl.load(numbers + 2), tl.load(numbers + 3), tl.load(numbers + 4)
    var_intensity, var_pixel = tl.load(numbers + 5), tl.load(numbers + 6)
    shared, c_h = tl.load(numbers + 8), tl.load(numbers + 9)
    huber, blend = tl.load(numbers + 10), tl.load(numbers + 11)
    k = tl.arange(0, PIXELS)
    pattern_u, pattern_v = (
        tl.load(numbers + PATTERN_AT + k)[None, :],
        tl.load(numbers + PATTERN_AT + PIXELS + k)[None, :],
    )
    column = tl.arange(0, 8)[None, :]
    gain = tl.exp(a)
    H = tl.zeros((8, 8), tl.float64)
    b = tl.zeros((8,), tl.float64)
    energy = 0.0 * scale
    seen_points = 0 * N
    first = 0 * N
    while first < N:
        n = first + tl.arange(0, BLOCK)
        live = n < N
        row = rows + pair * 6 * N + n
        u, v = tl.load(row, mask=live, other=0.0), tl.load(row + N, mask=live, other=0.0)
        u, v = (u + 0.5) / size - 0.5, (v + 0.5) / size - 0.5
        d, var_d = tl.load(row + 2 * N, mask=live, other=0.0), tl.load(row + 3 * N, mask=live, other=0.0)
        slope_u, slope_v = tl.load(row + 4 * N, mask=live, other=0.0), tl.load(row + 5 * N, mask=live, other=0.0)
        slope_u, slope_v = tl.where(size > 1.0, 0.0, slope_u), tl.where(size > 1.0, 0.0, slope_v)
        exists = live & (d > 0.0) & (d < float("inf"))
        d = tl.where(exists, d, 1.0)

        # where the points are, and how their surroundings are distorted
        mx, my = (u - cx) / fx, (v - cy) / fy
        qx = T[0] * mx + T[1] * my + T[2] + T[3] * d
        qy = T[4] * mx + T[5] * my + T[6] + T[7] * d
        qz = T[8] * mx + T[9] * my + T[10] + T[11] * d
        seen = exists & (qz / d >= MIN_DEPTH)
        iz = 1.0 / tl.where(seen, qz, 1.0)
        x, y = qx * iz, qy * iz
        a00, a01 = (T[0] - x * T[8]) * iz, (T[1] - x * T[9]) * iz * fx / fy
        a10, a11 = (T[4] - y * T[8]) * iz * fy / fx, (T[5] - y * T[9]) * iz
        area = a00 * a11 - a01 * a10
        seen = seen & (area > 0.0) & (area < float("inf"))
        area = tl.where(seen, area, 1.0)
        h = tl.exp(tl.minimum(c_h * (area - 1.0) * (area - 1.0), CAP))
        du, dv = fx * (T[3] - x * T[11]) * iz, fy * (T[7] - y * T[11]) * iz

        # where their pixels fall
        along = slope_u[:, None] * pattern_u + slope_v[:, None] * pattern_v
        Z = qz[:, None] + T[8] / fx * pattern_u + T[9] / fy * pattern_v + T[11] * along
        there = seen[:, None] & (Z / (d[:, None] + along) >= MIN_DEPTH)
        iZ = 1.0 / tl.where(there, Z, 1.0)
        U = fx * (qx[:, None] + T[0] / fx * pattern_u + T[1] / fy * pattern_v + T[3] * along) * iZ + cx
        V = fy * (qy[:, None] + T[4] / fx * pattern_u + T[5] / fy * pattern_v + T[7] * along) * iZ + cy
        there = there & (tl.minimum(U, V) >= 1.0) & (width - 2.0 >= U) & (height - 2.0 >= V)
        seen = tl.min(there.to(tl.int32), axis=1) > 0
        seen_points += tl.sum(seen.to(tl.int32))
        value, gu, gv = sampled(image, pair, height, width, U, V, seen[:, None])

        # what they measure there; the variance comes from the host's gradient, see definitions/linearise.py
        pixel, here = pair * N * PIXELS + n[:, None] * PIXELS + k[None, :], live[:, None]
        reference = gain * tl.load(patch + pixel, mask=here, other=0.0).to(tl.float64)
        host_u = tl.load(gradient + 2 * pixel, mask=here, other=0.0).to(tl.float64)
        host_v = tl.load(gradient + 2 * pixel + 1, mask=here, other=0.0).to(tl.float64)
        weight = tl.load(weights + pixel, mask=here, other=1.0).to(tl.float64)
        moved_u = (a11 / area)[:, None] * host_u - (a10 / area)[:, None] * host_v
        moved_v = (a00 / area)[:, None] * host_v - (a01 / area)[:, None] * host_u
        by_depth_u, by_depth_v = moved_u * du[:, None], moved_v * dv[:, None]
        if images[7]:  # as the paper prints it
            variance = var_intensity + (by_depth_u * by_depth_u + by_depth_v * by_depth_v) * var_d[:, None]
        else:
            by_depth = by_depth_u + by_depth_v
            position = var_pixel * (moved_u * moved_u + moved_v * moved_v)
            variance = var_intensity + shared * (position + by_depth * by_depth * var_d[:, None])
        r = tl.where(seen[:, None], value - reference - c, 0.0)
        w = weight / (h[:, None] * variance * scale * scale)
        s2 = r * r * w
        s = tl.sqrt(s2)
        typical = tl.sqrt(tl.sum(s2, axis=1) / PIXELS)
        kept = seen & (typical <= limit)
        tl.store(rms + pair * N + n, tl.where(seen, typical * scale, -1.0), mask=live)
        m = tl.minimum(s, huber)
        energy += tl.sum(tl.where(kept, tl.sum(m * (2.0 * s - m), axis=1), 0.0))
        past = (seen & (typical > limit)).to(tl.int32)
        energy += tl.where(limit < float("inf"), tl.sum(past) * PIXELS * limit * limit, 0.0)
        w = tl.where(kept[:, None], w * huber / tl.maximum(s, huber), 0.0)
        gu, gv = (1.0 - blend) * gu + blend * moved_u, (1.0 - blend) * gv + blend * moved_v

        # summed over the pixels: what multiplies the rows (du/dxi, dv/dxi, -reference, -1) of the point
        wu, wv, wr = w * gu, w * gv, w * reference
        g00, g01, g11 = (
            tl.sum(wu * gu, axis=1)[:, None],
            tl.sum(wu * gv, axis=1)[:, None],
            tl.sum(wv * gv, axis=1)[:, None],
        )
        g02, g12 = -tl.sum(wu * reference, axis=1)[:, None], -tl.sum(wv * reference, axis=1)[:, None]
        g03, g13 = -tl.sum(wu, axis=1)[:, None], -tl.sum(wv, axis=1)[:, None]
        g22, g23, g33 = tl.sum(wr * reference, axis=1)[:, None], tl.sum(wr, axis=1)[:, None], tl.sum(w, axis=1)[:, None]
        c0, c1 = -tl.sum(wu * r, axis=1)[:, None], -tl.sum(wv * r, axis=1)[:, None]
        c2, c3 = tl.sum(wr * r, axis=1)[:, None], tl.sum(w * r, axis=1)[:, None]
        rho = (d * iz)[:, None]
        x, y = x[:, None], y[:, None]
        J_u = tl.where(column == 0, rho, tl.where(column == 2, -rho * x, 0.0))
        J_u = fx * tl.where(column == 3, -x * y, tl.where(column == 4, 1.0 + x * x, tl.where(column == 5, -y, J_u)))
        J_v = tl.where(column == 1, rho, tl.where(column == 2, -rho * y, 0.0))
        J_v = fy * tl.where(column == 3, -1.0 - y * y, tl.where(column == 4, x * y, tl.where(column == 5, x, J_v)))
        J_a, J_c = tl.where(column == 6, 1.0, 0.0), tl.where(column == 7, 1.0, 0.0)
        by_u = g00 * J_u + g01 * J_v + g02 * J_a + g03 * J_c
        by_v = g01 * J_u + g11 * J_v + g12 * J_a + g13 * J_c
        by_a = g02 * J_u + g12 * J_v + g22 * J_a + g23 * J_c
        by_c = g03 * J_u + g13 * J_v + g23 * J_a + g33 * J_c
        H += outer(J_u, by_u) + outer(J_v, by_v) + outer(J_a + 0.0 * rho, by_a) + outer(J_c + 0.0 * rho, by_c)
        b += tl.sum(c0 * J_u + c1 * J_v + c2 * J_a + c3 * J_c, axis=0)
        if images[6]:
            mean_weight = tl.sum(weight, axis=1) / PIXELS
            place = (x, y, rho, iz)
            J, wd, rd, cost = depth_row(
                pair, images, numbers, (J_u, J_v), place, var_d / mean_weight, mean_weight, kept
            )
            H += outer(J, wd * J)
            b -= tl.sum(wd * rd * J, axis=0)
            energy += cost
        first += BLOCK
    return H, b, energy, seen_points


@triton.jit
def outer(A, B):
    """A^T B (8, 8) of (BLOCK, 8)."""
    return tl.sum(A[:, :, None] * B[:, None, :], axis=0)


@triton.jit
def sampled(image, pair, height, width, u, v, there):
    """Twin of image.sample_with_gradient: bilinear value and gradient at (u, v), where `there`, else zero."""
    left = tl.minimum(tl.where(there, u, 1.0).to(tl.int32), width - 3)
    top = tl.minimum(tl.where(there, v, 1.0).to(tl.int32), height - 3)
    a, b = u - left, v - top
    at = image + pair.to(tl.int64) * height * width + top * width + left
    i00, i01 = pixel_at(at, there), pixel_at(at + 1, there)
    i10, i11 = pixel_at(at + width, there), pixel_at(at + width + 1, there)
    west0, west1 = pixel_at(at - 1, there), pixel_at(at + width - 1, there)
    east0, east1 = pixel_at(at + 2, there), pixel_at(at + width + 2, there)
    north0, north1 = pixel_at(at - width, there), pixel_at(at - width + 1, there)
    south0, south1 = pixel_at(at + 2 * width, there), pixel_at(at + 2 * width + 1, there)
    row0, row1 = i00 + a * (i01 - i00), i10 + a * (i11 - i10)
    value = row0 + b * (row1 - row0)
    west, east = west0 + b * (west1 - west0), east0 + b * (east1 - east0)
    col0, col1 = i00 + b * (i10 - i00), i01 + b * (i11 - i01)
    gu = 0.5 * ((col1 + a * (east - col1)) - (west + a * (col0 - west)))
    north, south = north0 + a * (north1 - north0), south0 + a * (south1 - south0)
    gv = 0.5 * ((row1 + b * (south - row1)) - (north + b * (row0 - north)))
    return tl.where(there, value, 0.0), tl.where(there, gu, 0.0), tl.where(there, gv, 0.0)


@triton.jit
def pixel_at(address, there):
    """A pixel in double precision."""
    return tl.load(address, mask=there, other=0.0).to(tl.float64)


@triton.jit
def depth_row(pair, images, numbers, J, place, var_d, mean_weight, kept):
    """J (BLOCK, 8), weight and residual (BLOCK, 1) and the summed cost of measured against warped inverse depth.

    J: of the pixel's u and v on the level; place: (x, y, inverse depth, 1 / z) in the target; var_d: (BLOCK,) over the
    mean weight. Where a pixel falls is computed as kernels/equations.py does it: at the start it often lies between
    four, and they must be the same four.
    """
    depth, height, width = images[3], images[4], images[5]
    x, y, rho, iz = place
    size = tl.load(numbers + 4)
    u = (tl.load(numbers) * x + tl.load(numbers + 2) + 0.5) * size - 0.5  # (BLOCK, 1), level 0
    v = (tl.load(numbers + 1) * y + tl.load(numbers + 3) + 0.5) * size - 0.5
    on = kept[:, None] & (u >= 0.0) & (u <= width - 1.0) & (v >= 0.0) & (v <= height - 1.0)
    left = tl.minimum(tl.where(on, u, 0.0).to(tl.int32), width - 2)
    top = tl.minimum(tl.where(on, v, 0.0).to(tl.int32), height - 2)
    at = depth + pair.to(tl.int64) * height * width + top * width + left
    d00, d01 = pixel_at(at, on), pixel_at(at + 1, on)
    d10, d11 = pixel_at(at + width, on), pixel_at(at + width + 1, on)
    low = tl.minimum(tl.minimum(d00, d01), tl.minimum(d10, d11))
    high = tl.maximum(tl.maximum(d00, d01), tl.maximum(d10, d11))
    on = on & (low > 0.0) & (high <= (1.0 + AGREEMENT) * low)
    a, b = u - left, v - top
    row0, row1 = d00 + a * (d01 - d00), d10 + a * (d11 - d10)
    r = tl.where(on, row0 + b * (row1 - row0) - rho, 0.0)
    gu = size * tl.where(on, (d01 - d00) + b * ((d11 - d10) - (d01 - d00)), 0.0)  # 1/m per px of the level
    gv = size * tl.where(on, (d10 - d00) + a * ((d11 - d01) - (d10 - d00)), 0.0)
    column = tl.arange(0, 8)[None, :]
    with_depth = tl.where(column == 2, rho * rho, tl.where(column == 3, rho * y, tl.where(column == 4, -rho * x, 0.0)))
    row = gu * J[0] + gv * J[1] + with_depth
    position = tl.load(numbers + 8) * tl.load(numbers + 6) * (gu * gu + gv * gv)
    stretch = (iz * iz)[:, None]
    variance = (tl.load(numbers + 7) + position) / mean_weight[:, None] + stretch * stretch * var_d[:, None]
    s = tl.abs(r) / tl.sqrt(variance)
    huber = tl.load(numbers + 10)
    most = tl.minimum(s, OTHER_SURFACE * huber)
    m = tl.minimum(most, huber)
    cost = tl.sum(tl.where(on, m * (2.0 * most - m), 0.0))
    trusted = on & (s <= OTHER_SURFACE * huber)
    weight = tl.where(trusted, huber / tl.maximum(s, huber) / variance, 0.0)
    return row, weight, r, cost
