"""Edges of an image against OpenCV's."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from rendered import Film

from idrgbdo_torch.kernels.canny import edges

LIMITS = ((50, 200), (10, 30), (120, 700))


def of_opencv(image: np.ndarray, low: int, high: int) -> np.ndarray:
    return cv2.Canny(image.astype(np.uint8), low, high, L2gradient=True)


@pytest.mark.parametrize(("low", "high"), LIMITS)
def test_bit_for_bit_those_of_opencv(desk: Film, low: int, high: int) -> None:
    rng = np.random.default_rng(0)
    noise = [(255.0 * rng.random(shape)).astype(np.float32) for shape in ((3, 3), (5, 7), (61, 83), (64, 64))]
    soft = [cv2.GaussianBlur(image, (0, 0), 1.5) for image in noise]
    blocks = np.kron(rng.integers(0, 256, (13, 17)), np.ones((7, 9))).astype(np.float32)
    for image in [*noise, *soft, blocks, blocks.T.copy(), desk.frames[0].gray.numpy()]:
        np.testing.assert_array_equal(edges(image, float(low), float(high)), of_opencv(image, low, high))


def test_a_pixel_that_is_no_gray_level_counts_as_black() -> None:
    image = np.full((40, 40), 120.0, np.float32)
    black = image.copy()
    image[10:20, 10:20], black[10:20, 10:20] = np.nan, 0.0
    found = edges(image, *map(float, LIMITS[0]))
    assert found.any()
    np.testing.assert_array_equal(found, of_opencv(black, *LIMITS[0]))
