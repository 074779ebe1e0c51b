"""Pyramid, gradients and bilinear sampling: exact on polynomials, against autograd, and honest at the border."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.func import jacfwd

from idrgbdo_torch.definitions.image import (
    gradient,
    pyramid,
    sample_bilinear,
    sample_surface,
    sample_with_gradient,
)
from idrgbdo_torch.errors import IdRgbdoError


def ramp(height: int, width: int, slope_u: float, slope_v: float, offset: float = 7.0) -> Tensor:
    v, u = torch.meshgrid(torch.arange(height).double(), torch.arange(width).double(), indexing="ij")
    return slope_u * u + slope_v * v + offset


def noise(*shape: int, dtype: torch.dtype = torch.float64) -> Tensor:
    return 255 * torch.rand(*shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64).to(dtype)


def test_pyramid_is_the_mean_at_the_scaled_pixel() -> None:
    image = ramp(21, 38, 2.0, -3.0)
    levels = pyramid(image, 4)
    assert [tuple(x.shape) for x in levels] == [(21, 38), (10, 19), (5, 9), (2, 4)]
    for level, reduced in enumerate(levels):
        v, u = torch.meshgrid(*(torch.arange(n).double() for n in reduced.shape), indexing="ij")
        scale = 2.0**level  # c_fine = (c + 0.5) / s - 0.5
        torch.testing.assert_close(reduced, 2.0 * ((u + 0.5) * scale - 0.5) - 3.0 * ((v + 0.5) * scale - 0.5) + 7.0)
    batched = pyramid(noise(2, 3, 8, 8, dtype=torch.float32), 2)[1]
    assert batched.shape == (2, 3, 4, 4) and batched.dtype == torch.float32
    torch.testing.assert_close(batched[1, 2, 0, 0], noise(2, 3, 8, 8, dtype=torch.float32)[1, 2, :2, :2].mean())
    with pytest.raises(IdRgbdoError, match="levels"):
        pyramid(noise(4, 4), 4)


def test_gradient_of_a_ramp() -> None:
    g = gradient(ramp(6, 7, 2.0, -3.0))
    assert g.shape == (2, 6, 7)
    assert (g[0, 1:-1, 1:-1] == 2).all() and (g[1, 1:-1, 1:-1] == -3).all()
    assert (g[:, 0] == 0).all() and (g[:, :, -1] == 0).all()


def test_bilinear_values_by_hand() -> None:
    image = torch.tensor([[0.0, 10.0, 20.0], [100.0, 110.0, 140.0]])
    value, valid = sample_bilinear(image, torch.tensor([[0.0, 0.0], [0.25, 0.5], [2.0, 1.0], [1.5, 1.0], [2.0, 0.5]]))
    assert valid.all()
    torch.testing.assert_close(value, torch.tensor([0.0, 52.5, 140.0, 125.0, 80.0]))


def test_outside_is_invalid_zero_and_without_gradient() -> None:
    image = noise(10, 12)
    edge = [[0.0, 0.0], [11.0, 9.0], [11.0001, 5.0], [-1e-4, 5.0], [5.0, 9.001], [math.nan, 1.0], [1e30, math.inf]]
    uv = torch.tensor(edge, dtype=torch.float64, requires_grad=True)
    value, valid = sample_bilinear(image, uv)
    assert valid.tolist() == [True, True, False, False, False, False, False]
    value.sum().backward()
    assert uv.grad is not None and (value[2:] == 0).all() and (uv.grad[2:] == 0).all()
    uv = torch.tensor([[1.0, 1.0], [10.0, 8.0], [10.001, 5.0], [0.999, 5.0], [math.nan, 5.0]], dtype=torch.float64)
    value, g, valid = sample_with_gradient(image, uv)
    assert valid.tolist() == [True, True, False, False, False]
    assert (value[2:] == 0).all() and (g[2:] == 0).all()


def test_value_and_gradient_are_the_sampled_images() -> None:
    image = noise(10, 12)
    uv = torch.tensor([1.0, 1.0]) + torch.rand(
        50, 2, generator=torch.Generator().manual_seed(2), dtype=torch.float64
    ) * torch.tensor([9.0, 7.0])
    uv = torch.cat([uv, torch.tensor([[10.0, 8.0], [3.0, 4.0], [10.0, 2.5]], dtype=torch.float64)])
    value, g, valid = sample_with_gradient(image, uv)
    assert valid.all()
    torch.testing.assert_close(value, sample_bilinear(image, uv)[0])
    interior = gradient(image)
    torch.testing.assert_close(g[:, 0], sample_bilinear(interior[0], uv)[0])
    torch.testing.assert_close(g[:, 1], sample_bilinear(interior[1], uv)[0])
    for axis, step in enumerate(torch.eye(2, dtype=torch.float64)):
        central = (sample_bilinear(image, uv + step)[0] - sample_bilinear(image, uv - step)[0]) / 2
        torch.testing.assert_close(g[:, axis], central)


def test_first_order_expansion_on_a_smooth_image() -> None:
    v, u = torch.meshgrid(torch.arange(40).double(), torch.arange(50).double(), indexing="ij")
    image = 100 + 50 * torch.sin(u / 9) * torch.cos(v / 11)
    uv = torch.tensor([[20.3, 17.8], [30.6, 25.1]], dtype=torch.float64)
    value, g, _ = sample_with_gradient(image, uv)
    step = torch.tensor([0.2, -0.3], dtype=torch.float64)
    moved = 100 + 50 * torch.sin((uv[:, 0] + 0.2) / 9) * torch.cos((uv[:, 1] - 0.3) / 11)
    torch.testing.assert_close(value + g @ step, moved, atol=0.1, rtol=0)
    assert ((g @ step).abs() > 0.4).all()  # without the gradient the check would fail


def test_bilinear_is_differentiable() -> None:
    image, uv = noise(10, 12), torch.tensor([3.3, 4.6], dtype=torch.float64)
    J = jacfwd(lambda x: sample_bilinear(image, x)[0])(uv)
    h = 1e-6
    numeric = [
        (sample_bilinear(image, uv + h * e)[0] - sample_bilinear(image, uv - h * e)[0]) / (2 * h)
        for e in torch.eye(2, dtype=torch.float64)
    ]
    torch.testing.assert_close(J, torch.stack(numeric), atol=1e-5, rtol=1e-5)
    weights = jacfwd(lambda x: sample_bilinear(x, uv)[0])(image)
    assert weights.sum() == pytest.approx(1.0) and weights[4, 3] == pytest.approx(0.7 * 0.4)


def test_batched_images_and_dtypes() -> None:
    images = noise(2, 3, 9, 8, dtype=torch.float32)
    uv = torch.rand(2, 3, 5, 4, 2, generator=torch.Generator().manual_seed(1)) * 5 + 1
    value, g, valid = sample_with_gradient(images, uv)
    assert value.shape == (2, 3, 5, 4) and g.shape == (2, 3, 5, 4, 2) and value.dtype == torch.float32
    single = sample_with_gradient(images[1, 2], uv[1, 2])
    torch.testing.assert_close((value[1, 2], g[1, 2], valid[1, 2]), single)
    with pytest.raises(IdRgbdoError, match="uv: expected a shape"):
        sample_bilinear(images, uv[:1])
    with pytest.raises(IdRgbdoError, match="at least 4x4"):
        sample_with_gradient(noise(3, 9), torch.zeros(1, 2))


def test_surface_needs_four_agreeing_neighbours() -> None:
    d = ramp(6, 8, 0.002, -0.001, 0.5)
    uv = torch.tensor([[2.4, 3.7], [7.0, 5.0], [7.1, 2.0]], dtype=torch.float64)
    value, g, valid = sample_surface(d, uv)
    assert valid.tolist() == [True, True, False]
    torch.testing.assert_close(value[0], 0.5 + 0.002 * uv[0, 0] - 0.001 * uv[0, 1])
    torch.testing.assert_close(g[0], torch.tensor([0.002, -0.001], dtype=torch.float64))
    torch.testing.assert_close(g[0], jacfwd(lambda x: sample_surface(d, x)[0])(uv[0]))
    hole, jump = d.clone(), d.clone()
    hole[3, 2] = 0
    jump[3, 2] = 1.06 * d[3, 2]
    assert not sample_surface(hole, uv[0])[2] and not sample_surface(jump, uv[0])[2]
    assert sample_surface(jump, uv[0], agreement=0.1)[2]
    rough = noise(6, 8) / 255 + 20  # within 5 %, but not a plane
    torch.testing.assert_close(sample_surface(rough, uv[0])[1], jacfwd(lambda x: sample_surface(rough, x)[0])(uv[0]))
