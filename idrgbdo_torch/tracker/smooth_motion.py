"""Hindsight for the frames between keyframes: a hand does not tremble as 24 points do.

A frame's error has little to do with the next one's, while the camera moves smoothly. So the poses of a stretch are
the most likely ones for what each frame measured (its information) and for accelerations that change by white noise (a
jerk), with keyframes held where the window put them. How strong the jerk is says the stretch itself: what makes its
poses most likely (the evidence). After Barfoot, Tong and Sarkka, "Batch Continuous-Time Trajectory Estimation as
Exactly Sparse Gaussian Process Regression", RSS 2014.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from torch import Tensor

from ..definitions import se3
from ..definitions.records import symmetric
from ..measurement import RATE

Array = NDArray[np.float64]

STRETCH = 256  # frames whose jerk is said to be equally strong
BESIDE = 64  # more on either side, whose poses are solved for and left: hardly anything reaches so far
SHORTEST = 8  # frames that say how strong it is
LONGEST_GAP = 0.5  # s without a measurement, over which nothing is said of the motion,
SHORTEST_GAP = 1e-3  # and between two frames whose times are not to be believed
USUAL = np.array([0.2, 1.5])  # m/s^2 and rad/s^2 within 1/30 s, of a hand, where the search begins
RATIO = 2.0**0.5  # from one strength that is tried to the next,
FARTHEST = 24  # of which so many lead to the last
BANDS = 24  # of the lower half of a system in which four poses meet


class Stretch(NamedTuple):
    """The least-squares system of N poses, in left increments of T_cam_world (6 N)."""

    changes: Array  # (N - 3, 6) of acceleration as the poses have them, in those of 1/30 s: m/s^2, rad/s^2
    curvature: Array  # (2, 24, 6 N) J^T J of translations and of rotations, in scipy's lower banded form
    gradient: Array  # (2, 6 N) J^T changes of both
    measured: Array  # (24, 6 N) what the frames know

    @staticmethod
    def of(times: Array, T_cam_world: Array, information: Array, held: NDArray[np.bool_]) -> Stretch:
        """times (N,) s, poses (N, 4, 4), information (N, 6, 6) of their left increments, held (N,): stays as it is."""
        changes, J = changes_of_acceleration(torch.from_numpy(times), torch.from_numpy(T_cam_world))
        J = J * torch.from_numpy(~held)[torch.arange(len(J))[:, None] + torch.arange(4)][:, None, :, None]
        jacobians, r = J.reshape(-1, 6, BANDS), changes[..., None]
        halves = [(jacobians[:, rows], r[:, rows]) for rows in (slice(0, 3), slice(3, 6))]
        measured = np.where(held[:, None, None], np.eye(6), information)
        return Stretch(
            changes.numpy(),
            np.stack([_banded((j.mT @ j).numpy(), 4) for j, _ in halves]),
            np.stack([_scattered((j.mT @ r)[..., 0].numpy()) for j, r in halves]),
            _banded(measured, 1),
        )

    def most_likely(self, sigma: Array) -> tuple[float, Array]:
        """Minus the log of the evidence for sigma (2,), the strength of both halves, and the increments (N, 6)."""
        v, w = 1.0 / sigma**2
        H = v * self.curvature[0] + w * self.curvature[1] + self.measured
        try:
            factor = cholesky_banded(H, lower=True)
        except LinAlgError:
            return np.inf, np.zeros((self.measured.shape[1] // 6, 6))
        gradient = v * self.gradient[0] + w * self.gradient[1]
        x = cho_solve_banded((factor, True), -gradient)
        squares = v * (self.changes[:, :3] ** 2).sum() + w * (self.changes[:, 3:] ** 2).sum()
        cost = squares + (x * gradient).sum()  # at the minimum: r^T W r - g^T H^-1 g
        evidence = 0.5 * cost + np.log(factor[0]).sum() + 3 * len(self.changes) * np.log(sigma).sum()
        return float(evidence), x.reshape(-1, 6)


def smoothed(times: Array, T_cam_world: Array, information: NDArray[np.floating], held: NDArray[np.bool_]) -> Array:
    """(N, 4, 4) poses of all frames, as they came; `held` (N,) stay, as do those that nothing was measured of.

    times (N,) s; information (N, 21), the upper triangles of that of left increments of T_cam_world, zeros where
    nothing was measured.
    """
    out = T_cam_world.copy()
    known = np.isfinite(information).all(axis=1) & (information[:, 0] > 0.0)
    for stretch, inner in _stretches(times, held | known):
        if held[stretch].all():
            continue
        system = Stretch.of(times[stretch], T_cam_world[stretch], symmetric(information[stretch]), held[stretch])
        moved = se3.retract(torch.from_numpy(_search(system)), torch.from_numpy(T_cam_world[stretch]))
        out[stretch][inner] = moved[inner].numpy()
    return out


def _stretches(times: Array, known: NDArray[np.bool_]) -> Iterator[tuple[slice, slice]]:
    """Frames that are known one after the other, cut into pieces: with what is beside them, and their own part."""
    gap = np.diff(times)
    joined = known[1:] & known[:-1] & (gap > SHORTEST_GAP) & (gap < LONGEST_GAP)
    ends = np.r_[-1, np.flatnonzero(~joined), len(times) - 1] if len(times) else np.array([-1])
    for begin, end in zip(ends[:-1] + 1, ends[1:] + 1, strict=True):
        for first in range(begin, end, STRETCH):
            low, high = max(begin, first - BESIDE), min(end, first + STRETCH + BESIDE)
            if high - low >= SHORTEST:
                yield slice(low, high), slice(first - low, min(first + STRETCH, end) - low)


def _search(system: Stretch) -> Array:
    """Increments (N, 6) under the strengths of highest evidence, on a grid of ratios, from USUAL downhill."""
    tried: dict[tuple[int, int], tuple[float, Array]] = {}
    at, beside = (0, 0), [(0, 0)]
    while True:
        for power in beside:
            if power not in tried:
                tried[power] = system.most_likely(USUAL * RATIO ** np.array(power))
        best = min(beside, key=lambda power: tried[power][0])
        if (tried[best][0] >= tried[at][0] and len(beside) > 1) or max(map(abs, best)) == FARTHEST:
            return tried[at][1]
        at = best
        beside = [(at[0] + 1, at[1]), (at[0] - 1, at[1]), (at[0], at[1] + 1), (at[0], at[1] - 1)]


def changes_of_acceleration(times: Tensor, T_cam_world: Tensor) -> tuple[Tensor, Tensor]:
    """(N - 3, 6) changes of acceleration of poses (N, 4, 4) at times (N,), in those of 1/30 s: m/s^2, rad/s^2; their
    jacobians (N - 3, 6, 4, 6) by left increments of their four poses.
    """
    dt = times[1:] - times[:-1]
    motion = T_cam_world[1:] @ se3.inverse(T_cam_world[:-1])
    J = dt.new_zeros(len(dt), 6, 4, 6)  # of velocities, by the poses at 0 and 1
    J[:, :, 0], J[:, :, 1] = -se3.adjoint(motion), torch.eye(6, dtype=J.dtype)
    velocity, J = se3.log(motion) / dt[:, None], J / dt[:, None, None, None]
    half = (dt[1:] + dt[:-1]) / 2
    acceleration, J = _change(velocity, J, half)
    between = (half[1:] + half[:-1]) / 2
    return _change(acceleration, J, (between / RATE).sqrt())


def _change(values: Tensor, jacobians: Tensor, over: Tensor) -> tuple[Tensor, Tensor]:
    """Differences of neighbouring values (N, 6) divided by `over` (N - 1,); jacobians (N, 6, 4, 6) by four poses."""
    later = jacobians[1:].roll(1, dims=2)  # the later one's poses begin one further
    return (values[1:] - values[:-1]) / over[:, None], (later - jacobians[:-1]) / over[:, None, None, None]


def _banded(blocks: Array, poses: int) -> Array:
    """Blocks (M, 6 p, 6 p), each over p poses from the m-th on, added up: (24, 6 N) diagonals from the middle down."""
    out, size = np.zeros((BANDS, 6 * (len(blocks) + poses - 1))), 6 * poses
    first = 6 * np.arange(len(blocks))
    for column in range(size):
        for row in range(column, size):
            out[row - column, first + column] += blocks[:, row, column]
    return out


def _scattered(vectors: Array) -> Array:
    """Vectors (M, 24), each over four poses from the m-th on, added up: (6 N,)."""
    out = np.zeros((len(vectors) + 3, 6))
    for k in range(4):
        out[k : k + len(vectors)] += vectors[:, 6 * k : 6 * k + 6]
    return out.reshape(-1)
