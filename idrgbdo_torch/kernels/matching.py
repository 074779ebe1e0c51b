"""Binary descriptors of two images against each other, each pair looked at once, and which matches could be rigid."""

from __future__ import annotations

from math import sqrt

import numpy as np

from .compiled import kernel
from .solver import put

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
    sums, away = np.empty(k, np.uint64), np.empty(k, np.int32)
    chosen = np.full(n, -1, np.int64)
    back = np.full(k, -1, np.int32)
    nearest_back = np.full(k, FARTHEST, np.int32)
    for i in range(n):
        sums[:] = np.uint64(0)
        for w in range(words):
            add_different(host[i, w], across[w], sums)
        for j in range(k):
            away[j] = np.int32(sums[j])
        bring_nearer(np.int32(i), away, nearest_back, back)
        best = least(away)
        found = 0
        while found < k and away[found] != best:
            found += 1
        if found < k:
            away[found] = FARTHEST
            if best < ratio * least(away):
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


@kernel
def add_different(word, row, sums):
    """Add in how many bits a word differs from each of a row."""
    for j in range(sums.shape[0]):
        sums[j] += bits_set(word ^ row[j])


@kernel
def least(away):
    """The smallest of some distances, FARTHEST if there is none."""
    best = np.int32(FARTHEST)
    for j in range(away.shape[0]):
        best = away[j] if away[j] < best else best
    return best


@kernel
def bring_nearer(number, away, nearest, back):
    """Where a number is nearer than what was nearest, it is that."""
    for j in range(away.shape[0]):
        nearer = away[j] < nearest[j]
        back[j] = number if nearer else back[j]
        nearest[j] = away[j] if nearer else nearest[j]


@kernel
def rigid_triples(P, Q, triples, most, limits):
    """The first triples (<= most, 3) of matched points whose triangle is as large in both views, as both know depth.

    P, Q: (M, 3) m. triples: (N, 3) of them. limits: by which sides may differ, share and m at a depth of 1 m, and the
    shortest one's share of the depth.
    """
    share, metres, apart = limits
    out = np.empty((min(most, triples.shape[0]), 3), np.int64)
    count = 0
    for n in range(triples.shape[0]):
        if count == out.shape[0]:
            break
        far = 0.0
        for k in range(3):
            far = max(far, max(P[triples[n, k], 2], Q[triples[n, k], 2]))
        alike = True
        for k in range(3):
            a, b = triples[n, k], triples[n, (k + 1) % 3]
            side, other = distance(P, a, b), distance(Q, a, b)
            alike &= abs(side - other) < share * side + metres * far * far and side > apart * far
        if alike:
            put(triples[n], out[count])
            count += 1
    return out[:count]


@kernel
def distance(P, a, b):
    """Between two points of (M, 3)."""
    x, y, z = P[a, 0] - P[b, 0], P[a, 1] - P[b, 1], P[a, 2] - P[b, 2]
    return sqrt(x * x + y * y + z * z)
