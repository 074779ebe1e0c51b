"""Depth by kind of sensor: structured light (sensor.py), stereo matching as a RealSense does it, time of flight."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from .config import FaultConfig, SensorConfig
from .render import Depth
from .sensor import GRAZING, Rng, measure, projector_shadow, smooth_noise
from .world import Floats

STEREO_FB = 25.0  # px m, focal length times baseline of a RealSense D435
STEREO_PX = 0.08  # deviation of its disparity
WINDOW_PX = 3.0  # over which its matcher's errors are alike
HOLES, HOLE_PX = 0.04, 6.0  # share of the image where no match is found, size of such places
SPECKLE, SPECKLE_PX, SPECKLE_DEPTH = 0.006, 2.0, 0.2  # share of false matches, their size, relative error of depth
TOF_PX = 2.5  # px of colour that share a pixel of depth
TOF_NOISE_M, TOF_NOISE_FAR = 0.001, 0.0012  # m, and m per m^2 of squared distance over the cosine of incidence
WIGGLE_M, WIGGLE_PERIOD_M = 0.003, 0.75  # systematic error that repeats with the modulation's wavelength
TOF_RANGE_M = 5.5


def measured_depth(seen: Depth, sensor: SensorConfig, faults: FaultConfig, rng: Rng) -> npt.NDArray[np.uint16]:
    """(H, W) uint16 depth, 5000 per metre, 0 where the sensor gives none."""
    if faults.stereo:
        return counts(*_stereo(seen, faults.stereo, rng))
    if faults.tof:
        return counts(*_time_of_flight(seen, faults.tof, rng))
    return measure(seen, sensor, rng)


def counts(depth: Floats, valid: npt.NDArray[np.bool_]) -> npt.NDArray[np.uint16]:
    """Depth in metres as the file has it."""
    whole = np.round(depth.astype(np.float64) * 5000.0)
    return np.where(valid & (whole > 0) & (whole <= 65535), whole, 0).astype(np.uint16)


def _stereo(seen: Depth, size: float, rng: Rng) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Matched windows: errors in patches, holes, shadows of the second camera, and islands of false matches."""
    shape = seen.depth.shape
    disparity = STEREO_FB / np.maximum(seen.depth, 0.1)
    disparity = disparity + size * STEREO_PX * smooth_noise(shape, WINDOW_PX, rng)
    depth = (STEREO_FB / np.maximum(disparity, STEREO_PX)).astype(np.float32)
    false = _islands(shape, SPECKLE * size, SPECKLE_PX, rng)
    depth = np.where(false, depth * np.exp(SPECKLE_DEPTH * smooth_noise(shape, 2 * SPECKLE_PX, rng)), depth)
    hole = _islands(shape, HOLES * size, HOLE_PX, rng)
    shadow = projector_shadow(seen.depth, STEREO_FB)
    grazing = seen.cosine < GRAZING * (1 + 0.3 * smooth_noise(shape, 1.0, rng))
    return depth.astype(np.float32), (seen.depth > 0) & ~hole & ~shadow & ~grazing


def _time_of_flight(seen: Depth, size: float, rng: Rng) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Few pixels that mix what is before and behind an edge, noise that grows with distance, and a wiggling error."""
    h, w = seen.depth.shape
    few = (max(round(w / TOF_PX), 1), max(round(h / TOF_PX), 1))
    coarse = cv2.resize(seen.depth, few, interpolation=cv2.INTER_AREA)
    cosine = np.maximum(cv2.resize(seen.cosine, few, interpolation=cv2.INTER_AREA), 0.05)
    sigma = size * (TOF_NOISE_M + TOF_NOISE_FAR * coarse**2 / cosine)
    coarse = coarse + sigma * rng.standard_normal(coarse.shape, dtype=np.float32)
    coarse = coarse + size * WIGGLE_M * np.sin(2 * np.pi * coarse / WIGGLE_PERIOD_M)
    lit = rng.random(coarse.shape) < np.clip((cosine - 0.08) / 0.12, 0, 1)
    depth = cv2.resize(coarse.astype(np.float32), (w, h), interpolation=cv2.INTER_LINEAR)
    valid = cv2.resize(lit.astype(np.uint8), (w, h), interpolation=cv2.INTER_NEAREST) > 0
    return depth, valid & (seen.depth > 0) & (depth < TOF_RANGE_M)


def _islands(shape: tuple[int, ...], share: float, sigma: float, rng: Rng) -> npt.NDArray[np.bool_]:
    """Places of about sigma pixels that cover a share of the image."""
    noise = smooth_noise(shape, sigma, rng)
    return np.asarray(noise > np.quantile(noise, 1 - min(share, 1.0)))
