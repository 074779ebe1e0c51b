"""What patches tell: their pixels' residuals, weights and gradients, summed point by point (Eqs. 2, 6 to 9).

The hot loop of tracking and of the window. Points come LANES at a time; what is known of them lies in short arrays, a
row of LANES numbers for each quantity, so that most steps are loops over lanes that the processor does several at once.
Lanes without a point, and points that cannot be seen, are computed along and not looked at.

Kernels of lanes are exact: the compiler may take lanes at once or one by one, by where arrays happen to lie, and only
operations that round as written give the same bits both ways.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from ..measurement import PATTERNS, PIXELS, Array
from .compiled import exact_kernel
from .image import interpolate
from .photometric import along_depth, distortion, distortion_weight, moved, photometric_variance

LANES = 24

# rows of a point; the first seven are its caller's to fill
U, V, D, VAR_D, SLOPE_U, SLOPE_V, LIVE = (LANES * i for i in range(7))
# in the target
X, Y, IZ, RHO, AREA, QX, QY, QZ, SEEN, WEIGHT = (LANES * i for i in range(7, 17))
B00, B01, B10, B11, DU, DV = (LANES * i for i in range(17, 23))
# sums over its pixels: products of [g_u, g_v, -reference, -1], minus their products with the residual, and the cost
G00, G01, G11, G02, G12, G03, G13, G22, G23, G33 = (LANES * i for i in range(23, 33))
C0, C1, C2, C3, ENERGY, SQUARES = (LANES * i for i in range(33, 39))
SUMS, POINT_ROWS = G00, LANES * 39
# rows of a pixel of the pattern: gray level and gradient in the host, its caller's to fill, and twelve for what the
# target holds around it
VALUE, GRADIENT_U, GRADIENT_V, AROUND = (LANES * i for i in range(4))
PIXEL_ROWS = LANES * 15
AT_U, AT_V = 0, LANES * PIXELS  # and where that is, a row for each pixel


class Room(NamedTuple):
    """Where LANES points are computed."""

    points: Array  # (POINT_ROWS,)
    pixels: Array  # (PIXELS PIXEL_ROWS,) float32
    places: Array  # (2 PIXELS LANES,) px
    lanes: int  # that are in use; a number that the compiler does not know, or it would take them one by one
    used: int  # pixels of the pattern that take part,
    pattern: int  # and which one


class Brightness(NamedTuple):
    """How the target's gray levels follow from the host's, and the scale of their residuals."""

    gain: float
    before: float  # gray levels taken from the host's first
    offset: float
    weight: float  # of every squared residual: 1 over the squared robust scale


@exact_kernel
def new_room(count, pattern):
    """Room for LANES points, of whose patterns so many pixels take part."""
    return Room(
        np.zeros(POINT_ROWS),
        np.zeros(PIXELS * PIXEL_ROWS, np.float32),
        np.zeros(2 * PIXELS * LANES),
        LANES,
        count,
        pattern,
    )


@exact_kernel
def lanes_for(room, points):
    """The same room with lanes enough for so many points, or all that it has."""
    return Room(room.points, room.pixels, room.places, min(LANES, (points + 3) // 4 * 4), room.used, room.pattern)


@exact_kernel
def patch_sums(image, camera, T, bright, noise, room, weights=None):
    """Fill all rows that the caller has not: what LANES points of a host tell about a target.

    image (H, W), camera (fx, fy, cx, cy) of it; T: T_target_host. weights: factors on the information of pixels, a
    row of lanes for each.
    """
    place(camera, T, noise, room.points, room.lanes)
    project(image, camera, T, room)
    gather(image, room)
    room.points[SUMS:] = 0.0
    for k in range(room.used):
        add_pixel(k, bright, noise, room, weights)


@exact_kernel
def place(camera, T, noise, points, lanes):
    """Where the points are in the target, and how their surroundings are distorted there."""
    fx, fy, cx, cy = camera
    for n in range(lanes):
        d = points[D + n]
        qx, qy, qz = moved(T, (points[U + n] - cx) / fx, (points[V + n] - cy) / fy, d)
        iz = 1.0 / qz
        x = qx * iz
        y = qy * iz
        a00, a01, a10, a11, area = distortion(T, x, y, iz, fx, fy)
        points[QX + n], points[QY + n], points[QZ + n] = qx, qy, qz
        points[X + n], points[Y + n], points[IZ + n] = x, y, iz
        points[RHO + n] = d * iz  # inverse depth in the target
        points[AREA + n] = area
        # a gradient of the host seen from the target: (dp_target/dp_host)^-T g
        points[B00 + n], points[B01 + n] = a11 / area, -a10 / area
        points[B10 + n], points[B11 + n] = -a01 / area, a00 / area
        points[DU + n], points[DV + n] = along_depth(T, x, y, iz, fx, fy)
        points[SEEN + n] = points[LIVE + n] if (qz >= 1e-3) & (area > 0.0) else 0.0
    for n in range(lanes):
        seen = points[SEEN + n] > 0.0
        points[WEIGHT + n] = 1.0 / distortion_weight(points[AREA + n], noise.c_h) if seen else 0.0


@exact_kernel
def place_again(camera, T, points, lanes):
    """Move the points, for Jacobians taken at another pose; where they are seen stays."""
    fx, fy, cx, cy = camera
    for n in range(lanes):
        d = points[D + n]
        qx, qy, qz = moved(T, (points[U + n] - cx) / fx, (points[V + n] - cy) / fy, d)
        iz = 1.0 / max(qz, 1e-3)
        x = qx * iz
        y = qy * iz
        points[X + n], points[Y + n], points[IZ + n] = x, y, iz
        points[RHO + n] = d * iz
        points[DU + n], points[DV + n] = along_depth(T, x, y, iz, fx, fy)


@exact_kernel
def project(image, camera, T, room):
    """Where the pixels fall; a point is seen where all of them can be sampled."""
    points, places, lanes = room.points, room.places, room.lanes
    fx, fy, cx, cy = camera
    height, width = image.shape
    right, bottom = width - 2.0, height - 2.0
    xu, yu, zu = T[0, 0] / fx, T[1, 0] / fx, T[2, 0] / fx
    xv, yv, zv = T[0, 1] / fy, T[1, 1] / fy, T[2, 1] / fy
    xd, yd, zd = T[0, 3], T[1, 3], T[2, 3]
    for k in range(room.used):
        a, b = PATTERNS[room.pattern, k, 0], PATTERNS[room.pattern, k, 1]
        row = LANES * k
        for n in range(lanes):
            od = points[SLOPE_U + n] * a + points[SLOPE_V + n] * b
            z = points[QZ + n] + zu * a + zv * b + zd * od
            iz = 1.0 / z
            u = fx * (points[QX + n] + xu * a + xv * b + xd * od) * iz + cx
            v = fy * (points[QY + n] + yu * a + yv * b + yd * od) * iz + cy
            places[AT_U + row + n] = u
            places[AT_V + row + n] = v
            inside = (z >= 1e-3) & (u >= 1.0) & (v >= 1.0) & (u < right) & (v < bottom)
            points[SEEN + n] = points[SEEN + n] if inside else 0.0


@exact_kernel
def gather(image, room):
    """Copy the target around each pixel; what is left of the places is the fractions."""
    points, pixels, places, lanes = room.points, room.pixels, room.places, room.lanes
    one, two = np.uint64(1), np.uint64(2)  # unsigned: no check for negative indices
    for n in range(lanes):
        if points[SEEN + n] == 0.0:
            continue
        for k in range(room.used):
            at = LANES * k + n
            u, v = places[AT_U + at], places[AT_V + at]
            iu, iv = np.uint64(u), np.uint64(v)
            places[AT_U + at] = u - np.float64(iu)
            places[AT_V + at] = v - np.float64(iv)
            to = PIXEL_ROWS * k + AROUND + n
            pixels[to] = image[iv, iu]
            pixels[to + LANES] = image[iv, iu + one]
            pixels[to + 2 * LANES] = image[iv + one, iu]
            pixels[to + 3 * LANES] = image[iv + one, iu + one]
            pixels[to + 4 * LANES] = image[iv, iu - one]
            pixels[to + 5 * LANES] = image[iv + one, iu - one]
            pixels[to + 6 * LANES] = image[iv, iu + two]
            pixels[to + 7 * LANES] = image[iv + one, iu + two]
            pixels[to + 8 * LANES] = image[iv - one, iu]
            pixels[to + 9 * LANES] = image[iv - one, iu + one]
            pixels[to + 10 * LANES] = image[iv + two, iu]
            pixels[to + 11 * LANES] = image[iv + two, iu + one]


@exact_kernel
def add_pixel(k, bright, noise, room, weights=None):
    """Add pixel k to the sums.

    The variance comes from the host's gradient: it must not change with the pose, or the cost would reward places where
    the residual is merely less certain.
    """
    points, lanes = room.points, room.lanes
    # rows of their own: of an index made of two numbers the compiler does not know that neighbours lie side by side
    pixels = room.pixels[PIXEL_ROWS * k : PIXEL_ROWS * (k + 1)]
    at_u, at_v = room.places[AT_U + LANES * k : AT_V], room.places[AT_V + LANES * k :]
    blend, huber = noise.gradient_blend, noise.huber
    for n in range(lanes):
        to = AROUND + n
        around = (
            np.float64(pixels[to]), np.float64(pixels[to + LANES]),
            np.float64(pixels[to + 2 * LANES]), np.float64(pixels[to + 3 * LANES]),
            np.float64(pixels[to + 4 * LANES]), np.float64(pixels[to + 5 * LANES]),
            np.float64(pixels[to + 6 * LANES]), np.float64(pixels[to + 7 * LANES]),
            np.float64(pixels[to + 8 * LANES]), np.float64(pixels[to + 9 * LANES]),
            np.float64(pixels[to + 10 * LANES]), np.float64(pixels[to + 11 * LANES]),
        )  # fmt: skip
        value, gu, gv = interpolate(around, at_u[n], at_v[n])
        reference = bright.gain * (np.float64(pixels[VALUE + n]) - bright.before)
        r = value - reference - bright.offset
        ru, rv = np.float64(pixels[GRADIENT_U + n]), np.float64(pixels[GRADIENT_V + n])
        su = points[B00 + n] * ru + points[B01 + n] * rv
        sv = points[B10 + n] * ru + points[B11 + n] * rv
        variance = photometric_variance(su, sv, points[DU + n], points[DV + n], points[VAR_D + n], noise)
        gu = (1.0 - blend) * gu + blend * su
        gv = (1.0 - blend) * gv + blend * sv
        w = bright.weight * points[WEIGHT + n] / variance
        if weights is not None:
            w *= weights[LANES * k + n]
        s2 = r * r * w
        s = sqrt(s2)
        m = min(s, huber)
        points[SQUARES + n] += s2
        points[ENERGY + n] += m * (2.0 * s - m)
        w *= huber / max(s, huber)
        wu = w * gu
        wv = w * gv
        wr = w * reference
        points[G00 + n] += wu * gu
        points[G01 + n] += wu * gv
        points[G11 + n] += wv * gv
        points[G02 + n] -= wu * reference
        points[G12 + n] -= wv * reference
        points[G03 + n] -= wu
        points[G13 + n] -= wv
        points[G22 + n] += wr * reference
        points[G23 + n] += wr
        points[G33 + n] += w
        points[C0 + n] -= wu * r
        points[C1 + n] -= wv * r
        points[C2 + n] += wr * r
        points[C3 + n] += w * r


@exact_kernel
def forget_unseen(room):
    """Lanes that are not seen (any more) get sums of 0 and a place that harms nobody."""
    points = room.points
    for n in range(room.lanes):
        if points[SEEN + n] == 0.0:
            for row in range(SUMS, POINT_ROWS, LANES):
                points[row + n] = 0.0
            points[X + n] = points[Y + n] = points[RHO + n] = 0.0
