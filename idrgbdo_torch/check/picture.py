"""The picture of a check: depth edges over colour, the depth, the agreement at every shift and lag, the intervals."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ..report.pictures import CAPTION, Picture
from .edges import REACH, depth_edges
from .measured import Measured
from .samples import Sample

SIDE = 520  # px, width of a panel
HEIGHT = 390
INK, RED, BLUE, PALE = (30, 30, 30), (230, 40, 40), (31, 98, 201), (228, 228, 228)


def draw(measured: Measured) -> Picture:
    """Four panels, (2 (HEIGHT + CAPTION), 2 SIDE, 3) RGB."""
    upper = np.hstack([_overlay(measured.shown), _depth(measured.shown)])
    lower = np.hstack([_agreement(measured), _intervals(measured)])
    return np.vstack([upper, lower]).astype(np.uint8)


def _overlay(sample: Sample | None) -> Picture:
    """Where depth jumps, in red over the colour: the red lines should lie on the outlines of things."""
    if sample is None:
        return _panel("no frame", _empty())
    base = np.repeat(sample.gray[..., None], 3, axis=2) if sample.color is None else sample.color
    image = (0.8 * base).astype(np.uint8)
    edges = np.maximum(depth_edges(sample.depth, 0), depth_edges(sample.depth, 1)) > 0
    image[edges] = RED
    return _panel(f"frame {sample.index}: depth edges (red) should lie on outlines", _fitted(image))


def _depth(sample: Sample | None) -> Picture:
    """Near is bright, far is dark, black is unknown."""
    if sample is None or not (sample.depth > 0).any():
        return _panel("no depth", _empty())
    valid = sample.depth > 0
    near, far = np.percentile(sample.depth[valid], [2, 98])
    share = np.clip((far - sample.depth) / max(far - near, 1e-6), 0, 1)
    image = cv2.applyColorMap((255 * share).astype(np.uint8), cv2.COLORMAP_VIRIDIS)[..., ::-1].copy()
    image[~valid] = 0
    return _panel(f"depth: {near:.2f} m yellow, {far:.2f} m blue, black unknown", _fitted(image))


def _agreement(measured: Measured) -> Picture:
    """Left, how well the edges agree at every shift of the best lag; right, how well at every lag."""
    fit, canvas = measured.edges, _empty()
    if fit.strength == 0.0:
        return _panel("colour on depth: too few depth edges to tell", canvas)
    surface = fit.surfaces[fit.lag]
    level = (surface - surface.min()) / max(float(np.ptp(surface)), 1e-9)
    heat = cv2.applyColorMap((255 * level).astype(np.uint8), cv2.COLORMAP_VIRIDIS)[::-1, ::-1, ::-1]
    side = SIDE // 2 - 10
    canvas[20 : 20 + side, 5 : 5 + side] = cv2.resize(heat, (side, side), interpolation=cv2.INTER_NEAREST)
    middle = round(side * (REACH + 0.5) / (2 * REACH + 1))
    cv2.drawMarker(canvas, (5 + middle, 20 + middle), (255, 255, 255), cv2.MARKER_CROSS, 16, 1)
    _write(canvas, "shift of depth; cross: none", (5, 20 + side + 18))
    lags = sorted(fit.surfaces)
    most = max(float(surface.max()) for surface in fit.surfaces.values())
    for number, lag in enumerate(lags):
        u = SIDE // 2 + 10 + number * (side // len(lags))
        top = 20 + round(side * (1 - float(fit.surfaces[lag].max()) / most))
        cv2.rectangle(canvas, (u, top), (u + side // len(lags) - 3, 20 + side), RED if lag == fit.lag else BLUE, -1)
    _write(canvas, f"lag of depth, {lags[0]:+d} to {lags[-1]:+d} frames", (SIDE // 2 + 10, 20 + side + 18))
    return _panel("agreement of colour and depth edges", canvas)


def _intervals(measured: Measured) -> Picture:
    """Time from frame to frame."""
    canvas, t = _empty(), measured.timing
    if t is None:
        return _panel("too few frames for intervals", canvas)
    most = max(4.0 * t.period_s, float(np.percentile(t.intervals_s, 99)))
    u = np.linspace(10, SIDE - 10, len(t.intervals_s))
    v = HEIGHT - 10 - np.clip(t.intervals_s / most, 0, 1) * (HEIGHT - 30)
    for n in (1, 2, 3):
        line = round(HEIGHT - 10 - n * t.period_s / most * (HEIGHT - 30))
        cv2.line(canvas, (10, line), (SIDE - 10, line), PALE, 1)
        _write(canvas, f"{1000 * n * t.period_s:.0f} ms", (SIDE - 70, line - 4))
    for x, y, interval in zip(u, v, t.intervals_s, strict=True):
        cv2.circle(canvas, (round(x), round(y)), 2, RED if interval > 1.5 * t.period_s else BLUE, -1, cv2.LINE_AA)
    return _panel("time from frame to frame; red: something is missing", canvas)


def _panel(caption: str, image: NDArray[np.uint8]) -> Picture:
    out = np.full((HEIGHT + CAPTION, SIDE, 3), 255, dtype=np.uint8)
    out[CAPTION:] = image
    _write(out, caption, (8, CAPTION - 8))
    return out


def _fitted(image: NDArray[np.uint8]) -> Picture:
    """The image as large as the panel allows, on white."""
    scale = min((SIDE - 6) / image.shape[1], HEIGHT / image.shape[0])
    size = (round(image.shape[1] * scale), round(image.shape[0] * scale))
    out = _empty()
    out[: size[1], : size[0]] = cv2.resize(np.ascontiguousarray(image), size, interpolation=cv2.INTER_AREA)
    return out


def _empty() -> Picture:
    return np.full((HEIGHT, SIDE, 3), 255, dtype=np.uint8)


def _write(image: Picture, text: str, where: tuple[int, int]) -> None:
    cv2.putText(image, text, where, cv2.FONT_HERSHEY_SIMPLEX, 0.46, INK, 1, cv2.LINE_AA)
