"""The one source of every default: frozen dataclasses, one per stage, in the paper's order."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

Mode = Literal["rand", "grid", "inf", "inf+grid"]


@dataclass(frozen=True)
class NoiseConfig:
    """What a residual is trusted with (Eqs. 5-8, 10)."""

    variance: Literal["first_order", "paper"] = "first_order"  # (g . dp/dd)^2, or the printed sum of squares
    sigma_intensity: float = 4.0  # gray levels, of one pixel
    sigma_pixel: float = 0.3  # px, position: calibration, blur, interpolation
    sigma_disparity: float = 0.16  # px, of the depth sensor
    focal_baseline: float = 40.0  # px m, f * b of Eq. 10
    c_h: float = 1.0  # weight of the projective distortion, Eq. 7
    huber: float = 9.0  # gray levels
    outlier: float = 3.0  # robust standard deviations of a point
    depth_residual: bool = True  # beyond the paper: compare the warped with the measured depth
    blend: float = 0.5  # share of the reference gradient in the Jacobian
    point_depth: float = 1.0  # sigma of a point's fitted inverse depth over that of one reading


@dataclass(frozen=True)
class SelectionConfig:
    """Which points are tracked (section 4.1)."""

    mode: Mode = "inf+grid"
    points: int = 24
    per_frame: bool = True  # choose anew for every frame among those the predicted pose sees, or once a keyframe
    candidates: int = 800  # kept per keyframe
    margin: float = 20.0  # px inside the image
    spread: float = 0.5  # bits, weight of the second term of Eq. 18
    distance: float = 6.0  # px between chosen points


@dataclass(frozen=True)
class TrackingConfig:
    """How a frame is aligned to its keyframe (section 4.2)."""

    levels: int = 4
    points_coarse: int = 256  # on all levels but the finest


@dataclass(frozen=True)
class KeyframeConfig:
    """When a frame becomes a keyframe (section 5.1)."""

    criterion: Literal["bits", "ratio"] = "bits"
    threshold: float = 1.0


@dataclass(frozen=True)
class WindowConfig:
    """The sliding window (section 5.2)."""

    enabled: bool = True
    keyframes: int = 8
    points: int = 24  # per keyframe


@dataclass(frozen=True)
class Config:
    """Everything that shapes a run of the odometry."""

    seed: int = 0
    noise: NoiseConfig = field(default_factory=NoiseConfig)
    selection: SelectionConfig = field(default_factory=SelectionConfig)
    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    keyframe: KeyframeConfig = field(default_factory=KeyframeConfig)
    window: WindowConfig = field(default_factory=WindowConfig)
