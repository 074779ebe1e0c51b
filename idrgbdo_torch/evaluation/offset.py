"""The offset between two clocks, from the speeds of the same motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from ..trajectory import Trajectory, align
from .absolute import distances

Array = NDArray[np.float64]

GRID_S = 0.02
HALF_S = 0.1  # a speed is that over twice as long
MOST_SAMPLES = 20000
SHARED = 0.6  # of the shorter trajectory that both must cover
ALIKE = 0.8  # least correlation of the speeds
PEAKS = 5  # lags that are tried
FEWEST = 10  # samples of the speed


@dataclass(frozen=True)
class Offset:
    """What to add to the times of the reference, and what is gained."""

    seconds: float
    ate_m: float  # with it, the reference interpolated
    ate_before_m: float | None  # without it; None where the two do not overlap


def clock_offset(estimate: Trajectory, reference: Trajectory) -> Offset | None:
    """The offset at which the positions fit best, found anywhere; None where no offset makes the speeds alike."""
    spans = [float(t.timestamps[-1] - t.timestamps[0]) for t in (estimate, reference)]
    step = max(GRID_S, max(spans) / MOST_SAMPLES)
    speeds = [_speeds(trajectory, step) for trajectory in (estimate, reference)]
    if min(len(speed) for speed in speeds) < FEWEST:
        return None
    start_s = float(estimate.timestamps[0] - reference.timestamps[0])
    alike = _correlations(*speeds)  # by how many samples the reference's begins later in the estimate's
    lags = np.array(list(alike))
    values = np.array(list(alike.values()))
    peaks = [k for k in range(len(values)) if values[k] >= ALIKE and values[k] == values[max(k - 2, 0) : k + 3].max()]
    best: tuple[float, float] | None = None
    for k in sorted(peaks, key=lambda k: -values[k])[:PEAKS]:
        found = _refined(estimate, reference, start_s + float(lags[k]) * step, 2 * step)
        best = min(found, best) if best else found
    if best is None:
        return None
    return Offset(best[1], best[0], fit_m(estimate, reference, 0.0))


def fit_m(estimate: Trajectory, reference: Trajectory, offset_s: float) -> float | None:
    """ATE against the interpolated reference, offset_s added to its times; None where they share less than three."""
    times = estimate.timestamps.numpy() - offset_s
    known, positions = reference.timestamps.numpy(), reference.positions.numpy()
    inside = (times >= known[0]) & (times <= known[-1])
    if inside.sum() < 3:
        return None
    target = torch.from_numpy(_interpolated(times[inside], known, positions))
    source = estimate.positions[torch.from_numpy(inside)]
    return float(distances(source, target, align(source, target)).square().mean().sqrt())


def _refined(estimate: Trajectory, reference: Trajectory, offset_s: float, around_s: float) -> tuple[float, float]:
    """(ATE, offset) of the best offset within around_s, by golden section."""
    ratio = (5**0.5 - 1) / 2
    low, high = offset_s - around_s, offset_s + around_s

    def cost(offset: float) -> float:
        found = fit_m(estimate, reference, offset)
        return np.inf if found is None else found

    a, b = high - ratio * (high - low), low + ratio * (high - low)
    cost_a, cost_b = cost(a), cost(b)
    while high - low > 1e-4:
        if cost_a <= cost_b:
            high, b, cost_b = b, a, cost_a
            a = high - ratio * (high - low)
            cost_a = cost(a)
        else:
            low, a, cost_a = a, b, cost_b
            b = low + ratio * (high - low)
            cost_b = cost(b)
    return min((cost_a, a), (cost_b, b))


def _speeds(trajectory: Trajectory, step: float) -> Array:
    """Speeds on a grid from the first pose on, m/s."""
    times = trajectory.timestamps.numpy() - float(trajectory.timestamps[0])
    grid = np.arange(0.0, times[-1] + 1e-9, step)
    before, after = (np.clip(grid + shift, 0.0, times[-1]) for shift in (-HALF_S, HALF_S))
    positions = trajectory.positions.numpy()
    moved = _interpolated(after, times, positions) - _interpolated(before, times, positions)
    speed: Array = np.linalg.norm(moved, axis=1) / np.maximum(after - before, 1e-9)
    return speed


def _interpolated(times: Array, known: Array, values: Array) -> Array:
    return np.stack([np.interp(times, known, column) for column in values.T], axis=1)


def _correlations(a: Array, b: Array) -> dict[int, float]:
    """Correlation of a[k + lag] with b[k] by lag, for the lags at which both have enough in common."""
    fewest = max(FEWEST, int(SHARED * min(len(a), len(b))))
    lags = range(fewest - len(b), len(a) - fewest + 1)
    size = 1 << (len(a) + len(b)).bit_length()
    shared = a - a.mean(), b - b.mean()
    products = np.fft.irfft(np.fft.rfft(shared[0], size) * np.fft.rfft(shared[1], size).conj(), size)
    sums = [np.concatenate([[0.0], np.cumsum(x)]) for x in (shared[0], shared[1], shared[0] ** 2, shared[1] ** 2)]
    found = {}
    for lag in lags:
        begin, end = max(lag, 0), min(len(a), len(b) + lag)
        count = end - begin
        sum_a, sum_b, square_a, square_b = (
            x[end - s] - x[begin - s] for x, s in zip(sums, (0, lag, 0, lag), strict=True)
        )
        spread = (square_a - sum_a**2 / count) * (square_b - sum_b**2 / count)
        if spread > 1e-12:
            found[lag] = float((products[lag % size] - sum_a * sum_b / count) / spread**0.5)
    return found
