"""What the tracker computes with: the fused kernels, or the definitions in plain torch.

Both answer the same calls with the same numpy arrays and give the same results. The definitions are some fifty times
slower for one pair of frames; the kernels are what runs unless told otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from ..config import BackendName, SelectionConfig
from ..definitions.camera import Pinhole
from ..definitions.marginalization import LinearPrior
from ..measurement import (
    Agreement,
    Aligned,
    Array,
    MotionPrior,
    Noise,
    Points,
    Rows,
    State,
    Subset,
    View,
    Views,
    WindowPairs,
    WindowPoints,
    WindowState,
    WindowSystem,
)
from .defined import Defined
from .fused import Fused


class Backend(Protocol):
    """The computations of the tracker by name. What each means stands with its definition in definitions/."""

    # candidates (section 4.1, steps 1 and 2)

    def gradient_squared(self, image: Array) -> Array:
        """(H, W) of an image."""

    def block_thresholds(self, gradient2: Array, block: int, offset: float) -> Array:
        """One threshold for each block of the image."""

    def candidate_scores(self, gradient2: Array, thresholds: Array, block: int, edges: Array, depth: Array) -> Array:
        """(H, W) scores, -1 where there is no candidate."""

    def grid_candidates(
        self, scores: Array, depth: Array, cell: int, border: int, radius: int, sigma: float
    ) -> tuple[Array, Array, Array]:
        """uv (M, 2), inverse depth (M,), tier (M,): one candidate a cell."""

    def planes_at(self, depth: Array, uv: Array, radius: int, sigma: float) -> tuple[Array, Array, Array]:
        """Whether there is a plane around pixels uv (N, 2), their inverse depths (N,) and its slopes (N, 2)."""

    def first_of_cells(self, cells: Array, order: Array, count: int) -> Array:
        """At most count indices, spread over the cells (N,)."""

    def sample_patches(
        self, images: Sequence[Array], uv: Array, index: Array, levels: range, pattern: int, patch: Array,
        gradient: Array,
    ) -> None:  # fmt: skip
        """Fill patch (L, N, P) and gradient (L, N, P, 2) of some points on some levels; pattern: of the finest one."""

    # selection (section 4.1, step 3)

    def whitened_rows(
        self, camera: Pinhole, margin: float, points: Points, index: Array, T: Array, noise: Noise
    ) -> Rows:
        """What some points tell about a pose T_target_host (4, 4)."""

    def select(
        self, rows: Rows, radius: Array, m: int, most: int, information: Array, config: SelectionConfig
    ) -> Array:
        """Algorithm 1: indices (<= most,) in order of choice; more than m while the entropy is above config.bits."""

    # tracking (section 4.2) and its verification

    def align(
        self, view: View, points: Points, coarse: Subset, fine: Subset, start: State, prior: MotionPrior, noise: Noise,
        steps: Array,
    ) -> Aligned:  # fmt: skip
        """A view against a keyframe's points, coarse to fine."""

    def verify(
        self, view: View, level: int, points: Points, index: Array, state: State, noise: Noise, limit: float
    ) -> Agreement:
        """How many points agree with a pose."""

    def displacement(self, camera: Array, points: Points, index: Array, T_a: Array, T_b: Array) -> float:
        """Mean distance in px of points at two poses."""

    def freedom_entropies(self, information: Array) -> Array:
        """Bits (6,) of each degree of freedom given the others (section 5.1)."""

    # window (section 5.2)

    def robust_scale(self, rms: Array) -> float:
        """Of whitened residuals (N,), -1 unseen."""

    def linearise_window(
        self, views: Views, state: WindowState, points: WindowPoints, which: Array, limit: float, noise: Noise,
        pairs: WindowPairs,
    ) -> None:  # fmt: skip
        """Fill the equations of some pairs of keyframes (K, K), each about the state."""

    def distances(self, pairs: WindowPairs, state: WindowState) -> Array:
        """How far each pair (K, K) is from where it was taken, in squared standard deviations an unknown."""

    def assemble(
        self, pairs: WindowPairs, state: WindowState, points: WindowPoints, which: Array
    ) -> tuple[float, WindowSystem]:
        """Energy and normal equations of some pairs (K, K) of a window at a state, if they are taken."""

    def eliminate_depths(self, system: WindowSystem) -> tuple[Array, Array]:
        """(8K, 8K) and (8K,) of poses and brightness."""

    def marginalize(self, H: Array, b: Array, marginal: Array) -> LinearPrior:
        """What normal equations leave when the marked variables (n,) bool are gone."""

    def redundancy(self, information: Array) -> Array:
        """Eq. 26: psi (K,) in bits of keyframe poses with the information (6K, 6K)."""

    def next_view_bits(self, information: Array, links: Array, adjoints: Array) -> Array:
        """What the next view would lose with each keyframe (K,), in bits."""


BACKENDS: dict[BackendName, Backend] = {"fused": Fused(), "torch": Defined()}


def backend_named(name: BackendName) -> Backend:
    """The backend of that name."""
    return BACKENDS[name]
