"""What is rendered and with which sensor: plain values, importable without torch or Open3D."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from ..errors import IdRgbdoError
from ..text import configfile
from ..text.configfile import Fraction, NonNegative

Kind = Literal["desk", "structure_texture", "structure_notexture", "nostructure_texture", "poor"]
KINDS: tuple[Kind, ...] = ("desk", "structure_texture", "structure_notexture", "nostructure_texture", "poor")


@dataclass(frozen=True)
class SensorConfig:
    """A hand-held Kinect of the first generation; every part can be switched off."""

    color_noise: bool = True  # shot and read noise
    exposure_drift: bool = True  # slow change of gain
    motion_blur: bool = True
    depth_noise: bool = True  # of the disparity
    depth_quantisation: bool = True
    depth_holes: bool = True  # occlusion shadow, ragged edges, grazing angles
    depth_range: bool = True
    noise_gray: float = 2.2  # gray levels of each channel at mid gray
    drift: float = 0.1  # largest relative change of gain
    exposure_s: float = 0.009
    focal_baseline: float = 40.0  # px m, f * b of the depth sensor
    sigma_disparity: float = 0.12  # px
    disparity_step: float = 0.125  # px
    range_min_m: float = 0.5
    range_max_m: float = 4.5

    @staticmethod
    def ideal() -> SensorConfig:
        """No noise, no blur, no holes: depth is exact up to the 16-bit file's step of 0.2 mm."""
        return SensorConfig(
            color_noise=False,
            exposure_drift=False,
            motion_blur=False,
            depth_noise=False,
            depth_quantisation=False,
            depth_holes=False,
            depth_range=False,
        )


@dataclass(frozen=True)
class FaultConfig:
    """What real cameras do and files about them leave out; without any of it by default, each by its size."""

    readout_ms: NonNegative = 0.0  # rolling shutter: from the first to the last row of a colour image
    depth_delay_ms: float = 0.0  # by which the depth image is taken later than the colour image
    focal: float = 0.0  # relative error of the focal length in the calibration
    center_px: float = 0.0  # error of the principal point there, to the lower right
    depth_scale: float = 0.0  # relative error of all depths
    depth_growth: float = 0.0  # 1/m: true depth = measured * (1 + growth * measured)
    misregistration_px: int = 0  # px by which the depth image lies too far right
    exposure_jump: Fraction = 0.0  # relative changes of gain from one frame to the next, every 0.5 s
    stereo: NonNegative = 0.0  # depth of a stereo sensor with holes and speckle; 1: like a RealSense D435's
    tof: NonNegative = 0.0  # depth of a time-of-flight sensor; 1: like a LiDAR's or an Azure Kinect's
    named: bool = False  # the camera file tells what a user can know: all but the exposure and the kind of sensor


@dataclass(frozen=True)
class SynthConfig:
    """A rendered sequence: the scene, the path through it, the camera and its sensor."""

    kind: Kind = "desk"
    trajectory: Path | None = None  # TUM text, camera to world; None films along a built-in hand-held path
    start: float = 0.0  # s after the trajectory's first pose
    frames: int = 240
    seed: int = 0
    rate: float = 30.0  # frames per second
    width: int = 640
    height: int = 480
    fx: float = 525.0
    fy: float = 525.0
    cx: float = 319.5
    cy: float = 239.5
    samples: int = 4  # images averaged per frame, for anti-aliasing and motion blur; more are taken in fast motion
    threads: int = 1  # of the ray caster
    sensor: SensorConfig = field(default_factory=SensorConfig)
    faults: FaultConfig = field(default_factory=FaultConfig)

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise IdRgbdoError(f"kind: expected one of {', '.join(KINDS)}, got '{self.kind}'; choose one of them")
        for name in ("frames", "width", "height", "samples", "threads", "rate", "fx", "fy"):
            value = getattr(self, name)
            if not value > 0:
                raise IdRgbdoError(f"{name}: expected a positive number, got {value}; give a larger one")
        configfile.check(self.faults)
        if self.faults.stereo and self.faults.tof:
            raise IdRgbdoError("faults: expected a stereo or a time-of-flight sensor, got both; set one of them to 0")
