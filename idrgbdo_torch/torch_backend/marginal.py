"""Marginalisation and redundancy in torch: twin of kernels.marginal, the definitions behind its arguments."""

from __future__ import annotations

import torch

from .. import marginalization
from .convert import Array


def marginalize(H: Array, b: Array, keep: Array, gone: Array) -> tuple[bool, Array, Array]:
    """Twin of kernels.marginal.marginalize, keep (m,) and gone (k,) ascending; ok whatever is singular."""
    marginal = torch.zeros(len(keep) + len(gone), dtype=torch.bool)
    marginal[torch.from_numpy(gone)] = True
    prior = marginalization.marginalize(torch.from_numpy(H), torch.from_numpy(b), marginal)
    return True, prior.H.numpy(), prior.b.numpy()


def redundancy(information: Array) -> tuple[bool, Array]:
    """Twin of kernels.marginal.redundancy."""
    return True, marginalization.redundancy_bits(torch.from_numpy(information)).numpy()
