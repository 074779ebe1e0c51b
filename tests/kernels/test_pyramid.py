"""The pyramid's kernels against OpenCV, at any size."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from idrgbdo_torch.frame import blur_taps, gray_pyramid, smoothed
from idrgbdo_torch.kernels.pyramid import halve
from idrgbdo_torch.measurement import COARSE_BLUR


@pytest.mark.parametrize("shape", [(48, 64), (33, 47), (61, 35), (2, 3), (3, 2), (1, 5), (5, 1), (1, 1)])
@pytest.mark.parametrize("sigma", [0.8, COARSE_BLUR])
def test_the_blur_is_a_gaussian_mirrored_at_the_border(shape: tuple[int, int], sigma: float) -> None:
    image = np.random.default_rng(0).uniform(0, 255, shape).astype(np.float32)
    np.testing.assert_allclose(smoothed(image, sigma), cv2.GaussianBlur(image, (5, 5), sigma), rtol=1e-6, atol=1e-4)


def test_its_weights_are_one() -> None:
    middle, near, far = blur_taps(0.8)
    assert middle + 2 * (near + far) == pytest.approx(1.0) and middle > near > far > 0


@pytest.mark.parametrize("shape", [(48, 64), (33, 47), (2, 2), (3, 3)])
def test_halving_takes_means_and_leaves_out_an_odd_last_pixel(shape: tuple[int, int]) -> None:
    image = np.random.default_rng(0).uniform(0, 255, shape).astype(np.float32)
    height, width = shape[0] // 2, shape[1] // 2
    half = np.empty((height, width), np.float32)
    halve(image, half)
    expected = image[: 2 * height, : 2 * width].reshape(height, 2, width, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(half, expected, rtol=1e-6)


def test_levels_are_halvings_of_what_is_not_blurred() -> None:
    image = np.random.default_rng(0).uniform(0, 255, (32, 64)).astype(np.float32)
    levels = gray_pyramid(image, 6)
    assert [level.shape for level in levels] == [(32, 64), (16, 32), (8, 16), (4, 8), (2, 4), (1, 2)]
    assert levels[0] is image
    quarter = cv2.resize(image, (16, 8), interpolation=cv2.INTER_AREA)
    np.testing.assert_allclose(levels[2], cv2.GaussianBlur(quarter, (5, 5), COARSE_BLUR), rtol=1e-5, atol=1e-3)


def test_an_image_thinner_than_two_pixels_still_has_levels() -> None:
    line = np.random.default_rng(0).uniform(0, 255, (1, 4)).astype(np.float32)
    assert [level.shape for level in gray_pyramid(line, 4)] == [(1, 4), (1, 2), (1, 1), (1, 1)]
    assert np.isfinite(gray_pyramid(line, 4)[-1]).all()
