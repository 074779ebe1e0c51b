"""The kernels as the tracker's Backend: compiled, with the definition where one meets a singular matrix."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from ..config import SelectionConfig
from ..definitions import marginalization as defined
from ..definitions.camera import Pinhole
from ..definitions.marginalization import LinearPrior
from ..definitions.selection import select_by_definition
from ..kernels import assembly, candidates, marginalization, removal, selection, tracking, verification, window
from ..kernels import information as entropies
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


class Fused:
    """A Backend: see backends.Backend for what each function gives."""

    def gradient_squared(self, image: Array) -> Array:
        out: Array = candidates.gradient_squared(image)
        return out

    def block_thresholds(self, gradient2: Array, block: int, offset: float) -> Array:
        out: Array = candidates.block_thresholds(gradient2, block, offset)
        return out

    def candidate_scores(self, gradient2: Array, thresholds: Array, block: int, edges: Array, depth: Array) -> Array:
        out: Array = candidates.candidate_scores(gradient2, thresholds, block, edges, depth)
        return out

    def grid_candidates(
        self, scores: Array, depth: Array, cell: int, border: int, radius: int, sigma: float
    ) -> tuple[Array, Array, Array]:
        out: tuple[Array, Array, Array] = candidates.grid_candidates(scores, depth, cell, border, radius, sigma)
        return out

    def planes_at(self, depth: Array, uv: Array, radius: int, sigma: float) -> tuple[Array, Array, Array]:
        out: tuple[Array, Array, Array] = candidates.planes_at(depth, uv, radius, sigma)
        return out

    def first_of_cells(self, cells: Array, order: Array, count: int) -> Array:
        out: Array = candidates.first_of_cells(cells, order, count)
        return out

    def sample_patches(
        self, images: Sequence[Array], uv: Array, index: Array, levels: range, pattern: int, patch: Array,
        gradient: Array,
    ) -> None:  # fmt: skip
        candidates.sample_patches(images, uv, index, levels.start, levels.stop, pattern, patch, gradient)

    def whitened_rows(
        self, camera: Pinhole, margin: float, points: Points, index: Array, T: Array, noise: Noise
    ) -> Rows:
        cam = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        out: Rows = selection.whitened_rows(cam, camera.width, camera.height, margin, points, index, T, noise)
        return out

    def select(
        self, rows: Rows, radius: Array, m: int, most: int, information: Array, config: SelectionConfig
    ) -> Array:
        if config.objective != "bits":  # such as |Lambda| of about 1e41: only the definition has them
            return select_by_definition(rows, radius, m, most, information, config)
        out: Array = selection.select(
            rows, radius, m, most, information, float(config.bits), float(config.spread), float(config.c_z),
            config.distance,
        )  # fmt: skip
        return out

    def align(
        self, view: View, points: Points, coarse: Subset, fine: Subset, start: State, prior: MotionPrior, noise: Noise,
        steps: Array,
    ) -> Aligned:  # fmt: skip
        out: Aligned = tracking.align(view, points, coarse, fine, start, prior, noise, steps)
        return out

    def verify(
        self, view: View, level: int, points: Points, index: Array, state: State, noise: Noise, limit: float
    ) -> Agreement:
        out: Agreement = verification.verify(view, level, points, index, state, noise, limit)
        return out

    def displacement(self, camera: Array, points: Points, index: Array, T_a: Array, T_b: Array) -> float:
        return float(verification.displacement(camera, points, index, T_a, T_b))

    def freedom_entropies(self, information: Array) -> Array:
        return entropies.freedom_entropies(information)

    def robust_scale(self, rms: Array) -> float:
        return float(tracking.robust_scale(rms))

    def linearise_window(
        self, views: Views, state: WindowState, points: WindowPoints, which: Array, limit: float, noise: Noise,
        pairs: WindowPairs,
    ) -> None:  # fmt: skip
        window.linearise_window(views, state, points, which, limit, noise, pairs)

    def distances(self, pairs: WindowPairs, state: WindowState) -> Array:
        out: Array = assembly.distances(pairs, state)
        return out

    def assemble(
        self, pairs: WindowPairs, state: WindowState, points: WindowPoints, which: Array
    ) -> tuple[float, WindowSystem]:
        system = WindowSystem.empty(*state.inv_depth.shape)
        return float(assembly.assemble(pairs, state, points, which, system)), system

    def eliminate_depths(self, system: WindowSystem) -> tuple[Array, Array]:
        out: tuple[Array, Array] = assembly.eliminate_depths(system)
        return out

    def marginalize(self, H: Array, b: Array, marginal: Array) -> LinearPrior:
        ok, H_star, b_star = marginalization.marginalize(H, b, np.flatnonzero(~marginal), np.flatnonzero(marginal))
        if ok:
            return LinearPrior(torch.from_numpy(H_star), torch.from_numpy(b_star))
        return defined.marginalize(torch.from_numpy(H), torch.from_numpy(b), torch.from_numpy(marginal))

    def redundancy(self, information: Array) -> Array:
        ok, psi = marginalization.redundancy(information)
        return psi if ok else defined.redundancy_bits(torch.from_numpy(information)).numpy()

    def next_view_bits(self, information: Array, links: Array, adjoints: Array) -> Array:
        out: Array = removal.next_view_bits(information, links, adjoints)
        return out
