"""What a point, its patch and their noise are: the ground that definitions/ and kernels/ share.

Every number that both of them need stands here once; neither imports the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import dist
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .config import Config, NoiseConfig, TrackingConfig
from .errors import IdRgbdoError

Array = NDArray[Any]

COMPACT, WIDE = (
    0,
    1,
)  # patterns: DSO's, and one for the finest level where the plane around a point is known, as wide as that
RING = 2 * np.pi * np.arange(7) / 7
PATTERNS = np.array([  # (2, 8, 2) px, centre first, so that the first pixel is a point alone
    [[0, 0], [0, -2], [-1, -1], [1, -1], [-2, 0], [2, 0], [-1, 1], [0, 2]],
    [[0, 0], *3.0 * np.column_stack([np.sin(RING), -np.cos(RING)])],
])  # fmt: skip
PATTERN = PATTERNS[COMPACT]
PIXELS = len(PATTERN)
LEVELS = 6  # of every pyramid; tracking starts at its configured one, recovery at the coarsest
COARSE_BLUR = 1.2  # px, standard deviation of the blur of the coarse levels
WEAKEST = 0.25  # share of the threshold's gradient that a candidate needs at least
TIER = 65536.0  # what a candidate's tier is worth: above every squared gradient of an 8-bit image
GRADIENT_NOISE = 0.25  # squared gradient of pure noise over var_intensity, the sensor's share of which is a quarter
STEP = 8  # numbers a keyframe of the window: [v, w], a, b
OTHER_SURFACE = 6.0  # times the Huber threshold: a depth this far off belongs to something else
SETTLED = (0.5, 0.1)  # standard deviations; a smaller step ends a round of the finest level
SETTLED_COARSE = 1.0  # and the only one of a coarse level
FLOOR = 1e-9  # added to the diagonal: a direction that nothing measures does not move
NEAR_SIGMAS = 4.0  # standard deviations by which an agreeing depth may be off,
NEAR_SHARE = 0.02  # and the share of the inverse depth that is allowed on top (scale, registration)
IN_FRONT = 0.1  # share of its inverse depth by which something that hides a point is nearer
LINK_FLOOR = 1e-6  # of the largest link, so that a keyframe which a view does not see leaves a matrix to invert
UNKNOWN = 1e-9  # of a unit diagonal, likewise for a pose that nothing measures
RATE = 30.0  # Hz, at which the motion prior and the speed of an image are given


class Noise(NamedTuple):
    """NoiseConfig as the plain numbers that residuals are weighted with."""

    var_intensity: float  # gray levels^2
    var_pixel: float  # px^2, times the number of patch pixels that share it
    var_depth: float  # (1/m)^2, one sensor reading
    shared: float  # number of patch pixels that share one depth error
    c_h: float
    huber: float  # whitened
    outlier: float  # limit of a point's whitened residual, in robust standard deviations
    use_depth: bool
    paper_variance: bool
    gradient_blend: float  # share of the reference gradient in the Jacobian
    coarse: float  # share of what level 1 says of a pose that counts on the finest level
    pattern: int  # of the patches of the finest level: COMPACT or WIDE; on the others they are COMPACT


class Points(NamedTuple):
    """Reference points of one keyframe, a struct of arrays."""

    uv: Array  # (N, 2) float64 px, level 0
    inv_depth: Array  # (N,) float64 1/m
    var_inv_depth: Array  # (N,) float64 (1/m)^2
    patch: Array  # (L, N, P) float32 gray levels
    gradient: Array  # (L, N, P, 2) float32 gray levels/px of the reference
    slope: Array  # (N, 2) float64 1/m per px of level 0, of the inverse depth over the patch


class WindowPoints(NamedTuple):
    """Points of all keyframes, padded to the same number a keyframe."""

    uv: Array  # (K, N, 2) float64 px
    patch: Array  # (K, N, P) float32 gray levels
    gradient: Array  # (K, N, P, 2) float32
    measured: Array  # (K, N) float64 1/m, the sensor's inverse depth
    variance: Array  # (K, N) float64 (1/m)^2 of it
    valid: Array  # (K, N) bool
    slope: Array  # (K, N, 2) float64 1/m per px, of the inverse depth over the patch


class View(NamedTuple):
    """What a frame shows: the gray pyramid, the depth, the camera of every level."""

    images: tuple[Array, ...]  # a level: (H >> l, W >> l) float32 gray levels
    depth: Array  # (H, W) float32 m, 0 where missing
    cameras: Array  # (L, 4) float64 fx fy cx cy


class Subset(NamedTuple):
    """Some of a keyframe's points, and how many pixels of their patches count."""

    which: Array  # (M,) int64
    pixels: int
    weight: Array | None = None  # (N, P) factors above 0 on the information of all points' pixels, if there are any


