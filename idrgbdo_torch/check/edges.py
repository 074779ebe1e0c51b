"""Do colour and depth show the same moment from the same place? Where depth jumps, the colour mostly changes too.

The jumps of the depth are laid over the colour gradients at every shift and at every lag between the two: the sum over
many frames peaks where they belong together. With the wrong lag every frame has its own shift, so the peak smears.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from .samples import Bytes, Floats, Sample

Spectrum = NDArray[np.complex64]

WIDTH = 320  # px to which images are reduced, about
REACH = 32  # reduced px, largest shift
LAGS = range(-6, 7)  # frames
JUMP = 1.06  # ratio of neighbouring depths
GAP = 6  # reduced px that a hole beside a jump may be wide
HALF_GRADIENT = 4.0  # gray levels a px, of a colour edge that counts half
BORDER = 8  # reduced px left out
STRONG = 6.0  # robust standard deviations of a peak above the other shifts
FEWEST = 60  # pixels of depth edges a frame
CONTRAST = 1.15  # of the best lag over those LATER frames away, where the motion suffices to judge
LATER = 3


@dataclass
class EdgeSums:
    """Sums over the frames seen so far, for each lag (frames by which depth is late)."""

    spectra: dict[int, Spectrum] = field(default_factory=dict)  # of the correlation
    weights: dict[int, float] = field(default_factory=dict)
    shape: tuple[int, int] = (0, 0)  # of the images, padded
    pixels: float = 0.0
    frames: int = 0
    zoom: float = 1.0  # px of the recording per reduced px

    def add(self, run: list[Sample]) -> None:
        """Add a run of neighbouring frames."""
        spectra = [self._spectra(sample) for sample in run]
        for lag in LAGS:
            for i, (_, edges, count) in enumerate(spectra):
                if not 0 <= i - lag < len(run):
                    continue
                colors = spectra[i - lag][0]
                product = sum(color * np.conj(edge) for color, edge in zip(colors, edges, strict=True))
                self.spectra[lag] = self.spectra.get(lag, np.zeros((), np.complex64)) + product
                self.weights[lag] = self.weights.get(lag, 0.0) + count

    def _spectra(self, sample: Sample) -> tuple[list[Spectrum], list[Spectrum], float]:
        """Of the colour and of the depth edges across both axes, and how many pixels the latter have."""
        gray, depth, self.zoom = reduced(sample)
        inside = np.zeros(gray.shape, np.float32)
        inside[BORDER:-BORDER, BORDER:-BORDER] = 1.0
        self.shape = (cv2.getOptimalDFTSize(gray.shape[0] + REACH), cv2.getOptimalDFTSize(gray.shape[1] + REACH))
        colors, edges, count = [], [], 0.0
        for axis in (0, 1):
            color = color_edges(gray, axis)
            color = (color - color.mean()) / max(float(color.std()), 1e-6) * inside
            edge = depth_edges(depth, axis) * inside
            colors.append(np.fft.rfft2(color, self.shape).astype(np.complex64))
            edges.append(np.fft.rfft2(edge, self.shape).astype(np.complex64))
            count += float(edge.sum())
        self.pixels += count
        self.frames += 1
        return colors, edges, count

    def _surface(self, lag: int) -> NDArray[np.float64]:
        """(2 REACH + 1, 2 REACH + 1) mean agreement of a depth edge's pixel at every shift of the colour."""
        surface = np.fft.irfft2(self.spectra[lag], self.shape) / max(self.weights[lag], 1.0)
        return np.roll(surface, (REACH, REACH), axis=(0, 1))[: 2 * REACH + 1, : 2 * REACH + 1].astype(np.float64)

    def fit(self) -> EdgeFit:
        """Lag and shift at which the edges agree best."""
        means = {lag: self._surface(lag) for lag in self.spectra}
        if not means or self.pixels < FEWEST * self.frames:
            return EdgeFit(means, 0, 0.0, (0.0, 0.0), 0.0, 1.0)
        peaks = {lag: float(mean.max()) for lag, mean in means.items()}
        lag = max(peaks, key=lambda each: peaks[each])
        best = means[lag]
        row, column = (int(x) for x in np.unravel_index(best.argmax(), best.shape))
        base = float(np.median(best))
        spread = 1.4826 * float(np.median(np.abs(best - base)))
        later = [peaks[each] for each in (lag - LATER, lag + LATER) if each in peaks]
        return EdgeFit(
            surfaces=means,
            lag=lag,
            fine_lag=lag + _vertex(*(peaks.get(each, peaks[lag]) for each in (lag - 1, lag, lag + 1))),
            shift=((REACH - column) * self.zoom, (REACH - row) * self.zoom),
            strength=(peaks[lag] - base) / max(spread, 1e-9),
            contrast=peaks[lag] / max(*later, 1e-9) if later else 1.0,
        )


@dataclass(frozen=True)
class EdgeFit:
    """Where colour and depth agree best."""

    surfaces: dict[int, NDArray[np.float64]]  # per lag
    lag: int  # frames by which the depth is late
    fine_lag: float  # the same, between frames
    shift: tuple[float, float]  # px, of the depth against the colour: right, down
    strength: float  # of the peak, robust standard deviations; 0 where there are too few edges
    contrast: float  # of the lag against others


def reduced(sample: Sample) -> tuple[Floats, Floats, float]:
    """Gray (mean) and depth (nearest) at about WIDTH px, and by how much they were reduced."""
    step = max(1, round(sample.gray.shape[1] / WIDTH))
    height, width = sample.gray.shape[0] // step, sample.gray.shape[1] // step
    gray = cv2.resize(sample.gray[: height * step, : width * step], (width, height), interpolation=cv2.INTER_AREA)
    depth = sample.depth[step // 2 :: step, step // 2 :: step][:height, :width]
    return gray.astype(np.float32), depth, float(step)


def color_edges(gray: Floats | Bytes, axis: int) -> Floats:
    """How much of an edge each pixel is, 0 to 1, for edges that cross the axis (0: down, 1: right)."""
    smooth = cv2.GaussianBlur(gray.astype(np.float32), (0, 0), 1.0)
    gradient = np.abs(np.gradient(smooth, axis=axis))
    return np.asarray(gradient / (gradient + HALF_GRADIENT), np.float32)


def depth_edges(depth: Floats, axis: int) -> Floats:
    """1 on the near side of every depth jump that crosses the axis, holes of up to GAP px bridged."""
    near = np.where(depth > 0, depth, np.inf)
    edge = np.zeros(depth.shape, dtype=np.bool_)
    for sign in (1, -1):
        beside = _moved(near, sign, axis)
        beyond = np.zeros(depth.shape)
        for n in range(1, GAP + 1):
            behind = _moved(near, sign * n, axis)
            beyond = np.maximum(beyond, np.where(np.isfinite(behind), behind, 0.0))
        # the pixel beside is farther, or a hole with something farther behind it
        edge |= (beside > JUMP * near) & (np.isfinite(beside) | (beyond > JUMP * near))
    return edge.astype(np.float32)


def _moved(image: Floats, n: int, axis: int) -> Floats:
    """The image moved by n pixels; what comes in is infinite."""
    out = np.roll(image, n, axis)
    border = [slice(None), slice(None)]
    border[axis] = slice(0, n) if n > 0 else slice(n, None)
    out[tuple(border)] = np.inf
    return out


def _vertex(before: float, here: float, after: float) -> float:
    """Where the parabola through three neighbouring values has its maximum, in steps from the middle one."""
    bend = before - 2.0 * here + after
    return float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend < 0 else 0.0
