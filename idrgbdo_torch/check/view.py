"""Does depth show the same angle of view as colour? Where its edges fit nowhere as it is, they may once it is zoomed.

A depth camera beside the colour camera often sees wider: its images, taken for colour's, match at no shift. Zoomed by
the ratio of the focal lengths they do, but for the parallax between the two cameras.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from .edges import color_edges, depth_edges
from .samples import Floats, Sample

WIDTH = 200  # px to which images are reduced, about
ZOOMS = np.exp(np.arange(-0.54, 0.661, 0.04))  # of depth, about the image's middle
REACH = 14  # reduced px, largest shift that is looked at
OFF = 6  # reduced px, largest shift that is believed: both cameras look the same way, a few centimetres apart
MOST = 30  # frames
BORDER = 6  # reduced px left out
FEWEST = 60  # pixels of depth edges a frame
EVERY = 2  # frames between two that are kept
PROMINENT = 1.8  # of the best zoom over the middle one
ASIDE = 1.3  # of the best zoom over those NEAR steps away
NEAR = 4
HALF = 1.4  # of the best zoom over the middle one, in each half of the recording
AGREE = 2  # steps by which the halves of the recording may differ
REGISTERED = 1.1  # zoom or its inverse, within which depth may be registered to colour


@dataclass(frozen=True)
class ViewFit:
    """How depth has to be changed so that it fits colour."""

    zoom: float  # colour's focal length over depth's
    shift: tuple[float, float]  # px of the recording, of the zoomed depth against the colour: right, down


@dataclass
class Views:
    """Small copies of frames, for the question that only some recordings raise."""

    pairs: list[tuple[Floats, Floats]] = field(default_factory=list)  # gray, depth
    step: int = 1  # px of the recording per reduced px

    def add(self, run: list[Sample]) -> None:
        """Keep some frames of a run, reduced."""
        for sample in run[::EVERY]:
            self.step = max(1, round(sample.gray.shape[1] / WIDTH))
            height, width = (side // self.step for side in sample.gray.shape)
            whole = sample.gray[: height * self.step, : width * self.step]
            gray = cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32)
            first = self.step // 2
            self.pairs.append((gray, sample.depth[first :: self.step, first :: self.step][:height, :width]))

    def fit(self) -> ViewFit | None:
        """The zoom at which depth fits colour; None where no zoom stands out, or where none is needed.

        Both halves of the recording must find it.
        """
        pairs = self.pairs[:: -(-len(self.pairs) // MOST) or 1]
        if len(pairs) < 4:
            return None
        halves = [_surfaces(half) for half in (pairs[: len(pairs) // 2], pairs[len(pairs) // 2 :])]
        whole = halves[0] + halves[1]
        best = _best(whole)
        if best is None or not all(_agrees(half, best) for half in halves):
            return None
        if abs(np.log(ZOOMS[best])) < np.log(REGISTERED):
            return None
        near = _near(whole[best])
        row, column = (int(x) for x in np.unravel_index(near.argmax(), near.shape))
        return ViewFit(float(ZOOMS[best]), ((OFF - column) * self.step, (OFF - row) * self.step))


def _surfaces(pairs: list[tuple[Floats, Floats]]) -> NDArray[np.float64]:
    """(Z, 2 REACH + 1, 2 REACH + 1) mean agreement of a depth edge's pixel at every zoom and shift of the colour."""
    sums = np.zeros((len(ZOOMS), 2 * REACH + 1, 2 * REACH + 1))
    counts = np.zeros(len(ZOOMS))
    for gray, depth in pairs:
        colors = [_whitened(color_edges(gray, axis)) for axis in (0, 1)]
        for number, zoom in enumerate(ZOOMS):
            for axis, color in enumerate(colors):
                edge = depth_edges(zoomed(depth, float(zoom)), axis)
                inner = edge[BORDER:-BORDER, BORDER:-BORDER]
                counts[number] += inner.sum()
                sums[number] += cv2.matchTemplate(color, inner, cv2.TM_CCORR)
    fewest = FEWEST * len(pairs)
    return np.where(counts >= fewest, 1.0 / np.maximum(counts, 1.0), 0.0)[:, None, None] * sums


def _whitened(edges: Floats) -> Floats:
    inner = edges[BORDER:-BORDER, BORDER:-BORDER]
    return np.pad((inner - inner.mean()) / max(float(inner.std()), 1e-6), REACH).astype(np.float32)


def zoomed(depth: Floats, zoom: float) -> Floats:
    """The depth image enlarged about its middle, same size; 0 where it has nothing."""
    height, width = depth.shape
    move = np.array([[zoom, 0, (1 - zoom) * (width - 1) / 2], [0, zoom, (1 - zoom) * (height - 1) / 2]])
    return np.asarray(cv2.warpAffine(depth, move, (width, height), flags=cv2.INTER_NEAREST), np.float32)


def _best(surfaces: NDArray[np.float64]) -> int | None:
    """The zoom that stands out against all others and against those near it; None where none does."""
    peaks = _heights(surfaces)
    best = int(peaks.argmax())
    around = [peaks[at] if 0 <= at < len(peaks) else np.inf for at in (best - NEAR, best + NEAR)]
    known = peaks[peaks > 0]
    if len(known) == 0 or min(around) <= 0 or peaks[best] < max(PROMINENT * np.median(known), ASIDE * max(around)):
        return None
    return best


def _agrees(surfaces: NDArray[np.float64], best: int) -> bool:
    """Whether a half of the recording, too, has a zoom near the best one that stands out."""
    heights = _heights(surfaces)
    near = heights[max(best - AGREE, 0) : best + AGREE + 1].max()
    return bool(near >= HALF * np.median(heights))


def _heights(surfaces: NDArray[np.float64]) -> NDArray[np.float64]:
    """(Z,) how far the best shift of each zoom stands out against its others."""
    return np.asarray(_near(surfaces).max(axis=(1, 2)) - np.median(surfaces, axis=(1, 2)))


def _near(surfaces: NDArray[np.float64]) -> NDArray[np.float64]:
    """The part of a surface, or of several, whose shifts are believed."""
    return surfaces[..., REACH - OFF : REACH + OFF + 1, REACH - OFF : REACH + OFF + 1]
