"""What the tracker computes with: fused kernels, or the same functions in plain torch.

Both are packages with files of the same names and functions of the same arguments. torch is the definition and some
fifty times slower for one pair of frames; fused is what runs unless told otherwise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType

from ..config import BackendName
from ..definitions import candidates as torch_candidates
from ..definitions import marginalization as torch_marginal
from ..definitions import selection as torch_choice
from ..definitions import tracking as torch_alignment
from ..definitions import verification as torch_agreement
from ..definitions import window as torch_bundle
from ..kernels import candidates
from ..kernels import marginalization as marginal
from ..kernels import selection as choice
from ..kernels import tracking as alignment
from ..kernels import verification as agreement
from ..kernels import window as bundle


@dataclass(frozen=True)
class Backend:
    """The files of one of the two packages. Algorithm 1 in torch is selection.select_informative."""

    name: BackendName
    agreement: ModuleType  # verify, displacement
    alignment: ModuleType  # align, robust_scale
    bundle: ModuleType  # linearise_window, eliminate_depths
    candidates: ModuleType  # block_thresholds, candidate_scores, grid_candidates, planes_at, sample_patches, ...
    choice: ModuleType  # whitened_rows; select in the fused one
    marginal: ModuleType  # marginalize, redundancy

    def __reduce__(self) -> tuple[Callable[[BackendName], Backend], tuple[BackendName]]:
        """Kept by name where the state of a run is pickled: modules cannot be."""
        return backend_named, (self.name,)


FUSED = Backend("fused", agreement, alignment, bundle, candidates, choice, marginal)
TORCH = Backend("torch", torch_agreement, torch_alignment, torch_bundle, torch_candidates, torch_choice, torch_marginal)


def backend_named(name: BackendName) -> Backend:
    """The backend of that name."""
    return {"fused": FUSED, "torch": TORCH}[name]
