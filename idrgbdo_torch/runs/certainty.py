"""How certain a frame's pose in the world is, and how fast the camera moves: what frames.csv says beyond the record."""

from __future__ import annotations

from collections import deque

import numpy as np
import torch
from numpy.typing import NDArray

from ..definitions.se3 import adjoint, inverse, log
from ..odometry import Record, Status, TrackResult
from ..trajectory import quaternion_from_rotation

Array = NDArray[np.float64]

TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
POSE = ("x", "y", "z", "rx", "ry", "rz")
UPPER = [(row, column) for row in range(6) for column in range(row, 6)]
COLUMNS = (
    *(f"T_ref_cam_{name}" for name in ("tx", "ty", "tz", "qx", "qy", "qz", "qw")),
    *(f"covariance_{POSE[row]}_{POSE[column]}" for row, column in UPPER),
    *(f"velocity_{name}" for name in TWIST),
)


SHARE = 0.4  # of a keyframe's variance as tracked, that is left once the window measured it against others too
RECENT, BEFORE = 8, 4  # corrections by the window that count, and those of the expected size that a run begins with
UNMOVED = 1e-12  # a correction that is rounding
GROWTH = 1.5  # power of the corrections' mean by which variances grow; the three numbers: docs/covariance.md


class Certainty:
    """Follows a run frame by frame. A frame's error is its own against its keyframe, on top of the keyframe's.

    The two are taken for independent. The window measures a keyframe against several others, and so takes back a part
    of what its own measurement had wrong: SHARE is left. How far it moves a keyframe, in standard deviations, also says
    whether the measurements are as good as they claim: where they move too far, all variances grow.
    """

    def __init__(self) -> None:
        # by time (s), (6, 6) covariance of a left increment of T_cam_world: of keyframes, of what others were measured
        # against since the last, and of the newest frame
        self._known: dict[float, Array] = {}
        self._newest: float | None = None  # time (s) of the newest, which goes with the next unless that refers to it
        self._before: tuple[float, TrackResult] | None = None  # time (s) and result of the frame before
        self._keyframe: tuple[float, TrackResult] | None = None  # the same of the last keyframe
        self._corrections = deque([1.0] * BEFORE, maxlen=RECENT)  # squared, in variances; 1 is as expected

    def follow(self, record: Record) -> tuple[Array | None, Array | None]:
        """The next frame: (6, 6) covariance in the world as in_world has it, and (6,) velocity [v, w] of the camera in
        its own axes, m/s and rad/s. None where unknown.
        """
        covariance, velocity = self._covariance(record), self._velocity(record)
        self._before = record.timestamp, record.result
        return None if covariance is None else in_world(covariance, record.result.T_world_cam.numpy()), velocity

    def cells(self, record: Record) -> list[str]:
        """The cells of COLUMNS of the next frame, empty where there is no value."""
        result = record.result
        world, velocity = self.follow(record)
        measured: list[float] = []
        if result.T_ref_cam is not None:
            measured += result.T_ref_cam[:3, 3].tolist() + quaternion_from_rotation(result.T_ref_cam[:3, :3]).tolist()
        return [
            *([f"{number:.9f}" for number in measured] or [""] * 7),
            *("" if world is None else f"{world[row, column]:.9g}" for row, column in UPPER),
            *([""] * 6 if velocity is None else [f"{number:.9g}" for number in velocity]),
        ]

    def _covariance(self, record: Record) -> Array | None:
        """(6, 6) of a left increment [v, w] of T_cam_world; None where that is unknown."""
        result, reference = record.result, record.result.reference_time
        found: Array | None = None
        if self._before is None and result.status is not Status.LOST:
            found = np.zeros((6, 6))  # the world is where the first frame says
        elif reference in self._known and result.T_ref_cam is not None and result.information is not None:
            own = inverted(result.information.numpy())
            correction = self._correction(result)
            if correction > 0.0:
                self._corrections.append(correction)
            share = SHARE if correction > 0.0 else 1.0
            growth = max(1.0, sum(self._corrections) / len(self._corrections)) ** GROWTH
            Ad = adjoint(inverse(result.T_ref_cam)).numpy()
            found = None if own is None else share * growth * own + Ad @ self._known[reference] @ Ad.T
        if found is not None:
            if self._newest is not None and self._newest != reference:
                self._known.pop(self._newest, None)
            self._known[record.timestamp] = found
            self._newest = None if result.keyframe else record.timestamp
        if result.keyframe:
            self._keyframe = record.timestamp, result
        return found

    def _correction(self, result: TrackResult) -> float:
        """How far the window moved a new keyframe, squared and over the variance of its measurement; 0 where not."""
        if self._keyframe is None or not result.keyframe or result.T_ref_cam is None or result.information is None:
            return 0.0
        time, last = self._keyframe
        if time != result.reference_time or last.segment != result.segment:
            return 0.0
        moved = log(inverse(result.T_world_cam) @ last.T_world_cam @ result.T_ref_cam)
        correction = float(moved @ result.information @ moved) / 6.0
        return correction if correction > UNMOVED else 0.0

    def _velocity(self, record: Record) -> Array | None:
        """(6,) [v, w] of the camera in its own axes since the frame before, m/s and rad/s."""
        if self._before is None:
            return None
        time, before = self._before
        result, dt = record.result, record.timestamp - time
        if Status.LOST in (result.status, before.status) or result.segment != before.segment or dt <= 0:
            return None
        return np.asarray(log(inverse(before.T_world_cam) @ result.T_world_cam).numpy() / dt)


def inverted(information: Array) -> Array | None:
    """The covariance (6, 6) of an information matrix; None where a direction was not measured."""
    covariance, failed = torch.linalg.inv_ex(torch.from_numpy(information))
    if failed or not bool((covariance.diagonal() > 0).all()):
        return None
    return np.asarray(((covariance + covariance.mT) / 2).numpy())


def in_world(covariance: Array, T_world_cam: Array) -> Array:
    """The covariance (6, 6) of position and of rotation about the world's axes, [x, y, z, rx, ry, rz], m and rad.

    covariance: (6, 6) of a left increment xi = [v, w] of T_cam_world. T_world_cam exp(-xi) moves the camera by -R v and
    turns it by -R w about fixed axes, so both blocks turn with R.
    """
    J = np.kron(np.eye(2), -T_world_cam[:3, :3])
    return np.asarray(J @ covariance @ J.T)
