"""What a pairwise method returns is checked against the images before anyone believes it."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from idrgbdo_torch.camera import backproject, project
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.odometry import Align, Alignment, Status
from idrgbdo_torch.se3 import transform

Raw = Callable[[RgbdFrame, RgbdFrame, Tensor], Tensor | str]  # as Align, but a bare (4, 4), or a sentence on failure

STEP = 8  # px between the pixels that are looked at
MIN_PIXELS = 50  # of them with a depth, in either image
MIN_OVERLAP = 0.25  # share of the source's depths that must fall onto a depth of the target
TOLERANCE = 0.05  # relative difference of two depths that are of one surface
MIN_FITNESS, WEAK_FITNESS = 0.5, 0.7  # share of the overlap that agrees


def checked(raw: Raw) -> Align:
    """A pairwise method as an Align: LOST for images without depth, a failure, or a motion that the depths deny."""

    def align(source: RgbdFrame, target: RgbdFrame, guess: Tensor) -> Alignment:
        identity = torch.eye(4, dtype=torch.float64)
        for name, frame in (("source", source), ("target", target)):
            if int((frame.depth[::STEP, ::STEP] > 0).sum()) < MIN_PIXELS:
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
    """Status and reason of a motion (4, 4) float64: do the source's depths, moved, agree with the target's?"""
    overlap, fitness = agreement(source, target, T_target_source)
    if overlap < MIN_OVERLAP:
        return Status.LOST, f"the moved source covers only {100 * overlap:.0f} % of its depths in the target"
    if fitness < MIN_FITNESS:
        return Status.LOST, f"only {100 * fitness:.0f} % of the overlapping depths agree after the motion"
    if fitness < WEAK_FITNESS:
        return Status.WEAK, f"only {100 * fitness:.0f} % of the overlapping depths agree after the motion"
    return Status.OK, ""


def agreement(source: RgbdFrame, target: RgbdFrame, T_target_source: Tensor) -> tuple[float, float]:
    """Share of the source's depths that fall onto a depth of the target, and share of those that agree with it."""
    rows = torch.arange(0, source.camera.height, STEP)
    columns = torch.arange(0, source.camera.width, STEP)
    v, u = torch.meshgrid(rows, columns, indexing="ij")
    depth = source.depth[v, u].double()
    u, v, depth = (x[depth > 0] for x in (u, v, depth))  # (N,)
    P = transform(T_target_source, backproject(source.camera, torch.stack([u, v], -1).double(), 1 / depth))  # (N, 3)
    uv, in_front = project(target.camera, P)
    u, v = uv.round().long().unbind(-1)
    seen = in_front & (u >= 0) & (u < target.camera.width) & (v >= 0) & (v < target.camera.height)
    measured = target.depth[v[seen], u[seen]].double()
    z = P[seen, 2][measured > 0]
    measured = measured[measured > 0]
    if len(z) == 0:
        return 0.0, 0.0
    return len(z) / len(depth), float(((z - measured).abs() < TOLERANCE * measured).double().mean())
