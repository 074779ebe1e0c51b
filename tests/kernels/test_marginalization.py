"""The fused marginalisation and redundancy against their definitions."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from idrgbdo_torch.definitions.marginalization import marginalize, redundancy_bits
from idrgbdo_torch.kernels import marginalization as marginal

UNITS = np.array([1e5, 1e5, 1e5, 3e4, 3e4, 3e4, 200.0, 0.1])  # 1 / sigma of a keyframe's state


def system(K: int, unit: NDArray[np.float64] = UNITS, seed: int = 0) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    rng = np.random.default_rng(seed)
    n = K * len(unit)
    J = rng.standard_normal((3 * n, n)) * np.tile(unit, K)
    return J.T @ J, J.T @ rng.standard_normal(3 * n)


def test_marginalisation_is_that_of_the_definition() -> None:
    H, b = system(5)
    unit = np.tile(UNITS, 5)
    for gone in (np.arange(8, 16), np.arange(40)[np.arange(40) % 8 >= 6], np.array([3, 17])):
        mask = np.isin(np.arange(40), gone)
        ok, H_star, b_star = marginal.marginalize(H, b, np.flatnonzero(~mask), gone)
        expected = marginalize(torch.from_numpy(H), torch.from_numpy(b), torch.from_numpy(mask))
        scale = unit[~mask]
        assert ok
        np.testing.assert_allclose(
            H_star / np.outer(scale, scale), expected.H.numpy() / np.outer(scale, scale), atol=1e-10
        )
        np.testing.assert_allclose(b_star / scale, expected.b.numpy() / scale, atol=1e-10)
        assert (H_star == H_star.T).all()


def test_what_is_singular_is_left_to_the_definition() -> None:
    H, b = system(3)
    blind = H.copy()
    blind[8:10, :] = blind[:, 8:10] = 0.0  # two variables nobody has measured
    keep, gone = np.r_[0:8, 16:24], np.arange(8, 16)
    assert not marginal.marginalize(blind, b, keep, gone)[0]
    blind = H.copy()
    blind[9] = blind[8]
    blind[:, 9] = blind[:, 8]  # two that are one
    assert not marginal.marginalize(blind, b, keep, gone)[0]
    indefinite = H.copy()
    indefinite[0, 0] = -1.0
    assert not marginal.marginalize(indefinite, b, keep, gone)[0]


def test_redundancy_is_that_of_the_definition() -> None:
    H, _ = system(6, UNITS[:6])
    ok, psi = marginal.redundancy(H)
    assert ok
    np.testing.assert_allclose(psi, redundancy_bits(torch.from_numpy(H)).numpy(), rtol=1e-10)
    assert psi.min() > 0
    ok, psi = marginal.redundancy(np.diag(np.diag(H)))
    assert ok and np.abs(psi).max() < 1e-12
    H[0, 0] = 0.0
    assert not marginal.redundancy(H)[0]
