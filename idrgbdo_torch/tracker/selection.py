"""Which points to track (section 4.1, step 3): the four modes."""

from __future__ import annotations

import numpy as np
import torch
from numpy.random import Generator
from numpy.typing import NDArray
from torch import Tensor

from ..config import SelectionConfig
from ..definitions.camera import Pinhole
from ..definitions.selection import gain_bits
from ..frame import Keyframe
from ..measurement import Noise
from .backends import Backend

Array = NDArray[np.float64]
Index = NDArray[np.int64]

NARROW = 8  # margins in the shorter side of the image, at least
ROUNDING = 1e-6  # px; candidates are whole pixels and may lie on the margin, where rounding must not decide


def select_points(
    keyframe: Keyframe,
    T_frame_kf: Array,
    m: int,
    information: Array,
    config: SelectionConfig,
    noise: Noise,
    rng: Generator,
    backend: Backend,
) -> Index:
    """m candidates of a keyframe for a frame at the pose T_frame_kf, by the configured mode; fewer if it has less.

    By information, there are more where these leave an entropy above config.bits.
    """
    everyone = np.arange(len(keyframe.points.uv))
    margin = view_margin(config.margin, keyframe.frame.camera) - ROUNDING
    rows = backend.whitened_rows(keyframe.frame.camera, margin, keyframe.points, everyone, T_frame_kf, noise)
    seen = rows.seen
    if config.mode == "rand":
        key = rng.random(len(everyone)) + ~seen  # one point more or less in view changes no other's luck
        return np.sort(np.argsort(key)[: min(m, int(seen.sum()))])
    if config.mode == "grid":
        return strongest_of_cells(rows.where, seen, keyframe, m)
    most = max(m, config.points_most) if config.bits < 0.0 else m
    return backend.select(rows, keyframe.radius, m, most, information, config)


def view_margin(margin: float, camera: Pinhole) -> float:
    """The margin in px, at most an eighth of the image's shorter side, so that small images keep most of their view."""
    return min(margin, min(camera.width, camera.height) / NARROW)


def strongest_of_cells(where: Array, seen: NDArray[np.bool_], keyframe: Keyframe, m: int) -> Index:
    """The strongest visible gradient of each of about m grid cells, then the strongest of the rest."""
    visible = np.flatnonzero(seen)
    camera = keyframe.frame.camera
    strength = (keyframe.points.gradient[0, visible, 0] ** 2).sum(axis=1)
    order = visible[np.argsort(-strength, kind="stable")]
    _, first = np.unique(grid_cells(where[order], m, camera.width, camera.height), return_index=True)
    cells = order[np.sort(first)]
    return np.concatenate([cells, order[~np.isin(order, cells)]])[:m]


def grid_cells(uv: Array, count: int, width: int, height: int) -> Index:
    """The number (N,) of the square cell each pixel lies in, with about `count` cells over the image."""
    side = float(np.sqrt(width * height / max(count, 1)))
    columns = int(width / side) + 1
    cells: Index = (uv[:, 1] // side).astype(np.int64) * columns + (uv[:, 0] // side).astype(np.int64)
    return cells


def point_bits(
    keyframe: Keyframe, T_frame_kf: Array, index: Index, noise: Noise, backend: Backend
) -> tuple[Tensor, Tensor]:
    """Where a frame sees some candidates, (M, 2) px, and what each adds to all the others, (M,) bits; unseen left out.

    Unlike the gain at its choice, this does not depend on the order: what would be lost without that one point.
    """
    found = backend.whitened_rows(keyframe.frame.camera, 0.0, keyframe.points, index, T_frame_kf, noise)
    seen = found.seen & np.isfinite(found.A).all(axis=(1, 2))  # a point at a depth of 1e-45 m has no finite rows
    rows = torch.from_numpy(found.A[seen])  # (M, 3, 6)
    each = rows.mT @ rows  # (M, 6, 6)
    everything = each.sum(dim=0)
    floor = torch.diag(1e-6 * everything.diagonal())  # so that few points leave a matrix to invert
    return torch.from_numpy(found.where[seen]), gain_bits(rows, everything + floor - each)
