"""The keyframes of a window and the state of each: one tuple that grows and shrinks as a whole."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..frame import Keyframe
from ..measurement import WindowPairs, WindowPoints, WindowState

Array = NDArray[Any]


class Members(NamedTuple):
    """K keyframes, oldest first; every field has K entries."""

    keyframes: tuple[Keyframe, ...]
    chosen: tuple[Array, ...]  # the window points of each, among its candidates
    points: WindowPoints  # those as padded arrays
    pairs: WindowPairs  # what they say of each other, filled in place
    T: Array  # (K, 4, 4) T_kf_world
    T_linear: Array  # (K, 4, 4) linearisation points, first estimates once in the prior
    affine: Array  # (K, 2) brightness
    affine_linear: Array  # (K, 2)
    in_prior: Array  # (K,) bool, whose linearisation point the prior holds
    inv_depth: Array  # (K, N) 1/m of the window points, padded

    @staticmethod
    def none(points: int, patch: int) -> Members:
        """No keyframe yet; so many points each, with patches of so many pixels."""
        poses, brightness = np.zeros((0, 4, 4)), np.zeros((0, 2))
        flags = np.zeros(0, dtype=np.bool_)
        return Members(
            (), (), no_points(0, points, patch), WindowPairs.empty(0, points), poses, poses, brightness,
            brightness, flags, np.zeros((0, points)),
        )  # fmt: skip

    def __bool__(self) -> bool:
        return len(self.keyframes) > 0

    def append(self, keyframe: Keyframe, index: Array, T_kf_world: Array, affine: Array) -> Members:
        """One more, at a pose (4, 4) with a brightness (2,); the first of all belongs to the prior, which holds it."""
        N = self.inv_depth.shape[1]
        inv_depth = np.zeros((1, N))
        inv_depth[0, : len(index)] = keyframe.points.inv_depth[index]
        points = points_of(keyframe, index, N)
        return Members(
            (*self.keyframes, keyframe),
            (*self.chosen, index),
            WindowPoints(*(np.concatenate(both) for both in zip(self.points, points, strict=True))),
            self.pairs.grown(),
            np.concatenate([self.T, T_kf_world[None]]),
            np.concatenate([self.T_linear, T_kf_world[None]]),
            np.concatenate([self.affine, affine[None]]),
            np.concatenate([self.affine_linear, affine[None]]),
            np.append(self.in_prior, not self),
            np.concatenate([self.inv_depth, inv_depth]),
        )

    def keep(self, mask: Array) -> Members:
        """Those of the mask (K,) bool."""
        stays = np.flatnonzero(mask)
        keyframes, chosen = tuple(self.keyframes[k] for k in stays), tuple(self.chosen[k] for k in stays)
        points = WindowPoints(*(array[mask] for array in self.points))
        return Members(keyframes, chosen, points, self.pairs.keep(mask), *(array[mask] for array in self[4:]))

    def state(self, first_estimates: bool) -> WindowState:
        """What is looked for; geometry about the first estimates of what is in the prior, or about the present."""
        fixed = self.in_prior if first_estimates else np.zeros(len(self.keyframes), dtype=np.bool_)
        T_linear = np.where(fixed[:, None, None], self.T_linear, self.T)
        return WindowState(self.T, T_linear, self.affine, self.inv_depth)


def no_points(K: int, N: int, patch: int) -> WindowPoints:
    """Room for N points of K keyframes, none of which is valid."""
    return WindowPoints(
        np.zeros((K, N, 2)), np.zeros((K, N, patch), np.float32), np.zeros((K, N, patch, 2), np.float32),
        np.ones((K, N)), np.ones((K, N)), np.zeros((K, N), np.bool_), np.zeros((K, N, 2)),
    )  # fmt: skip


def points_of(keyframe: Keyframe, index: Array, N: int) -> WindowPoints:
    """The points (n,) of one keyframe, padded to N."""
    n, points = len(index), keyframe.points
    out = no_points(1, N, points.patch.shape[2])
    out.uv[0, :n] = points.uv[index]
    out.patch[0, :n] = points.patch[0, index]
    out.gradient[0, :n] = points.gradient[0, index]
    out.measured[0, :n] = keyframe.measured[index]
    out.variance[0, :n] = keyframe.measured_variance[index]
    out.valid[0, :n] = True
    out.slope[0, :n] = points.slope[index]
    return out