class State(NamedTuple):
    """What is looked for when a frame (target) is aligned to a keyframe (host)."""

    T: Array  # (4, 4) T_target_host
    affine: Array  # (2,) gain's logarithm and offset of the target relative to the host


class MotionPrior(NamedTuple):
    """What is known beforehand of a State: Eq. 19's Gaussian about a pose, and one about the start's brightness."""

    T_inverse: Array  # (4, 4) inverse of the predicted T_target_host
    information: Array  # (6, 6) Sigma_m^-1 of a left increment
    affine_information: Array  # (2, 2)


class Heard(NamedTuple):
    """What the points of one level say of a pose: normal equations about where their search ended."""

    T_inverse: Array  # (4, 4) inverse of T_target_host there
    H: Array  # (6, 6) of a left increment
    b: Array  # (6,)


class System(NamedTuple):
    """Normal equations of one pair; filled in place."""

    H: Array  # (8, 8) of [v, w, a, b]
    b: Array  # (8,) -J^T W r
    rms: Array  # (M,) whitened residual of each point, -1 where it is not seen


class Aligned(NamedTuple):
    """Where an alignment ended."""

    T: Array  # (4, 4) T_target_host
    affine: Array  # (2,)
    H: Array  # (8, 8) with the brightness prior and what level 1 says of the pose, without the motion prior
    rms: Array  # (M,) of the fine points
    scale: float  # robust scale of the whitened residuals
    iterations: int
    seen: int  # points
    kept: int  # points within the outlier limit
    change: float  # standard deviations, the last step's size
    affine_centre: Array  # (2,) the brightness prior of the finest level: what level 1 found,
    affine_information: Array  # (2, 2) and how surely


class Rows(NamedTuple):
    """Whitened rows of points at a pose: A^T A is a point's information."""

    A: Array  # (M, 3, 6): two of the patch, one of the depth
    seen: Array  # (M,) bool: the margin inside the image
    where: Array  # (M, 2) px in the target


class Agreement(NamedTuple):
    """How many points a pose explains."""

    seen: int
    bright: int  # of those, with agreeing brightness
    with_depth: int
    near: int  # of those, with agreeing depth
    hidden: int  # of those with depth, behind something nearer
    hidden_bright: int  # of those, with agreeing brightness, by chance


class Views(NamedTuple):
    """What the keyframes of a window show."""

    images: Sequence[Array]  # (H, W) float32 gray levels each; at least as many as keyframes, in their order
    depths: Sequence[Array]  # (H, W) float32 m each
    camera: Array  # (4,) fx fy cx cy


class WindowState(NamedTuple):
    """What a window looks for."""

    T: Array  # (K, 4, 4) T_kf_world, where residuals are taken
    T_linear: Array  # (K, 4, 4) where geometric Jacobians are taken (first estimates)
    affine: Array  # (K, 2)
    inv_depth: Array  # (K, N) 1/m


