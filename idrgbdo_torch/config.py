"""The one source of every default: frozen dataclasses, one per stage, in the paper's order.

Types such as Positive carry the range of a value; configfile.check() holds it against them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from .configfile import Bounds, Count, Fraction, Index, NonNegative, Positive

Mode = Literal["rand", "grid", "inf", "inf+grid"]


@dataclass(frozen=True)
class NoiseConfig:
    """What a residual is trusted with (Eqs. 5-8, 10)."""

    variance: Literal["first_order", "paper"] = "first_order"  # (g . dp/dd)^2, or the printed sum of squares
    sigma_intensity: Positive = 4.0  # gray levels, of one pixel
    sigma_pixel: NonNegative = 0.3  # px, position: calibration, blur, interpolation
    sigma_disparity: Positive = 0.16  # px, of the depth sensor
    focal_baseline: Positive = 40.0  # px m, f * b of Eq. 10
    c_h: NonNegative = 1.0  # weight of the projective distortion, Eq. 7
    huber: Positive = 9.0  # gray levels
    outlier: Positive = 3.0  # robust standard deviations of a point
    depth_residual: bool = True  # beyond the paper: compare the warped with the measured depth
    blend: Fraction = 0.5  # share of the reference gradient in the Jacobian
    point_depth: NonNegative = 1.0  # sigma of a point's fitted inverse depth over that of one reading


@dataclass(frozen=True)
class SelectionConfig:
    """Which points are tracked (section 4.1)."""

    mode: Mode = "inf+grid"
    points: Count = 24
    per_frame: bool = True  # choose anew for every frame among those the predicted pose sees, or once a keyframe
    candidates: Count = 800  # kept per keyframe
    margin: NonNegative = 20.0  # px inside the image
    spread: NonNegative = 0.5  # bits, weight of the second term of Eq. 18
    distance: NonNegative = 6.0  # px between chosen points


@dataclass(frozen=True)
class TrackingConfig:
    """How a frame is aligned to its keyframe (section 4.2)."""

    levels: Annotated[int, Bounds(1, 8)] = 4
    points_coarse: Count = 256  # on all levels but the finest


@dataclass(frozen=True)
class KeyframeConfig:
    """When a frame becomes a keyframe (section 5.1)."""

    criterion: Literal["bits", "ratio"] = "bits"
    threshold: Positive = 1.0


@dataclass(frozen=True)
class WindowConfig:
    """The sliding window (section 5.2)."""

    enabled: bool = True
    keyframes: Count = 8
    points: Count = 24  # per keyframe
    first_estimates: bool = True  # geometric Jacobians of variables in the prior stay where they were first taken
    removal: Literal["information", "oldest"] = "information"  # Eq. 26, or first in first out


@dataclass(frozen=True)
class Config:
    """Everything that shapes a run of the odometry."""

    seed: Index = 0
    noise: NoiseConfig = field(default_factory=NoiseConfig)
    selection: SelectionConfig = field(default_factory=SelectionConfig)
    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    keyframe: KeyframeConfig = field(default_factory=KeyframeConfig)
    window: WindowConfig = field(default_factory=WindowConfig)
