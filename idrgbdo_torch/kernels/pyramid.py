"""The gray pyramid: halving by 2x2 means, and a small blur, in one pass over the rows of an image each."""

from __future__ import annotations

import numpy as np

from .compiled import exact_kernel

REACH = 2  # px, of the blur to either side


@exact_kernel
def halve(image, out):
    """Means of 2x2 pixels of an image (H, W) float32; out: (H // 2, W // 2), or 1 where that is 0."""
    height, width = out.shape
    quarter = np.float32(0.25)
    for v in range(height):
        upper, lower = image[2 * v], image[min(2 * v + 1, image.shape[0] - 1)]
        for u in range(min(width, image.shape[1] // 2)):
            out[v, u] = ((upper[2 * u] + upper[2 * u + 1]) + (lower[2 * u] + lower[2 * u + 1])) * quarter
        if image.shape[1] == 1:
            out[v, 0] = 0.5 * (upper[0] + lower[0])


@exact_kernel
def smooth(image, taps, out):
    """Blur an image (H, W) float32 by taps (3,) float32: the weights of a pixel, and of those 1 and 2 px away.

    Both ways, mirrored about the pixels at the border. out: (H, W), another array.
    """
    height, width = image.shape
    middle, near, far = taps[0], taps[1], taps[2]
    row = np.empty(width + 2 * REACH, np.float32)
    for v in range(height):
        above2, above1 = image[mirrored(v - 2, height)], image[mirrored(v - 1, height)]
        here = image[v]
        below1, below2 = image[mirrored(v + 1, height)], image[mirrored(v + 2, height)]
        for u in range(width):
            row[u + 2] = middle * here[u] + near * (above1[u] + below1[u]) + far * (above2[u] + below2[u])
        for k in range(1, REACH + 1):
            row[REACH - k] = row[REACH + mirrored(-k, width)]
            row[REACH + width - 1 + k] = row[REACH + mirrored(width - 1 + k, width)]
        for u in range(width):
            out[v, u] = middle * row[u + 2] + near * (row[u + 1] + row[u + 3]) + far * (row[u] + row[u + 4])


@exact_kernel
def mirrored(i, count):
    """The pixel that stands for pixel i of so many, where that lies beyond the border."""
    if count == 1:
        return 0
    while i < 0 or i >= count:
        i = -i if i < 0 else 2 * (count - 1) - i
    return i
