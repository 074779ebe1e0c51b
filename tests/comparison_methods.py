"""Methods for the tests of the comparison, in a module so that another process can import them."""

from __future__ import annotations

import os
import signal
from dataclasses import replace

import torch

from idrgbdo_torch.comparison.methods import Method
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.odometry import ConstantVelocity, Status, TrackResult


class Scripted(ConstantVelocity):
    """Walks along x at a speed that the seed sets, and does something at its third frame."""

    def __init__(self, speed: float, event: str) -> None:
        super().__init__(torch.tensor([speed, 0, 0, 0, 0, 0], dtype=torch.float64))
        self.event = event

    def track(self, frame: RgbdFrame) -> TrackResult:
        result = replace(super().track(frame), status=Status.OK, reason="")
        if len(self._times) != 3 or not self.event:
            return result
        if self.event == "raise":
            raise RuntimeError("the third frame was too much")
        if self.event == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        if self.event == "keyframe":
            reference = self._times[0]
            return replace(result, keyframe=True, reference_time=reference, T_ref_cam=result.T_world_cam)
        return replace(result, status=Status.LOST, reason="dark")


def walks(seed: int) -> Scripted:
    return Scripted(0.3 + 0.1 * seed, "")


def loses(seed: int) -> Scripted:
    return Scripted(0.3, "lose")


def keyframes(seed: int) -> Scripted:
    return Scripted(0.3, "keyframe")


def raises(seed: int) -> Scripted:
    return Scripted(0.3, "raise")


def killed(seed: int) -> Scripted:
    return Scripted(0.3, "kill")


def other_settings() -> str:
    return "speed = 2"


METHODS = {
    "walks": Method("walks on", walks, random=True),
    "loses": Method("loses its third frame", loses),
    "keyframes": Method("has a second keyframe", keyframes),
    "raises": Method("raises an exception", raises),
    "killed": Method("kills its process", killed),
}
