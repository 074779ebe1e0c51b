"""The one source of every default: frozen dataclasses, one per stage, in the paper's order.

Types such as Positive carry the range of a value; configfile.check() holds it against them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from .errors import IdRgbdoError
from .text import configfile
from .text.configfile import Bounds, Count, Fraction, Index, NonNegative, Positive

Mode = Literal["rand", "grid", "inf", "inf+grid"]
BackendName = Literal["fused", "torch"]
PRESETS = ("fast", "accurate", "paper")  # the files of configs/, which are installed beside this one


@dataclass(frozen=True)
class NoiseConfig:
    """What a residual is trusted with (Eqs. 5-8, 10)."""

    variance: Literal["first_order", "paper"] = "first_order"  # (g . dp/dd)^2, or the printed sum of squares
    sigma_intensity: Positive = 4.0  # gray levels, of one pixel (LSD-SLAM)
    sigma_pixel: NonNegative = 0.1  # px, position: calibration, blur, interpolation; shared by a patch
    blur: NonNegative = 0.05  # px of position noise a px by which the image speeds of frame and keyframe differ
    sigma_disparity: Positive = 0.1  # px, of the depth sensor
    focal_baseline: Positive = 40.0  # px m, f * b of Eq. 10 (Kinect)
    c_h: NonNegative = 1.0  # weight of the projective distortion, Eq. 7
    huber: Positive = 9.0  # gray levels, over sigma_intensity on the whitened residual (DSO)
    outlier: Positive = 3.0  # robust standard deviations of a point's residual
    depth_residual: bool = True  # beyond the paper: compare the warped with the measured depth
    coarse: Fraction = 1.0  # share of what level 1 says of a pose that counts on the finest level too
    gradient_blend: Fraction = 0.5  # share of the keyframe's gradient in the Jacobian, the rest is the frame's


@dataclass(frozen=True)
class SelectionConfig:
    """Which points are tracked (section 4.1)."""

    mode: Mode = "inf+grid"
    points: Annotated[int, Bounds(6)] = 24  # a pose has six degrees of freedom
    bits: Annotated[float, Bounds(high=0)] = 0.0  # wanted entropy, log2 of the worst deviation in m or rad; 0: any
    points_most: Count = 256  # of a pose that is less certain, which gets more points
    per_frame: bool = True  # choose anew when the view has moved by the margin, or only once a keyframe
    objective: Literal["bits", "paper"] = "bits"  # Eq. 18 in bits with a weighted spread, or as printed
    candidates: Count = 600  # kept per keyframe, but at least four times the points
    margin: NonNegative = (
        20.0  # px inside the image, at most 1/8 of its side; after such a move, points are chosen anew
    )
    spread: NonNegative = 0.25  # bits, weight of the second term of Eq. 18
    c_z: NonNegative = 25.0  # its sharpness: half weight at a fifth of the image radius
    distance: NonNegative = 6.0  # px between chosen points: overlapping patches measure the same thing


@dataclass(frozen=True)
class TrackingConfig:
    """How a frame is aligned to its keyframe (section 4.2)."""

    levels: Annotated[int, Bounds(1, 6)] = 4
    points_coarse: Count = 256  # on all levels but the finest
    patch: Annotated[int, Bounds(1, 8)] = 8  # pixels a point; 1 is the centre alone
    slant: bool = True  # patches of the finest level lie on the plane around their point, as wide as it, or are DSO's
    blur: NonNegative = 0.8  # px, of the finest level: a patch's few pixels then speak for their neighbours too
    sigma_velocity: Positive = 0.6  # m/s, change of velocity within 1/30 s: the motion prior, Eq. 19
    sigma_turn: Positive = 0.9  # rad/s, the same of the rotation


@dataclass(frozen=True)
class KeyframeConfig:
    """When a frame becomes a keyframe (section 5.1)."""

    criterion: Literal["bits", "ratio"] = "bits"  # log2(sigma / sigma_0), or Eq. 20 as printed
    threshold_bits: Positive = 0.42
    threshold_ratio: Positive = 0.04


@dataclass(frozen=True)
class WindowConfig:
    """The sliding window (section 5.2)."""

    enabled: bool = True
    keyframes: Annotated[int, Bounds(3, 64)] = 8
    points: Index = 144  # refined of each keyframe; 0: as many as selection.points
    first_estimates: bool = True  # geometric Jacobians of variables in the prior stay where they were first taken
    removal: Literal["view", "information", "oldest"] = "view"  # who tells the next view least; Eq. 26; the oldest


@dataclass(frozen=True)
class Config:
    """Everything that shapes a run of the odometry."""

    seed: Index = 0
    backend: BackendName = "fused"  # compiled loops, or their definitions in plain torch: the same poses, far slower
    noise: NoiseConfig = field(default_factory=NoiseConfig)
    selection: SelectionConfig = field(default_factory=SelectionConfig)
    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    keyframe: KeyframeConfig = field(default_factory=KeyframeConfig)
    window: WindowConfig = field(default_factory=WindowConfig)

    @property
    def candidates(self) -> int:
        """Candidates of a keyframe: enough to leave a choice."""
        return max(self.selection.candidates, 4 * self.selection.points)

    @property
    def window_points(self) -> int:
        """Points of a keyframe in the window."""
        return self.window.points or self.selection.points


def settings_file(name: Path) -> Path:
    """The TOML file of a name: the file itself, or one of PRESETS where there is no such file."""
    if str(name) not in PRESETS or name.is_file():
        return name
    here = Path(__file__).resolve().parent
    installed, cloned = (folder / "configs" / f"{name}.toml" for folder in (here, here.parent))
    return installed if installed.exists() else cloned


@dataclass(frozen=True)
class CameraSettings:
    """What a connected camera is asked for; None leaves it as it is. An OAK takes size and rate alone."""

    width: Count = 640  # px of both images, unless depth has its own
    height: Count = 480
    fps: Count = 30
    depth_width: Count | None = None
    depth_height: Count | None = None
    serial: str | None = None  # which of several cameras
    emitter: bool | None = None  # the infrared pattern
    exposure: Positive | None = None  # of colour, in the camera's unit (D400: 0.1 ms); ends automatic exposure
    gain: NonNegative | None = None  # of colour; ends automatic exposure


def checked(config: Config | None) -> Config:
    """The configuration, the defaults for None, with all numbers of the types said; IdRgbdoError for what is none."""
    if config is not None and not isinstance(config, Config):
        raise IdRgbdoError(f"config: expected a Config, got {type(config).__name__}; change fields of Config()")
    return configfile.check(Config() if config is None else config)
