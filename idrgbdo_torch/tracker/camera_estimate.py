"""What a run says of the camera itself: its intrinsics, how its depth grows, and when its depth and its rows are taken.

Keyframes are looked at in pairs once more, and nothing of it goes back into the poses. docs/method.md says which of the
camera's numbers can be seen at all, and in what motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..definitions.camera import Pinhole
from ..definitions.growing import Column
from ..frame import Keyframe
from ..kernels.se3 import inverse
from ..odometry import Record, Status
from .camera_equations import UNKNOWNS, Moving, pair_says
from .inspection import Shown
from .motion import twist_between

Array = NDArray[np.float64]

PRIOR, MODEL, LINEAR = np.array(
    [  # a row each of UNKNOWNS, in their units
        [0.05, 6e-4, 0.0],  # standard deviation of what is said of a camera;
        [20.0, 0.2, 0.0],  # what is left without noise in an image of WIDTH, measured on films;
        [20.0, 0.2, 0.0],  # share of a number that is off where it is large, as flow is not constant in time
        [0.05, 8e-4, 0.0],
        [0.05, 3e-4, 0.1],
        [0.03, 2e-4, 0.1],
        [10.0, 0.2, 0.0],
        [10.0, 0.2, 0.0],
        [0.03, 5e-4, 0.1],
    ]
).T
IN_PIXELS = np.array([name.startswith(("center", "shift")) for name in UNKNOWNS])
WIDTH = 640.0  # px
TELLS = 1.0 / 3.0  # of a prior deviation: with a larger one a number is not seen
FEWEST_PAIRS = 4
SURELY = 3.0  # standard deviations by which a number departs from what is said
LONGEST_S = 0.25  # from the frame before a keyframe to the one after, or its velocity is not known


@dataclass(frozen=True)
class Estimated:
    """One number of the camera."""

    value: float
    sigma: float
    is_seen: bool  # the motion let it be seen; else the value is hardly more than what the camera is said to be


class Word(NamedTuple):
    """How a number is said, and the least departure from what is stated that matters."""

    key: str
    name: str
    text: str
    size: float
    zero: float
    matters: float  # a smaller one costs less than the noise of a pose

    def of(self, x: Estimated) -> str:
        """The number with its deviation."""
        return self.text.format(self.size * (x.value - self.zero), self.size * x.sigma)


WORDS = (
    Word("focal", "focal length", "focal length {:+.1f} +- {:.1f} %", 100.0, 1.0, 0.005),
    Word("cx", "centre to the right", "centre {:+.1f} +- {:.1f} px to the right", 1.0, 0.0, 3.0),
    Word("cy", "centre down", "centre {:+.1f} +- {:.1f} px down", 1.0, 0.0, 3.0),
    Word("depth_growth", "depth growth", "depth {:+.1f} +- {:.1f} % a metre", 100.0, 0.0, 0.005),
    Word("depth_delay_ms", "depth delay", "depth {:+.0f} +- {:.0f} ms late", 1.0, 0.0, 4.0),
    Word("readout_ms", "readout", "readout {:.0f} +- {:.0f} ms", 1.0, 0.0, 5.0),
    Word("depth_right", "depth's place", "depth {:+.1f} +- {:.1f} px too far right", 1.0, 0.0, 1.5),
    Word("depth_down", "depth's height", "depth {:+.1f} +- {:.1f} px too low", 1.0, 0.0, 1.5),
    Word("depth_readout", "depth's readout", "depth readout {:.0f} +- {:.0f} ms", 1.0, 0.0, 10.0),
)


@dataclass(frozen=True)
class CameraEstimate:
    """A camera as its images show it, and how surely. All of it at once, so that none hides in another."""

    pairs: int  # of keyframes
    focal_factor: Estimated  # on the stated fx and fy
    center_u_px: Estimated  # added to the stated principal point
    center_v_px: Estimated
    depth_growth: Estimated  # 1/m: true depth = depth * (1 + growth * depth), on top of what reading it applied
    depth_delay_ms: Estimated  # absolute, as in camera.toml
    readout_ms: Estimated
    depth_right_px: Estimated  # by which it is registered too far to the right of colour
    depth_down_px: Estimated
    depth_readout_ms: Estimated  # of the depth camera, which camera.toml does not know

    def in_words(self) -> tuple[list[str], list[str]]:
        """What was seen, with deviations, and the names of what was not."""
        numbers = list(zip(self.numbers(), WORDS, strict=True))
        seen = [word.of(x) for x, word in numbers if x.is_seen]
        return seen, [word.name for x, word in numbers if not x.is_seen]

    def departures(self, camera: Pinhole) -> dict[str, str]:
        """What surely differs from the camera as it is said to be, by the name of its number, in words."""
        stated = (1.0, 0.0, 0.0, 0.0, camera.depth_delay_ms, camera.readout_ms, 0.0, 0.0, 0.0)
        found = {}
        for x, said, word in zip(self.numbers(), stated, WORDS, strict=True):
            if x.is_seen and abs(x.value - said) > max(word.matters, SURELY * x.sigma):
                found[word.key] = word.of(x)
        return found

    def numbers(self) -> list[Estimated]:
        """In the order of UNKNOWNS."""
        return [x for x in vars(self).values() if isinstance(x, Estimated)]

    def as_dict(self) -> dict[str, Any]:
        """What summary.json has."""
        numbers = {name: value for name, value in vars(self).items() if isinstance(value, Estimated)}
        each = {name: {"value": x.value, "sigma": x.sigma, "seen": x.is_seen} for name, x in numbers.items()}
        return {"pairs": self.pairs, **each}


@dataclass(frozen=True)
class Waiting:
    """A keyframe whose velocity shows with the next frame."""

    keyframe: Keyframe
    before_s: float  # of the frame before, or of its own where that has no good pose
    T_before: Array  # (4, 4) T_cam_world of it
    T_kf_world: Array
    T_previous_world: Array | None  # (4, 4) of the keyframe before, in the same window


@dataclass
class CameraEstimator:
    """Collects what pairs of neighbouring keyframes say of the camera."""

    sparing: bool = True  # no keyframe is in two pairs; else each makes one with the next, for twice the time
    information: Column = field(default_factory=lambda: Column("float64", (9, 9)))
    vector: Column = field(default_factory=lambda: Column("float64", (9,)))
    last_s: float | None = None  # the last frame, where its pose is good
    T_last: Array = field(default_factory=lambda: np.eye(4))
    waiting: Waiting | None = None
    host: Moving | None = None  # the first keyframe of a pair to come
    segment: int = 0  # in whose world the poses are

    def look(self, record: Record, odometry: object) -> None:
        """At a frame that has just been tracked."""
        if not isinstance(odometry, Shown):
            return
        if record.result.segment != self.segment:
            self.waiting, self.host, self.last_s, self.segment = None, None, None, record.result.segment
        good = record.result.status is Status.OK  # the first frame of all, too
        T_cam_world = inverse(record.result.T_world_cam.numpy())
        if self.waiting is not None and good:
            self._pair(self.waiting, record.timestamp, T_cam_world, odometry)
        elif self.waiting is not None or not good:
            self.host = None
        self.waiting = None
        if good and record.result.keyframe:
            *earlier, (keyframe, T_kf_world) = odometry.window_keyframes().values()
            if keyframe.frame.timestamp == record.timestamp and not keyframe.intruded:
                previous = earlier[-1] if earlier else None
                known = previous and self.host and previous[0].frame is self.host.keyframe.frame
                T_previous_world = previous[1].copy() if previous and known else None
                before_s, T_before = record.timestamp, T_cam_world
                if self.last_s is not None:
                    before_s, T_before = self.last_s, self.T_last
                self.waiting = Waiting(keyframe, before_s, T_before, T_kf_world.copy(), T_previous_world)
        self.last_s, self.T_last = record.timestamp if good else None, T_cam_world

    def _pair(self, waiting: Waiting, after_s: float, T_after: Array, odometry: Shown) -> None:
        """Take up a keyframe, now that the frame after it is known: as the first of a pair, or as its second."""
        dt = after_s - waiting.before_s
        if not 0.0 < dt < LONGEST_S:
            self.host = None
            return
        moving = Moving(waiting.keyframe, twist_between(T_after, waiting.T_before, dt))
        if self.host is None or waiting.T_previous_world is None:
            self.host = moving
            return
        T = waiting.T_kf_world @ inverse(waiting.T_previous_world)
        says = pair_says(self.host, moving, T, odometry.noise, odometry.backend)
        self.host = None if self.sparing else moving
        if says is not None:
            self.information.append(says.information)
            self.vector.append(says.vector)

    def estimate(self, camera: Pinhole) -> CameraEstimate | None:
        """The camera, given what it was said to be; None where there are too few pairs to tell anything."""
        return estimated(self.information.array(), self.vector.array(), camera)


def estimated(information: Array, vectors: Array, camera: Pinhole) -> CameraEstimate | None:
    """The camera from what n pairs say, information (n, 9, 9) and vectors (n, 9); None where they are too few.

    The deviations are not those that the information has: points of a pair share errors of depth, blur and
    interpolation. They follow from how much the pairs disagree (the sandwich estimator, with the variance of Student's
    t for so few), and hold what is wrong with the model even without noise.
    """
    n = len(vectors)
    if n < FEWEST_PAIRS:
        return None
    prior, model = np.diag(1.0 / PRIOR**2), MODEL * np.where(IN_PIXELS, 1.0, WIDTH / camera.width)
    covariance = np.linalg.inv(information.sum(0) + prior)
    x = covariance @ vectors.sum(0)
    left = vectors - information @ x  # (n, 9) what each pair would still change
    scatter = covariance @ (left.T @ left * (n / (n - 3.0)) + prior) @ covariance
    variance = np.maximum(np.diag(covariance), np.diag(scatter)) + model**2 + (LINEAR * x) ** 2
    return camera_of(x, np.sqrt(variance), n, camera)


def camera_of(x: Array, sigma: Array, pairs: int, camera: Pinhole) -> CameraEstimate:
    """Numbers in units and names for users."""
    focal, u, v, growth, delay, readout, right, down, rows = (
        Estimated(float(value), float(spread), bool(spread < TELLS * before))
        for value, spread, before in zip(x, sigma, PRIOR, strict=True)
    )
    factor = float(np.exp(focal.value))
    return CameraEstimate(
        pairs=pairs,
        focal_factor=Estimated(factor, factor * focal.sigma, focal.is_seen),
        center_u_px=u,
        center_v_px=v,
        depth_growth=growth,
        depth_delay_ms=in_ms(delay, camera.depth_delay_ms),
        readout_ms=in_ms(readout, camera.readout_ms),
        depth_right_px=right,
        depth_down_px=down,
        depth_readout_ms=in_ms(rows, 0.0),
    )


def in_ms(rest: Estimated, stated_ms: float) -> Estimated:
    """A time in s beyond what is said of it, as a whole."""
    return Estimated(stated_ms + 1e3 * rest.value, 1e3 * rest.sigma, rest.is_seen)


def together(estimators: Sequence[CameraEstimator], camera: Pinhole) -> CameraEstimate | None:
    """The camera from several runs with it."""
    information = np.concatenate([one.information.array() for one in estimators])
    return estimated(information, np.concatenate([one.vector.array() for one in estimators]), camera)
