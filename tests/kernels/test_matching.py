"""The matcher is OpenCV's: nearest in both directions, and clearly so, equal distances included."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from idrgbdo_torch.kernels.matching import mutual_matches, rigid_triples

RATIO = 0.8


def by_opencv(host: NDArray[np.uint8], target: NDArray[np.uint8]) -> list[tuple[int, int]]:
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    there = matcher.knnMatch(host, target, k=2)
    clear = [(best.queryIdx, best.trainIdx) for best, second in there if best.distance < RATIO * second.distance]
    back = {found.queryIdx: found.trainIdx for found in matcher.match(target, host)}
    return [(i, j) for i, j in clear if back[j] == i]


@pytest.mark.parametrize("seed", range(4))
def test_matches_are_opencvs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    host = rng.integers(0, 256, (90, 32), np.uint8)
    target = rng.integers(0, 256, (70, 32), np.uint8)
    seen = rng.permutation(70)[:40]
    target[seen] = host[:40] ^ np.packbits(rng.random((40, 256)) < 0.1, axis=1)  # a tenth of the bits is noise
    host[80:] = host[:10]  # equally near ones
    found = mutual_matches(host.view(np.uint64), target.view(np.uint64), RATIO)
    assert [(int(i), int(j)) for i, j in found] == by_opencv(host, target)
    assert len(found) > 20


def test_the_same_twice_is_no_clear_match() -> None:
    host = np.arange(4, dtype=np.uint64)[None]
    assert len(mutual_matches(host, np.concatenate([host, host]), RATIO)) == 0
    assert mutual_matches(host, np.concatenate([host, ~host]), RATIO).tolist() == [[0, 0]]


def test_triples_that_could_be_rigid_are_the_first_whose_sides_agree() -> None:
    rng = np.random.default_rng(0)
    P = rng.uniform(-1.0, 1.0, (60, 3)) + [0.0, 0.0, 2.0]
    Q = P + [0.1, -0.2, 0.05]
    Q[40:] = rng.uniform(-1.0, 1.0, (20, 3)) + [0.0, 0.0, 2.0]  # wrong matches
    P[30] = P[31] + 1e-3  # so near to each other that they say no direction
    Q[30] = Q[31] + 1e-3
    triples = rng.integers(0, 60, (500, 3))
    triples[3] = 30, 31, 5
    share, metres, apart = 0.03, 0.01, 0.1
    sides, others = (np.linalg.norm(X[triples] - X[triples[:, [1, 2, 0]]], axis=2) for X in (P, Q))
    far = np.maximum(P[triples, 2], Q[triples, 2]).max(axis=1, keepdims=True)
    fits = ((np.abs(sides - others) < share * sides + metres * far**2) & (sides > apart * far)).all(axis=1)
    assert not fits[3] and 50 < fits.sum() < 300
    for most in (20, 500):
        found = rigid_triples(P, Q, triples, most, (share, metres, apart))
        np.testing.assert_array_equal(found, triples[fits][:most])
