"""What the sensor makes of the light and the geometry: a hand-held Kinect of the first generation."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from .config import SensorConfig
from .render import Depth
from .world import GAMMA, Floats

MID = 0.5**GAMMA  # linear radiance that gives half of the gray range
SHADOW_PX = 0.7  # disparity by which the nearer surface must reach over a point to hide it from the projector
GRAZING = 0.17  # cosine below which nothing comes back
JUMP = 0.005  # relative departure from the neighbours' mean depth at which the matcher fails
Rng = np.random.Generator


def exposure_gain(t: float, config: SensorConfig, seed: int) -> float:
    """Relative gain at time t (s): three slow sinusoids, together within 1 +- config.drift."""
    if not config.exposure_drift:
        return 1.0
    rng = np.random.default_rng([seed, 7])
    hz, phase = rng.uniform(0.05, 0.35, 3), rng.uniform(0, 2 * np.pi, 3)
    return 1.0 + config.drift * float(np.sin(2 * np.pi * hz * t + phase).mean())


def develop(radiance: Floats, gain: float, config: SensorConfig, rng: Rng) -> npt.NDArray[np.uint8]:
    """(H, W, 3) uint8 colours of linear radiance (1 = white): gain, shot and read noise, gamma.

    The shot noise is scaled so that a channel's deviation at mid gray is config.noise_gray; the read noise is a sixth
    of it there, and what is left in the dark.
    """
    linear = radiance * np.float32(gain)
    if config.color_noise:
        sigma = config.noise_gray / 255.0 * GAMMA * MID ** (1 - 1 / GAMMA)
        shot, read = np.float32(sigma**2 / MID), np.float32((sigma / 6) ** 2)
        linear = linear + np.sqrt(linear * shot + read) * rng.standard_normal(linear.shape, dtype=np.float32)
    display = cv2.pow(np.clip(linear, 0, 1), 1 / GAMMA)
    return np.asarray(display * 255.0 + 0.5).astype(np.uint8)


def measure(seen: Depth, config: SensorConfig, rng: Rng) -> npt.NDArray[np.uint16]:
    """(H, W) uint16 depth, 5000 per metre, 0 where the sensor gives none."""
    depth, valid = _holes(seen, config, rng) if config.depth_holes else (seen.depth, seen.depth > 0)
    disparity = config.focal_baseline / np.where(depth > 0, depth, 1.0)
    if config.depth_noise:
        disparity = disparity + config.sigma_disparity * smooth_noise(depth.shape, 1.2, rng)
    if config.depth_quantisation:
        disparity = np.round(disparity / config.disparity_step) * config.disparity_step
    if config.depth_noise or config.depth_quantisation:
        depth = (config.focal_baseline / np.maximum(disparity, config.disparity_step)).astype(np.float32)
    if config.depth_range:
        valid = valid & (depth >= config.range_min_m) & (depth <= config.range_max_m)
    counts = np.round(depth.astype(np.float64) * 5000.0)
    return np.where(valid & (counts <= 65535), counts, 0).astype(np.uint16)


def _holes(seen: Depth, config: SensorConfig, rng: Rng) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Depth with ragged borders, and where the projector's pattern is seen at all.

    The projector stands to the right of the camera: in its image a point stands f b / z further left, so the surface
    behind a near object's left border lies in shadow. The matcher's window smears and drops the depth at jumps.
    """
    h, w = seen.depth.shape
    wobble = [smooth_noise((h, w), 1.0, rng) for _ in range(2)]
    x, y = np.meshgrid(np.arange(w, dtype=np.float32), np.arange(h, dtype=np.float32))
    where = (x + wobble[0], y + 0.7 * wobble[1])
    depth = cv2.remap(seen.depth, *where, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
    jump = np.abs(depth - cv2.blur(depth, (3, 3))) > JUMP * depth  # a tilted plane has steps too, but no such bend
    dropped = jump & (rng.random((h, w), dtype=np.float32) < 0.7)
    shadow = projector_shadow(seen.depth, config.focal_baseline)
    grazing = seen.cosine < GRAZING * (1 + 0.3 * wobble[0])
    return depth, (depth > 0) & ~dropped & ~shadow & ~grazing


def projector_shadow(depth: Floats, focal_baseline: float) -> npt.NDArray[np.bool_]:
    """(H, W) what the projector, or a second camera, to the right of the camera does not see of depth (H, W) m."""
    at_projector = np.arange(depth.shape[1], dtype=np.float32) - focal_baseline / np.maximum(depth, 0.1)
    nearest = np.minimum.accumulate(at_projector[:, ::-1], axis=1)[:, ::-1]
    return np.asarray(at_projector > nearest + SHADOW_PX)


def smooth_noise(shape: tuple[int, ...], sigma: float, rng: Rng) -> Floats:
    """Noise of deviation 1 that is correlated over sigma pixels (a Gaussian filter's output, renormalised)."""
    white = rng.standard_normal(shape, dtype=np.float32)
    return np.asarray(cv2.GaussianBlur(white, (0, 0), sigma) * np.float32(2 * np.sqrt(np.pi) * sigma), np.float32)
