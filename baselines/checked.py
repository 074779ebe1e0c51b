"""What a method returns is checked against the images before anyone believes it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import torch
from torch import Tensor

from idrgbdo_torch.definitions.camera import backproject, project
from idrgbdo_torch.definitions.se3 import transform
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.odometry import Align, Alignment, Status
from idrgbdo_torch.text.configfile import dump

Raw = Callable[[RgbdFrame, RgbdFrame, Tensor], Tensor | str]  # as Align, but a bare (4, 4), or a sentence on failure


@dataclass(frozen=True)
class CheckConfig:
    """Set on real and rendered pairs: of motions off by 5 cm or 3 degrees nine of ten are not OK, of good ones 5 %."""

    step: int = 8  # px between the pixels that are looked at
    blur: int = 5  # px, side of the squares whose mean gray levels are compared
    pixels: int = 50  # of those looked at that must have a depth, in either image
    tolerance: float = 0.02  # 1/m, between two inverse depths of one surface
    overlap: float = 0.25  # share of the source's depths that must fall onto a depth of the target
    lost_depth: float = 0.35  # share of the overlap whose depths agree
    weak_depth: float = 0.85
    lost_gray: float = 0.5  # correlation of the gray levels in the overlap
    weak_gray: float = 0.9


CONFIG = CheckConfig()


@dataclass(frozen=True)
class Agreement:
    """How well a motion explains a pair of frames, each figure in 0..1 (gray: from -1)."""

    overlap: float  # share of the source's depths that fall onto a depth of the target
    depth: float  # share of those that are on the same surface
    gray: float  # correlation of their gray levels


def checked(raw: Raw) -> Align:
    """A pairwise method as an Align: LOST for images without depth, a failure, or a motion that the images deny."""

    def align(source: RgbdFrame, target: RgbdFrame, guess: Tensor) -> Alignment:
        identity = torch.eye(4, dtype=torch.float64)
        for name, frame in (("source", source), ("target", target)):
            if int((frame.depth[:: CONFIG.step, :: CONFIG.step] > 0).sum()) < CONFIG.pixels:
                return Alignment(identity, Status.LOST, f"the {name} image has hardly any valid depth")
        T_target_source = raw(source, target, guess)
        if isinstance(T_target_source, str):
            return Alignment(identity, Status.LOST, T_target_source)
        if not bool(torch.isfinite(T_target_source).all()):
            return Alignment(identity, Status.LOST, "the motion has a value that is not finite")
        status, reason = judge(source, target, T_target_source)
        return Alignment(identity if status is Status.LOST else T_target_source, status, reason)

    return align


def judge(source: RgbdFrame, target: RgbdFrame, T_target_source: Tensor) -> tuple[Status, str]:
    """Status and reason of a motion (4, 4) float64: does the source, moved, look like the target?"""
    found = agreement(source, target, T_target_source)
    if found.overlap < CONFIG.overlap:
        return Status.LOST, "the moved source hardly overlaps with the target"
    for status, depth, gray in (
        (Status.LOST, CONFIG.lost_depth, CONFIG.lost_gray),
        (Status.WEAK, CONFIG.weak_depth, CONFIG.weak_gray),
    ):
        if found.depth < depth:
            return status, f"fewer than {100 * depth:.0f} % of the depths agree after the motion"
        if found.gray < gray:
            return status, f"the gray levels correlate by less than {gray:g} after the motion"
    return Status.OK, ""


def agreement(source: RgbdFrame, target: RgbdFrame, T_target_source: Tensor) -> Agreement:
    """Compare depth and blurred gray levels of some of the source's pixels, moved, with the target's."""
    step, size = CONFIG.step, (target.camera.height, target.camera.width)
    v, u = (x.reshape(-1) for x in torch.meshgrid(*(torch.arange(step // 2, n, step) for n in size), indexing="ij"))
    depth = source.depth[v, u].double()
    u, v, depth = (x[depth > 0] for x in (u, v, depth))  # (N,)
    P = transform(T_target_source, backproject(source.camera, torch.stack([u, v], -1).double(), 1 / depth))  # (N, 3)
    uv, in_front = project(target.camera, P)
    a, b = uv.round().long().unbind(-1)
    seen = in_front & (a >= 0) & (a < size[1]) & (b >= 0) & (b < size[0])
    seen[seen.clone()] &= target.depth[b[seen], a[seen]] > 0
    if not bool(seen.any()):
        return Agreement(0.0, 0.0, 0.0)
    u, v, a, b = (x[seen] for x in (u, v, a, b))
    same = (1 / P[seen, 2] - 1 / target.depth[b, a].double()).abs() < CONFIG.tolerance
    grays = []
    for frame, column, row in ((source, u, v), (target, a, b)):
        gray = torch.from_numpy(cv2.blur(frame.gray.numpy(), (CONFIG.blur, CONFIG.blur)))[row, column]
        grays.append(gray - gray.mean())
    product = (grays[0] * grays[1]).sum() / (grays[0].norm() * grays[1].norm()).clamp(min=1e-6)
    return Agreement(float(seen.double().mean()), float(same.double().mean()), float(product))


def settings(*_: object) -> str:
    """All settings as TOML, whatever the method that is checked."""
    return dump(CONFIG)
