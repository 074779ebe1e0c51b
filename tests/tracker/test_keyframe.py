"""Eq. 20 in closed form, entropies of each degree of freedom, and the decision for a keyframe."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from idrgbdo_torch.config import KeyframeConfig
from idrgbdo_torch.definitions.information import conditional_covariance, entropy_bits, freedom_entropies_bits
from idrgbdo_torch.kernels.information import freedom_entropies
from idrgbdo_torch.tracker.keyframe import (
    REFERENCE_FRAMES,
    SURE_BITS,
    entropy_decrement,
    lost_certainty,
    wants_keyframe,
)

BITS = KeyframeConfig(criterion="bits", threshold_bits=0.35, threshold_ratio=0.04)
RATIO = replace(BITS, criterion="ratio")


def information(*shape: int) -> Tensor:
    J = torch.randn(*shape, 20, 6, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return 1e4 * J.mT @ J


def test_entropy_of_a_freedom_is_that_of_its_conditional_covariance() -> None:
    """Given the other five, by Eqs. 14 and 11 on the permuted covariance."""
    many = information(2, 3)
    entropies = freedom_entropies_bits(many)
    assert entropies.shape == (2, 3, 6)
    for k in range(6):
        order = [k, *(i for i in range(6) if i != k)]
        joint = torch.linalg.inv(many)[..., order, :][..., order]
        torch.testing.assert_close(entropies[..., k], entropy_bits(conditional_covariance(joint, 1)))
        torch.testing.assert_close(entropies[..., k], entropy_bits(1 / many[..., k, k, None, None]))


def test_the_entropies_of_one_matrix_are_those_of_the_batch() -> None:
    blind = information()
    blind[3, :] = blind[:, 3] = 0.0
    for each in (information(), blind):
        np.testing.assert_allclose(freedom_entropies(each.numpy()), freedom_entropies_bits(each).numpy(), rtol=1e-12)


def test_twice_the_deviation_is_one_bit_more() -> None:
    once = freedom_entropies_bits(information())
    torch.testing.assert_close(freedom_entropies_bits(information() / 4), once + 1)
    assert freedom_entropies_bits(information().float()).dtype == torch.float64


def test_a_freedom_without_information_is_infinitely_uncertain() -> None:
    blind = information()
    blind[3, :] = blind[:, 3] = 0.0
    entropies = freedom_entropies_bits(blind)
    assert entropies[3] == torch.inf
    assert torch.isfinite(entropies[[0, 1, 2, 4, 5]]).all()
    assert lost_certainty(entropies, freedom_entropies_bits(information()), "bits")[3] == torch.inf


def test_entropy_decrement() -> None:
    entropy = torch.tensor([-9.0, -10.0, -11.0, 2.0], dtype=torch.float64)
    reference = torch.tensor([-10.0, -10.0, -10.0, -1.0], dtype=torch.float64)
    expected = torch.tensor([0.1, 0.0, -0.1, 3.0], dtype=torch.float64)  # less certain, same, more, lost
    torch.testing.assert_close(entropy_decrement(entropy, reference), expected)


def test_the_ratio_depends_on_units_and_bits_do_not() -> None:
    sigma_0, sigma = torch.tensor([1e-3, 1.3e-3], dtype=torch.float64)
    entropies = lambda unit: entropy_bits((unit * torch.stack([sigma, sigma_0])).square()[:, None, None])
    metres, millimetres = entropies(1.0), entropies(1e3)
    bits = torch.log2(sigma / sigma_0)
    for H in (metres, millimetres):
        torch.testing.assert_close(lost_certainty(H[0], H[1], "bits"), bits)
    assert entropy_decrement(*metres) > 0 > entropy_decrement(*millimetres)


def test_the_ratio_is_guarded_where_it_means_nothing() -> None:
    reference = torch.tensor([-8.0, SURE_BITS + 1e-6, 0.0, 3.0, -8.0], dtype=torch.float64)
    entropy = reference + torch.tensor([0.4, 0.4, 0.4, 0.4, torch.inf], dtype=torch.float64)
    lost = lost_certainty(entropy, reference, "ratio")
    torch.testing.assert_close(lost, torch.tensor([0.05, 0.4, 0.4, 0.4, torch.inf], dtype=torch.float64))
    torch.testing.assert_close(lost_certainty(entropy, reference, "bits"), entropy - reference)


def history(*last: float, freedom: int = 2, frames: int = REFERENCE_FRAMES) -> list[NDArray[np.float64]]:
    """Frames at -10 bits in every freedom, then one freedom at these values."""
    out = [np.full(6, -10.0) for _ in range(frames)]
    for value in last:
        entropies = np.full(6, -12.0)  # the others are even surer
        entropies[freedom] = value
        out.append(entropies)
    return out


@pytest.mark.parametrize("freedom", range(6))
def test_one_freedom_that_has_lost_enough_makes_a_keyframe(freedom: int) -> None:
    assert not wants_keyframe(history(-9.7, freedom=freedom), BITS)
    assert wants_keyframe(history(-9.6, freedom=freedom), BITS)
    assert not wants_keyframe(history(-9.61, freedom=freedom), RATIO)
    assert wants_keyframe(history(-9.59, freedom=freedom), RATIO)


@pytest.mark.parametrize("criterion", ["bits", "ratio"])
def test_what_counts_is_the_last_frame_against_the_median_of_the_first(criterion: Literal["bits", "ratio"]) -> None:
    config = replace(BITS, criterion=criterion)
    assert not wants_keyframe(history(frames=1), config)  # the first frame after a keyframe is its own reference
    assert not wants_keyframe(history(-9.0, -10.0), config)  # a blurred frame in between does not count
    one_bad = [np.full(6, x) for x in (-14.0, -10.0, -10.1)]
    assert not wants_keyframe(one_bad, config)  # one frame of luck does not raise the bar
    assert wants_keyframe([*one_bad, one_bad[1] + 0.6], config)
    later = [*history(), *history(-9.8, -9.7), np.full(6, -9.8)]
    assert not wants_keyframe(later, config)


def test_losing_a_freedom_makes_a_keyframe() -> None:
    for config in (BITS, RATIO):
        assert wants_keyframe(history(np.inf), config)


def test_thresholds_are_the_configured_ones() -> None:
    frames = history(-9.0)
    assert wants_keyframe(frames, replace(BITS, threshold_bits=0.99))
    assert not wants_keyframe(frames, replace(BITS, threshold_bits=1.01))
    assert wants_keyframe(frames, replace(RATIO, threshold_ratio=0.099))
    assert not wants_keyframe(frames, replace(RATIO, threshold_ratio=0.101))
