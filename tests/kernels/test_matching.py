"""The matcher is OpenCV's: nearest in both directions, and clearly so, equal distances included."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from idrgbdo_torch.kernels.matching import mutual_matches

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
