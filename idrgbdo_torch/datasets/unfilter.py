"""The last step of reading a PNG: its rows are stored as differences to what is left of and above each byte."""

from __future__ import annotations

import numpy as np

from ..kernels.compiled import kernel

NONE, SUB, UP, AVERAGE, PAETH = range(5)  # what a row was predicted from, its first byte


@kernel
def paeth(left, above, corner):
    """The one of the three nearest to left + above - corner; of equally near ones the first.

    Written without its three distances, which make the longest chain of operations from byte to byte.
    """
    middle = 3 * corner - left - above
    low = min(left, above)
    high = max(left, above)
    nearest = low if high <= middle else corner
    return high if middle <= low else nearest


@kernel
def unfilter_gray16(stored, image):
    """Fill image, (H, W) uint16, from stored, (H * (1 + 2 W),) uint8. False for a kind of row that does not exist."""
    height, width = image.shape
    above = np.zeros(width, np.uint16)
    for v in range(height):
        row = stored[v * (1 + 2 * width) : (v + 1) * (1 + 2 * width)]
        kind = row[0]
        out = image[v]
        a = 0  # left, high and low byte
        b = 0
        if kind == NONE:
            for u in range(width):
                out[u] = (row[2 * u + 1] << 8) | row[2 * u + 2]
        elif kind == SUB:
            for u in range(width):
                a = (a + row[2 * u + 1]) & 255
                b = (b + row[2 * u + 2]) & 255
                out[u] = (a << 8) | b
        elif kind == UP:
            for u in range(width):
                high = (row[2 * u + 1] + (above[u] >> 8)) & 255
                low = (row[2 * u + 2] + above[u]) & 255
                out[u] = (high << 8) | low
        elif kind == AVERAGE:
            for u in range(width):
                up = np.int64(above[u])
                a = (row[2 * u + 1] + ((a + (up >> 8)) >> 1)) & 255
                b = (row[2 * u + 2] + ((b + (up & 255)) >> 1)) & 255
                out[u] = (a << 8) | b
        elif kind == PAETH:
            a_corner = np.int64(0)
            b_corner = np.int64(0)
            for u in range(width):
                a_up = np.int64(above[u]) >> 8
                b_up = np.int64(above[u]) & 255
                a = (row[2 * u + 1] + paeth(a, a_up, a_corner)) & 255
                b = (row[2 * u + 2] + paeth(b, b_up, b_corner)) & 255
                a_corner = a_up
                b_corner = b_up
                out[u] = (a << 8) | b
        else:
            return False
        above = out
    return True


@kernel
def unfilter_color(stored, image, step):
    """Fill image, (H, W, 3) uint8 blue, green, red, from stored, (H * (1 + step W),) uint8 red, green, blue, ...

    step: bytes of a stored pixel, 3, or 4 with an alpha channel, which nothing else depends on and is left out.
    False for a kind of row that does not exist.
    """
    height, width, _ = image.shape
    above = np.zeros((width, 3), np.uint8)
    for v in range(height):
        row = stored[v * (1 + step * width) : (v + 1) * (1 + step * width)]
        kind = row[0]
        out = image[v]
        r = 0  # left
        g = 0
        b = 0
        at = 1
        if kind == NONE:
            for u in range(width):
                out[u, 2] = row[at]
                out[u, 1] = row[at + 1]
                out[u, 0] = row[at + 2]
                at += step
        elif kind == SUB:
            for u in range(width):
                r = (r + row[at]) & 255
                g = (g + row[at + 1]) & 255
                b = (b + row[at + 2]) & 255
                out[u, 2] = r
                out[u, 1] = g
                out[u, 0] = b
                at += step
        elif kind == UP:
            for u in range(width):
                out[u, 2] = row[at] + above[u, 2]
                out[u, 1] = row[at + 1] + above[u, 1]
                out[u, 0] = row[at + 2] + above[u, 0]
                at += step
        elif kind == AVERAGE:
            for u in range(width):
                r = (row[at] + ((r + above[u, 2]) >> 1)) & 255
                g = (row[at + 1] + ((g + above[u, 1]) >> 1)) & 255
                b = (row[at + 2] + ((b + above[u, 0]) >> 1)) & 255
                out[u, 2] = r
                out[u, 1] = g
                out[u, 0] = b
                at += step
        elif kind == PAETH:
            r_corner = np.int64(0)
            g_corner = np.int64(0)
            b_corner = np.int64(0)
            for u in range(width):
                r_up = np.int64(above[u, 2])
                g_up = np.int64(above[u, 1])
                b_up = np.int64(above[u, 0])
                r = (row[at] + paeth(r, r_up, r_corner)) & 255
                g = (row[at + 1] + paeth(g, g_up, g_corner)) & 255
                b = (row[at + 2] + paeth(b, b_up, b_corner)) & 255
                r_corner = r_up
                g_corner = g_up
                b_corner = b_up
                out[u, 2] = r
                out[u, 1] = g
                out[u, 0] = b
                at += step
        else:
            return False
        above = out
    return True
