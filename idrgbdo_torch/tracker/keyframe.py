"""When a frame becomes a keyframe (section 5.1): the entropy of each degree of freedom, and the decision."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.random import Generator
from numpy.typing import NDArray
from torch import Tensor

from ..config import Config, KeyframeConfig
from ..frame import Frame, Keyframe
from ..measurement import COMPACT, Points, inverse_depth_sigma, pattern_of
from .backends import Backend
from .candidates import extract_candidates, spread_out

Array = NDArray[np.float64]

REFERENCE_FRAMES = 3  # the reference is the median over the first frames after the keyframe
FEWEST_CANDIDATES = 16  # that make a keyframe
WITNESSES = 256  # points that a pose is verified with
SURE_BITS = -0.5  # the ratio of Eq. 20 means nothing where the reference entropy is not clearly negative


def entropy_decrement(entropy: Tensor, reference: Tensor) -> Tensor:
    """Eq. (20). H*_Delta(x, x_0) = 1 - H*(x) / H*(x_0) (..., 6), as printed; positive when certainty has been lost.

    Only meaningful while both entropies are negative, which depends on the unit (metres, radians).
    """
    return 1.0 - entropy / reference


def lost_certainty(entropy: Tensor, reference: Tensor, criterion: str) -> Tensor:
    """How much less is known of each degree of freedom (..., 6) than at the reference, by the configured criterion.

    "bits" is log2(sigma / sigma_0) = H* - H*_0 and knows no units; "ratio" is Eq. 20 where it is meaningful, else bits.
    """
    bits = entropy - reference
    if criterion == "bits":
        return bits
    return torch.where(reference < SURE_BITS, entropy_decrement(entropy, reference), bits)


def wants_keyframe(history: list[Array], config: KeyframeConfig) -> bool:
    """Whether any degree of freedom has lost too much; history: entropies (6,) tracked since the keyframe."""
    first = np.array(history[:REFERENCE_FRAMES])
    first.sort(axis=0)
    reference = first[(len(first) - 1) // 2]  # the lower median
    if config.criterion == "bits":  # lost_certainty in numpy: this runs for every frame
        with np.errstate(invalid="ignore"):  # infinite then and now is no change
            return bool((history[-1] - reference).max() > config.threshold_bits)
    lost = lost_certainty(torch.from_numpy(history[-1]), torch.from_numpy(reference), config.criterion)
    return bool(lost.max() > config.threshold_ratio)


def make_keyframe(frame: Frame, config: Config, rng: Generator, backend: Backend) -> Keyframe:
    """Extract the candidates of a frame and everything that tracking needs of them."""
    uv, inv_depth, slope = extract_candidates(frame, config, rng, backend)
    camera = frame.camera
    coarse = spread_out(uv, config.tracking.points_coarse, camera.width, camera.height, backend)
    witnesses = coarse if len(coarse) >= WITNESSES else spread_out(uv, WITNESSES, camera.width, camera.height, backend)
    levels, pixels, pattern = len(frame.images), config.tracking.patch, pattern_of(config.tracking)
    patch = np.zeros((levels, len(uv), pixels), np.float32)
    gradient = np.zeros((levels, len(uv), pixels, 2), np.float32)
    backend.sample_patches(frame.images, uv, np.arange(len(uv)), range(1), pattern, patch, gradient)
    backend.sample_patches(frame.images, uv, np.union1d(coarse, witnesses), range(1, levels), pattern, patch, gradient)
    radius = np.hypot(uv[:, 0] - camera.cx, uv[:, 1] - camera.cy)
    radius /= max(radius.max(initial=0.0), 1.0)
    sigma = inverse_depth_sigma(config.noise.focal_baseline, config.noise.sigma_disparity)
    variance = np.full(len(uv), sigma**2)
    points = Points(uv, inv_depth, variance, patch, gradient, slope)
    return Keyframe(frame, points, inv_depth, variance, radius, coarse, witnesses)


def all_patches(keyframe: Keyframe, backend: Backend) -> Keyframe:
    """The keyframe with the patches of every point on every level, as it takes to track all of them everywhere."""
    points = keyframe.points
    patch, gradient = points.patch.copy(), points.gradient.copy()
    everyone = np.arange(len(points.uv))
    backend.sample_patches(keyframe.frame.images, points.uv, everyone, range(1, len(patch)), COMPACT, patch, gradient)
    return replace(keyframe, points=points._replace(patch=patch, gradient=gradient))


def only(keyframe: Keyframe, mask: NDArray[np.bool_]) -> Keyframe:
    """The keyframe with some of its points alone; mask: (N,) which."""
    points, place = keyframe.points, np.cumsum(mask) - 1
    fewer = Points(
        points.uv[mask], points.inv_depth[mask], points.var_inv_depth[mask],
        np.ascontiguousarray(points.patch[:, mask]), np.ascontiguousarray(points.gradient[:, mask]), points.slope[mask],
    )  # fmt: skip
    return replace(
        keyframe, points=fewer, measured=keyframe.measured[mask], measured_variance=keyframe.measured_variance[mask],
        radius=keyframe.radius[mask], coarse=place[keyframe.coarse[mask[keyframe.coarse]]],
        witnesses=place[keyframe.witnesses[mask[keyframe.witnesses]]],
    )  # fmt: skip
