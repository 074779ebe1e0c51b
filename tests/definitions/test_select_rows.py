"""Rows of any Jacobian: the greedy choice by brute force, its limits, its options."""

from __future__ import annotations

import itertools

import pytest
import torch
from torch import Tensor

from idrgbdo_torch import select_rows
from idrgbdo_torch.errors import IdRgbdoError


def jacobian(n: int, d: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(n, d, generator=generator, dtype=torch.float64) * torch.tensor([1.0, 10.0, 0.1, 3.0][:d])


def bits(J: Tensor, prior: Tensor) -> float:
    return float(torch.logdet(prior + J.mT @ J))


def test_after_one_row_a_parameter_each_next_row_is_the_best_one() -> None:
    J, prior = jacobian(60, 4), 0.01 * torch.eye(4, dtype=torch.float64)
    chosen = select_rows(J, 12, information=prior).tolist()
    assert len(set(chosen)) == 12
    for k in range(4):  # the largest derivative of each parameter that is still there
        left = [n for n in range(60) if n not in chosen[:k]]
        assert chosen[k] == max(left, key=lambda n, k=k: abs(float(J[n, k])))
    for k in range(4, 12):
        left = [n for n in range(60) if n not in chosen[:k]]
        assert chosen[k] == max(left, key=lambda n, k=k: bits(J[[*chosen[:k], n]], prior))


def test_it_is_nearly_the_best_choice_of_all() -> None:
    J, prior = jacobian(14, 2, seed=1), torch.eye(2, dtype=torch.float64)
    best = max(bits(J[list(some)], prior) for some in itertools.combinations(range(14), 4))
    assert bits(J[select_rows(J, 4, information=prior)], prior) > 0.95 * best


def test_units_do_not_matter() -> None:
    J = jacobian(80, 4, seed=2)
    scaled = J * torch.tensor([1e3, 1.0, 1e-4, 57.3], dtype=torch.float64)
    assert select_rows(J, 20).tolist() == select_rows(scaled, 20).tolist()
    assert select_rows(J.float(), 20).tolist() == select_rows(J, 20).tolist()


def test_an_uncertain_row_counts_less() -> None:
    J = jacobian(50, 3, seed=3)
    sigma = torch.where(torch.arange(50) < 25, 100.0, 1.0)
    assert (select_rows(J, 10, sigma=sigma) >= 25).all()
    assert select_rows(J, 10, sigma=sigma).tolist() == select_rows(J / sigma[:, None], 10).tolist()
    pairs = J.reshape(25, 2, 3)  # two residuals a measurement
    by_pair = select_rows(pairs, 5, sigma=sigma.reshape(25, 2))
    assert (by_pair >= 12).all() and by_pair.shape == (5,)


def test_cells_and_distance_keep_the_choice_apart() -> None:
    J = jacobian(200, 3, seed=4)
    cells = torch.arange(200) % 9
    chosen = select_rows(J, 20, cells=cells)
    assert sorted(cells[chosen].tolist()) == list(range(9))
    where = 100 * torch.rand(200, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    chosen = select_rows(J, 10, where=where, distance=20.0)
    gaps = torch.pdist(where[chosen])
    assert len(chosen) == 10 and gaps.min() >= 20


def test_spread_goes_from_outside_in() -> None:
    J = 1e-3 * jacobian(300, 3, seed=5)
    radius = torch.rand(300, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    prior = torch.eye(3, dtype=torch.float64)
    chosen = select_rows(J, 23, information=prior, radius=radius)[3:]
    assert radius[chosen[:3]].min() > 0.8 and radius[chosen[-3:]].max() < 0.2


def test_a_parameter_that_nothing_measures_is_no_obstacle() -> None:
    J = jacobian(30, 3, seed=6)
    J[:, 1] = 0.0
    assert len(select_rows(J, 8)) == 8
    assert select_rows(torch.zeros(0, 3), 8).tolist() == []
    assert len(select_rows(J, 100)) == 30


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((torch.ones(3), 2), "J: expected"),
        ((torch.full((3, 2), torch.nan), 2), "finite"),
        ((torch.ones(3, 2), 0), "count >= 1"),
    ],
)
def test_wrong_input_is_named(arguments: tuple[Tensor, int], words: str) -> None:
    with pytest.raises(IdRgbdoError, match=words):
        select_rows(*arguments)
    with pytest.raises(IdRgbdoError, match="either cells or where"):
        select_rows(torch.ones(3, 2), 1, cells=torch.arange(3), where=torch.ones(3, 2))
