"""The definitions as the tracker's Backend: what the equations say, in torch, for numpy arrays of one pair."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from ..config import SelectionConfig
from ..definitions import assembly, candidates, marginalization, tracking, verification, window
from ..definitions.camera import Pinhole
from ..definitions.information import freedom_entropies_bits
from ..definitions.linearise import robust_scale
from ..definitions.marginalization import LinearPrior
from ..definitions.removal import next_view_bits
from ..definitions.selection import select_by_definition, whitened_rows
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


class Defined:
    """A Backend: see backends.Backend for what each function gives."""

    def gradient_squared(self, image: Array) -> Array:
        return candidates.gradient_squared(image)

    def block_thresholds(self, gradient2: Array, block: int, offset: float) -> Array:
        return candidates.block_thresholds(gradient2, block, offset)

    def candidate_scores(self, gradient2: Array, thresholds: Array, block: int, edges: Array, depth: Array) -> Array:
        return candidates.candidate_scores(gradient2, thresholds, block, edges, depth)

    def grid_candidates(
        self, scores: Array, depth: Array, cell: int, border: int, radius: int, sigma: float
    ) -> tuple[Array, Array, Array]:
        return candidates.grid_candidates(scores, depth, cell, border, radius, sigma)

    def planes_at(self, depth: Array, uv: Array, radius: int, sigma: float) -> tuple[Array, Array, Array]:
        return candidates.planes_at(depth, uv, radius, sigma)

    def first_of_cells(self, cells: Array, order: Array, count: int) -> Array:
        return candidates.first_of_cells(cells, order, count)

    def sample_patches(
        self, images: Sequence[Array], uv: Array, index: Array, levels: range, pattern: int, patch: Array,
        gradient: Array,
    ) -> None:  # fmt: skip
        candidates.sample_patches(images, uv, index, levels, pattern, patch, gradient)

    def whitened_rows(
        self, camera: Pinhole, margin: float, points: Points, index: Array, T: Array, noise: Noise
    ) -> Rows:
        return whitened_rows(camera, margin, points, index, T, noise)

    def select(
        self, rows: Rows, radius: Array, m: int, most: int, information: Array, config: SelectionConfig
    ) -> Array:
        return select_by_definition(rows, radius, m, most, information, config)

    def align(
        self, view: View, points: Points, coarse: Subset, fine: Subset, start: State, prior: MotionPrior, noise: Noise,
        steps: Array,
    ) -> Aligned:  # fmt: skip
        return tracking.align(view, points, coarse, fine, start, prior, noise, steps)

    def verify(
        self, view: View, level: int, points: Points, index: Array, state: State, noise: Noise, limit: float
    ) -> Agreement:
        return verification.verify(view, level, points, index, state, noise, limit)

    def displacement(self, camera: Array, points: Points, index: Array, T_a: Array, T_b: Array) -> float:
        return verification.displacement(camera, points, index, T_a, T_b)

    def freedom_entropies(self, information: Array) -> Array:
        entropies: Array = freedom_entropies_bits(torch.from_numpy(information)).numpy()
        return entropies

    def robust_scale(self, rms: Array) -> float:
        return float(robust_scale(torch.from_numpy(rms)[None]))

    def linearise_window(
        self, views: Views, state: WindowState, points: WindowPoints, which: Array, limit: float, noise: Noise,
        pairs: WindowPairs,
    ) -> None:  # fmt: skip
        window.linearise_window(views, state, points, which, limit, noise, pairs)

    def distances(self, pairs: WindowPairs, state: WindowState) -> Array:
        return assembly.distances(pairs, state)

    def assemble(
        self, pairs: WindowPairs, state: WindowState, points: WindowPoints, which: Array
    ) -> tuple[float, WindowSystem]:
        system = WindowSystem.empty(*state.inv_depth.shape)
        return assembly.assemble(pairs, state, points, which, system), system

    def eliminate_depths(self, system: WindowSystem) -> tuple[Array, Array]:
        return assembly.eliminate_depths(system)

    def marginalize(self, H: Array, b: Array, marginal: Array) -> LinearPrior:
        return marginalization.marginalize(torch.from_numpy(H), torch.from_numpy(b), torch.from_numpy(marginal))

    def redundancy(self, information: Array) -> Array:
        psi: Array = marginalization.redundancy_bits(torch.from_numpy(information)).numpy()
        return psi

    def next_view_bits(self, information: Array, links: Array, adjoints: Array) -> Array:
        bits: Array = next_view_bits(*(torch.from_numpy(x) for x in (information, links, adjoints))).numpy()
        return bits
