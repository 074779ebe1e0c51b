"""Binary descriptors of two images against each other, each pair looked at once."""

from __future__ import annotations

import numpy as np

from .compiled import kernel

FARTHEST = 1 << 16  # more bits than any descriptor has


@kernel
def bits_set(word):
    """How many bits of a 64-bit word are 1."""
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + ((word >> np.uint64(2)) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (word * np.uint64(0x0101010101010101)) >> np.uint64(56)


@kernel
def mutual_matches(host, target, ratio):
    """(M, 2) numbers of a host's descriptor and the target's that is clearly nearest to it, and it to that one.

    host: (N, W), target: (K, W) uint64 words. ratio: of the distance to the nearest over that to the second-nearest,
    in bits. Of equally near ones the first counts.
    """
    n, words, k = host.shape[0], host.shape[1], target.shape[0]
    across = np.ascontiguousarray(target.T)
    away = np.empty(k, np.uint64)
    chosen = np.full(n, -1, np.int64)
    back = np.full(k, -1, np.int64)
    nearest_back = np.full(k, FARTHEST, np.int64)
    for i in range(n):
        away[:] = np.uint64(0)
        for w in range(words):
            word, row = host[i, w], across[w]
            for j in range(k):
                away[j] += bits_set(word ^ row[j])
        best, second, found = FARTHEST, FARTHEST, -1
        for j in range(k):
            bits = int(away[j])
            if bits < second:
                if bits < best:
                    best, second, found = bits, best, j
                else:
                    second = bits
            if bits < nearest_back[j]:
                nearest_back[j] = bits
                back[j] = i
        if best < ratio * second:
            chosen[i] = found
    count = 0
    out = np.empty((n, 2), np.int64)
    for i in range(n):
        j = chosen[i]
        if j >= 0 and back[j] == i:
            out[count, 0] = i
            out[count, 1] = j
            count += 1
    return out[:count]
