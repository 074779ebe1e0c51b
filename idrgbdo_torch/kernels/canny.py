"""The edges of an image (Canny 1986), bit for bit those of OpenCV's Canny with its L2 norm, some times faster."""

from __future__ import annotations

import numpy as np

from .compiled import exact_kernel

NEITHER, STRONG = np.uint8(1), np.uint8(2)  # a pixel that is no edge, one that is; 0 is an edge if it hangs on one


@exact_kernel
def edges(image, low, high):
    """(H, W) uint8, 255 on an edge, of an image (H, W) float32 whose gray levels count without their fractions.

    low, high: gray levels of the gradient's length as Sobel's 3x3 filter has it, eight times that of a pixel's step.
    All numbers are whole and below 2^24, or such times a power of two, so that float32 is exact.
    """
    height, width = image.shape
    wide = (width + 2 + 7) // 8 * 8
    state = np.full((height + 2, wide), NEITHER, np.uint8)
    gray = np.zeros((3, width + 2), np.float32)
    along, across = np.zeros((3, width + 2), np.float32), np.zeros((3, width + 2), np.float32)
    size = np.zeros((3, width + 2), np.float32)
    low2, high2 = np.float32(low * low), np.float32(high * high)
    whole_pixels(image[0], gray[0])
    whole_pixels(image[0], gray[1])
    for v in range(height + 1):
        if v < height:
            whole_pixels(image[min(v + 1, height - 1)], gray[(v + 2) % 3])
            slopes(gray[v % 3], gray[(v + 1) % 3], gray[(v + 2) % 3], along[v % 3], across[v % 3], size[v % 3])
        else:
            size[v % 3] = np.float32(0.0)
        if v > 0:
            w = (v - 1) % 3
            ridges(size[(v - 2) % 3], size[w], size[v % 3], along[w], across[w], (low2, high2), state[v])
    grow(state)
    out = np.empty((height, width), np.uint8)
    for v in range(height):
        here, to = state[v + 1], out[v]
        for u in range(width):
            to[u] = np.uint8(255) if here[u + 1] == STRONG else np.uint8(0)
    return out


@exact_kernel
def whole_pixels(image, out):
    """Fill a row of pixels without their fractions, and repeat the outermost; what is no gray level becomes 0."""
    width = image.shape[0]
    for u in range(width):
        value = image[u]
        value = value if (value >= np.float32(0.0)) & (value < np.float32(256.0)) else np.float32(0.0)
        out[u + 1] = np.float32(np.int32(value))
    out[0], out[width + 1] = out[1], out[width]


@exact_kernel
def slopes(above, here, below, along, across, size):
    """Fill a row of Sobel's slopes to the right and down, and their squared length; 0 beside the image."""
    for u in range(1, here.shape[0] - 1):
        right = (above[u + 1] + here[u + 1]) + (here[u + 1] + below[u + 1])
        left = (above[u - 1] + here[u - 1]) + (here[u - 1] + below[u - 1])
        du = right - left
        dv = ((below[u - 1] + below[u]) + (below[u] + below[u + 1])) - (
            (above[u - 1] + above[u]) + (above[u] + above[u + 1])
        )
        along[u], across[u] = du, dv
        size[u] = du * du + dv * dv


@exact_kernel
def ridges(above, here, below, along, across, limits, state):
    """Fill a row of states: where the slope is above a limit and largest along its own direction, to 45 degrees."""
    low2, high2 = limits
    shift, slope = np.float32(32768.0), np.float32(13573.0)  # tan(22.5 degrees) in units of 2^-15
    two, nought = np.float32(2.0), np.float32(0.0)
    for u in range(1, here.shape[0] - 1):
        m = here[u]
        x, y = abs(along[u]), abs(across[u])
        level = (m > here[u - 1]) & (m >= here[u + 1])
        upright = (m > above[u]) & (m >= below[u])
        falling = (m > above[u - 1]) & (m > below[u + 1])
        rising = (m > above[u + 1]) & (m > below[u - 1])
        flat, steep = y * shift < x * slope, shift * (y - two * x) > x * slope
        slanted = rising if along[u] * across[u] < nought else falling
        largest = level if flat else (upright if steep else slanted)
        found = STRONG if m > high2 else np.uint8(0)
        state[u] = found if largest & (m > low2) else NEITHER


@exact_kernel
def grow(state):
    """Weak pixels that touch a strong one, over any number of others, become strong."""
    wide = state.shape[1]
    flat = state.ravel()
    words = flat.view(np.uint64)
    waiting = np.empty(flat.size, np.int32)
    count = 0
    for w in range(words.size):
        if words[w] & np.uint64(0x0202020202020202):
            for i in range(8 * w, 8 * w + 8):
                if flat[i] == STRONG:
                    waiting[count] = i
                    count += 1
    while count > 0:
        count -= 1
        at = np.int64(waiting[count])
        for row in (at - wide, at, at + wide):
            for j in range(row - 1, row + 2):
                if flat[j] == 0:
                    flat[j] = STRONG
                    waiting[count] = j
                    count += 1