class WindowPairs(NamedTuple):
    """What each pair of host and target says, linear about where it was taken; filled in place.

    In increments of their relative state, those of the target, and of the host's inverse depths.
    """

    H: Array  # (K, K, 8, 8) host, target
    b: Array  # (K, K, 8)
    chain: Array  # (K, K, 8, 8) increments of the relative state by those of the host
    Hd: Array  # (K, K, N) of the inverse depths, diagonal
    bd: Array  # (K, K, N)
    cross: Array  # (K, K, 8, N)
    rms: Array  # (K, K, N) whitened residual, -1 unseen
    energy: Array  # (K, K)
    taken: Array  # (K, K) bool, whether it was taken at all
    at_T: Array  # (K, K, 4, 4) T_target_host where it was
    at_affine: Array  # (K, K, 2, 2) brightness of host and target there
    at_inv_depth: Array  # (K, K, N) 1/m

    @staticmethod
    def empty(K: int, N: int) -> WindowPairs:
        """Room for the pairs of K keyframes with N points each, none of which is taken."""
        pair = (K, K)
        pairs = WindowPairs(
            np.zeros((*pair, STEP, STEP)), np.zeros((*pair, STEP)), np.zeros((*pair, STEP, STEP)),
            np.zeros((*pair, N)), np.zeros((*pair, N)), np.zeros((*pair, STEP, N)), np.zeros((*pair, N)),
            np.zeros(pair), np.zeros(pair, np.bool_), np.zeros((*pair, 4, 4)), np.zeros((*pair, 2, 2)),
            np.zeros((*pair, N)),
        )  # fmt: skip
        pairs.rms[:] = -1.0
        return pairs

    def grown(self) -> WindowPairs:
        """With room for the pairs of one more."""
        K, _, N = self.rms.shape
        more = WindowPairs.empty(K + 1, N)
        for old, new in zip(self, more, strict=True):
            new[:K, :K] = old
        return more

    def keep(self, mask: Array) -> WindowPairs:
        """Those of the keyframes in the mask (K,) bool."""
        return WindowPairs(*(array[np.ix_(mask, mask)] for array in self))


class WindowSystem(NamedTuple):
    """Normal equations of a window, inverse depths still apart; filled in place."""

    H: Array  # (8K, 8K) of poses and brightness
    b: Array  # (8K,)
    Hd: Array  # (K, N) of the inverse depths, diagonal
    bd: Array  # (K, N)
    cross: Array  # (K, 8K, N)

    @staticmethod
    def empty(K: int, N: int) -> WindowSystem:
        """Room for the system of K keyframes with N points each, for who fills all of it."""
        n = STEP * K
        return WindowSystem(np.empty((n, n)), np.empty(n), np.empty((K, N)), np.empty((K, N)), np.empty((K, n, N)))


def inverse_depth_sigma(focal_baseline: float, sigma_disparity: float) -> float:
    """Eq. (10). sigma_d = sigma_px / (f b) in 1/m, from the product f b in px m and the disparity error in px."""
    if not focal_baseline > 0:
        raise IdRgbdoError(
            f"focal_baseline: expected a positive number of px m, got {focal_baseline}; a Kinect has about 40"
        )
    if not sigma_disparity >= 0:
        raise IdRgbdoError(
            f"sigma_disparity: expected a number of px from 0 up, got {sigma_disparity}; a Kinect has 0.06 to 0.5"
        )
    return sigma_disparity / focal_baseline


def pattern_of(config: TrackingConfig) -> int:
    """Of the patches of the finest level: as wide as the plane that is fitted around each point, where that is used."""
    return WIDE if config.slant else COMPACT


def tracked_noise(config: Config) -> Noise:
    """NoiseConfig as plain numbers, for the patches that frames are tracked by."""
    return kernel_noise(config.noise, config.tracking.patch, pattern_of(config.tracking))


def kernel_noise(config: NoiseConfig, patch: int = PIXELS, pattern: int = COMPACT) -> Noise:
    """NoiseConfig as plain numbers, for points of so many pixels in a pattern."""
    shared = float(patch)
    return Noise(
        var_intensity=config.sigma_intensity**2,
        var_pixel=shared * config.sigma_pixel**2,
        var_depth=inverse_depth_sigma(config.focal_baseline, config.sigma_disparity) ** 2,
        shared=shared,
        c_h=config.c_h,
        huber=config.huber / config.sigma_intensity,
        outlier=config.outlier,
        use_depth=config.depth_residual,
        paper_variance=config.variance == "paper",
        gradient_blend=config.gradient_blend,
        coarse=config.coarse,
        pattern=pattern,
    )


def with_blur(noise: Noise, config: NoiseConfig, focal: float, turn: Array, turn_kf: Array) -> Noise:
    """The noise of a frame that turns (3,) rad/s against a keyframe that turned otherwise.

    Both images are smeared along their own motion; an edge smeared differently seems to lie elsewhere.
    """
    speed = focal * dist(turn, turn_kf) / RATE  # px a frame
    return noise._replace(var_pixel=noise.var_pixel + noise.shared * (config.blur * speed) ** 2)
