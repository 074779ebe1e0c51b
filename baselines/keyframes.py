"""What our own baselines share: frame to keyframe, constant velocity, a second try, and an honest end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import torch
from torch import Tensor

from idrgbdo_torch.definitions.se3 import exp, inverse, log
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.odometry import Status, TrackResult, poses_to_trajectory
from idrgbdo_torch.trajectory import Trajectory

from .checked import judge

P = TypeVar("P")  # what a front makes of a frame


@dataclass(frozen=True)
class Keyframe(Generic[P]):
    """A frame with its final pose."""

    frame: RgbdFrame
    data: P
    T_world_cam: Tensor  # (4, 4) float64


@dataclass(frozen=True)
class Fit:
    """The pose of a frame against the keyframes."""

    T_cam_world: Tensor  # (4, 4) float64
    reason: str = ""  # why it failed; empty when it did not
    information: Tensor | None = None  # (6, 6) float64 of a left increment
    points: int = 0
    iterations: int = 0
    share: float = 1.0  # of the newest keyframe's points that were still of use


class Front(Protocol[P]):
    """The part in which the families differ."""

    def prepare(self, frame: RgbdFrame) -> P | str:
        """What is needed of a frame, or a sentence where it offers nothing."""

    def fit(self, keyframes: Sequence[Keyframe[P]], current: P, guess: Tensor) -> Fit:
        """The pose of a prepared frame, from a guess of T_cam_world (4, 4)."""


@dataclass(frozen=True)
class KeyframeRule:
    """When a frame becomes a keyframe: far from the newest one, or with little left of it. And how many are kept."""

    distance: float = 0.1  # m
    angle: float = 0.15  # rad
    share: float = 0.5  # of its points still of use
    keep: int = 1


class KeyframeOdometry(Generic[P]):
    """An Odometry made of a front. After two lost frames in a row a new segment starts at the pose that was held."""

    def __init__(self, front: Front[P], name: str, rule: KeyframeRule) -> None:
        self.name = name
        self._front = front
        self._rule = rule
        self.reset()

    def reset(self, T_world_cam: Tensor | None = None) -> None:
        """Forget everything; the next frame gets the pose T_world_cam (identity by default)."""
        self._pose = torch.eye(4, dtype=torch.float64) if T_world_cam is None else T_world_cam.double()
        self._velocity = torch.zeros(6, dtype=torch.float64)  # of the camera in its own axes, m/s and rad/s
        self._keyframes: list[Keyframe[P]] = []
        self._lost, self._segment = False, 0
        self._times: list[float] = []
        self._poses: list[Tensor] = []

    def trajectory(self) -> Trajectory:
        """All poses so far."""
        return poses_to_trajectory(self._times, self._poses)

    def track(self, frame: RgbdFrame) -> TrackResult:
        """The pose of a frame against the keyframes; LOST with a reason, at the pose before, where that fails."""
        data = self._front.prepare(frame)
        if isinstance(data, str):
            result = self._miss(data)
        elif not self._keyframes:
            self._keyframes = [Keyframe(frame, data, self._pose)]
            result = TrackResult(self._pose, Status.OK, keyframe=True, segment=self._segment)
        else:
            result = self._against_keyframes(frame, data)
        self._times.append(frame.timestamp)
        self._poses.append(result.T_world_cam)
        return result

    def _against_keyframes(self, frame: RgbdFrame, data: P) -> TrackResult:
        newest = self._keyframes[-1]
        dt = frame.timestamp - self._times[-1]
        reason = ""
        for guess in (self._pose @ exp(self._velocity * dt), self._pose):
            fit = self._front.fit(self._keyframes, data, inverse(guess))
            T_cam_kf = fit.T_cam_world @ newest.T_world_cam
            status, reason = (Status.LOST, fit.reason) if fit.reason else judge(newest.frame, frame, T_cam_kf)
            if status is not Status.LOST:
                return self._accept(frame, data, fit, status, reason)
        return self._restart(frame, data, reason) if self._lost else self._miss(reason)

    def _accept(self, frame: RgbdFrame, data: P, fit: Fit, status: Status, reason: str) -> TrackResult:
        newest, rule = self._keyframes[-1], self._rule
        # through log and exp, since rounding errors of chained products would grow exponentially otherwise
        pose = exp(log(inverse(fit.T_cam_world)))
        T_kf_cam = inverse(newest.T_world_cam) @ pose
        moved = log(T_kf_cam)
        result = TrackResult(
            pose, status, reason, newest.frame.timestamp, T_kf_cam, fit.information,
            points=fit.points, iterations=fit.iterations, segment=self._segment,
        )  # fmt: skip
        self._velocity = log(inverse(self._pose) @ pose) / (frame.timestamp - self._times[-1])
        self._pose, self._lost = pose, False
        if moved[:3].norm() > rule.distance or moved[3:].norm() > rule.angle or fit.share < rule.share:
            self._keyframes = [*self._keyframes, Keyframe(frame, data, pose)][-rule.keep :]
            result = replace(result, keyframe=True)
        return result

    def _miss(self, reason: str) -> TrackResult:
        self._velocity = torch.zeros(6, dtype=torch.float64)
        self._lost = True
        return TrackResult(self._pose, Status.LOST, reason, segment=self._segment)

    def _restart(self, frame: RgbdFrame, data: P, reason: str) -> TrackResult:
        result = self._miss(reason)
        self._segment += 1
        self._keyframes, self._lost = [Keyframe(frame, data, self._pose)], False
        return result
