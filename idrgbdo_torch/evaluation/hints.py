"""What looks wrong with an estimate and its reference, each suspicion tried out on the poses before it is said."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ..definitions.se3 import inverse
from ..text.clock import doubtful_seconds
from ..trajectory import Trajectory, align, associate, quaternion_from_rotation, rotation_from_quaternion
from .absolute import ASSOCIATION_LIMIT_S, FEWEST, distances
from .offset import clock_offset
from .relative import angle, without_orientation

FEW = 0.1  # of the poses of the shorter match those of the other
MOST_MET = 0.5  # of the poses, whose times are numbers of frames, match those of the other by chance
CLEARLY = 0.3  # of the error is left where a suspicion is right
LEAST_OFFSET_S = 0.01
OFFSET_GAIN = 0.7  # of the ATE is left at the right offset; drift stays
LEAST_SCALE = 0.03  # an odometry's own error of scale is smaller
LEAST_TURN = math.radians(3)
LEAST_ARM_M = 0.02
LEAST_WAY_M = 0.02
UNITS = {1000.0: "millimetres", 100.0: "centimetres", 1 / 0.3048: "feet", 1 / 0.0254: "inches"}  # per metre


def hints(
    estimate: Trajectory, reference: Trajectory, max_difference_s: float = ASSOCIATION_LIMIT_S
) -> tuple[str, ...]:
    """Sentences on what a reader of the errors should know: how the files were read, and what the poses show.

    Looked for are numbers of frames in place of times, quaternions in the order w x y z, inverted poses, another unit
    of length, an offset between the clocks, a reference of another frame on the same body, and few common times. Only
    the first that is found is said, since each hides the others. Never raises.
    """
    notes = (*estimate.notes, *reference.notes)
    if min(len(estimate), len(reference)) < FEWEST:
        return notes
    of_estimate, of_reference = associate(estimate.timestamps, reference.timestamps, max_difference_s)
    matched = len(of_estimate)
    if counted := _counted(estimate, reference, matched):
        return (*notes, counted)
    if matched < FEWEST:
        return notes + _other_clock(estimate, reference)
    found = _of_pairs(estimate.T_world_cam[of_estimate], reference.T_world_cam[of_reference])
    if not found:
        found = _offset(estimate, reference)
    if not found and not without_orientation(estimate, reference):
        found = _other_body(estimate.T_world_cam[of_estimate], reference.T_world_cam[of_reference])
    if not found and matched < FEW * min(len(estimate), len(reference)):
        found = (
            f"only {matched} of {len(estimate)} estimated and {len(reference)} reference poses are within "
            f"{max_difference_s:g} s of each other, and the errors are those of these alone; check that both files are "
            "of one recording and by one clock, or raise --association-limit"
        )
    return notes + ((found,) if found else ())


def _counted(estimate: Trajectory, reference: Trajectory, matched: int) -> str:
    """Times of one that look like numbers of frames, or milliseconds, where the other's don't and most match none."""
    times = {"estimate": estimate.timestamps.tolist(), "reference": reference.timestamps.tolist()}
    doubts = {name: doubt for name, of_one in times.items() if (doubt := doubtful_seconds(of_one))}
    if len(doubts) != 1:
        return ""
    ((name, (gap, guess)),) = doubts.items()
    if matched > MOST_MET * len(times[name]):
        return ""
    return (
        f"the times of the {name} are whole numbers {gap:g} apart and are taken as seconds, of which {matched} of "
        f"{len(times[name])} match the other's; if they are {guess}, write seconds"
    )


def _of_pairs(P: Tensor, Q: Tensor) -> str:
    """What (N, 4, 4) matched poses of the estimate and the reference show; nothing where they fit."""
    for suspicion in (_order, _inverted, _unit):
        if found := suspicion(P, Q):
            return found
    return ""


def _order(P: Tensor, Q: Tensor) -> str:
    """Quaternions written as w x y z."""
    before = _turn_error(P, Q)
    if before < LEAST_TURN:
        return _order_by_way(P, Q)
    after = {"estimate": _turn_error(_reordered(P), Q), "reference": _turn_error(P, _reordered(Q))}
    name = min(after, key=lambda name: after[name])
    if after[name] > CLEARLY * before:
        return ""
    return (
        f"the quaternions of the {name} look like w x y z (rotations then differ by {math.degrees(after[name]):.2f} "
        f"instead of {math.degrees(before):.1f} degrees); write them as x y z w"
    )


def _order_by_way(P: Tensor, Q: Tensor) -> str:
    """The same where the order shows in the way alone: turns about the camera's y axis stay as they are without it."""
    before = _way_error(P, Q)
    if before < LEAST_WAY_M or _still(P, Q):
        return ""
    pairs = {"estimate": (_reordered(P), Q), "reference": (P, _reordered(Q))}
    after = {name: _way_error(*pair) for name, pair in pairs.items() if _turn_error(*pair) < LEAST_TURN}
    name = min(after, key=lambda name: after[name], default="")
    if not name or after[name] > CLEARLY * before:
        return ""
    return (
        f"the quaternions of the {name} look like w x y z (ways as the camera sees them then differ by "
        f"{after[name]:.4f} instead of {before:.4f} m); write them as x y z w"
    )


def _inverted(P: Tensor, Q: Tensor) -> str:
    """Poses that map the world into the camera."""
    before = _ate(P, Q)
    after = {"estimate": _ate(inverse(P), Q), "reference": _ate(P, inverse(Q))}
    name = min(after, key=lambda name: after[name])
    if after[name] > CLEARLY * before or _still(P, Q):
        return ""
    either = max(after.values()) <= CLEARLY * before
    return (
        f"the poses of the {'estimate or of the reference' if either else name} look inverted, world to camera "
        f"(ATE {after[name]:.4f} instead of {before:.4f} m when inverted); write camera to world"
    )


def _unit(P: Tensor, Q: Tensor) -> str:
    """Positions of which one is a multiple of the other."""
    source, target = P[:, :3, 3], Q[:, :3, 3]
    centred = source - source.mean(0), target - target.mean(0)
    R = align(source, target)[:3, :3]
    scale = float((centred[1] * (centred[0] @ R.T)).sum() / centred[0].square().sum().clamp(min=1e-30))
    if not scale > 0 or abs(math.log(scale)) < LEAST_SCALE:
        return ""
    before, after = _ate(P, Q), float((scale * (centred[0] @ R.T) - centred[1]).square().sum(1).mean().sqrt())
    larger, factor = ("reference", scale) if scale > 1 else ("estimate", 1 / scale)
    in_metres = 1.0 if larger == "estimate" else scale
    if after > CLEARLY * before:
        return ""
    for per_metre, name in UNITS.items():
        if abs(factor / per_metre - 1) < 0.05:
            return (
                f"the positions of the {larger} look like {name} (ATE {after / in_metres:.4f} m then); "
                "write them in metres"
            )
    return (
        f"the positions of the {larger} are {factor:.3f} times those of the other (ATE {after / in_metres:.4f} "
        "instead of "
        f"{before:.4f} m with that scale); check the unit, and the depth scale and focal length it was tracked with"
    )


def _offset(estimate: Trajectory, reference: Trajectory) -> str:
    """Clocks that overlap but are apart."""
    found = clock_offset(estimate, reference)
    if found is None or found.ate_before_m is None or abs(found.seconds) < LEAST_OFFSET_S:
        return ""
    if found.ate_m > OFFSET_GAIN * found.ate_before_m:
        return ""
    return (
        f"the two clocks look {abs(found.seconds):.3f} s apart: with {found.seconds:+.3f} s on the timestamps of the "
        f"reference ATE is {found.ate_m:.4f} instead of {found.ate_before_m:.4f} m"
    )


def _other_clock(estimate: Trajectory, reference: Trajectory) -> tuple[str, ...]:
    """Clocks that do not meet at all."""
    found = clock_offset(estimate, reference)
    spread = float((estimate.positions - estimate.positions.mean(0)).square().sum(1).mean().sqrt())
    if found is None or found.ate_m > CLEARLY * spread or abs(found.seconds) < LEAST_OFFSET_S:
        return ()
    return (
        f"the same motion seems to be in both: with {found.seconds:+.3f} s on the timestamps of the reference "
        f"ATE is {found.ate_m:.4f} m",
    )


def _other_body(P: Tensor, Q: Tensor) -> str:
    """A reference of another frame that is fixed to the camera: P X = X Q for all relative motions."""
    p, q = _motions(P), _motions(Q)
    a, b = _rotation_vectors(p), _rotation_vectors(q)  # (M, 3)
    size = float(a.square().sum(1).mean().sqrt())
    if size < LEAST_TURN:
        return ""
    U, _, Vh = torch.linalg.svd(a.T @ b)
    sign = torch.ones(3, dtype=a.dtype)
    sign[2] = torch.linalg.det(U) * torch.linalg.det(Vh)
    R = U @ torch.diag(sign) @ Vh  # a = R b
    left, before = (float((a - b @ X.T).square().sum(1).mean().sqrt()) for X in (R, torch.eye(3, dtype=a.dtype)))
    turned = float(angle(R[None])[0])
    if left > CLEARLY * size or (turned > LEAST_TURN and left > CLEARLY * before):
        return ""
    A = (p[:, :3, :3] - torch.eye(3, dtype=a.dtype)).reshape(-1, 3)
    moved = q[:, :3, 3] @ R.T - p[:, :3, 3]  # (M, 3) what a lever arm explains
    arm = torch.linalg.lstsq(A, moved.reshape(-1, 1)).solution
    unexplained = float((A @ arm - moved.reshape(-1, 1)).square().mean().sqrt())
    offset_m = float(arm.norm())
    explained = offset_m > LEAST_ARM_M and unexplained < CLEARLY * float(moved.square().mean().sqrt())
    if turned < LEAST_TURN and not explained:
        return ""
    where = f" and {offset_m:.3f} m beside it" if explained else ""
    return (
        f"the reference looks like another frame on the same body, turned by {math.degrees(turned):.0f} degrees "
        f"against the camera{where}; errors contain that until it is brought to the camera's frame"
    )


def _motions(T: Tensor) -> Tensor:
    """(M, 4, 4) motions over a fifth of the poses, at most 300 of them."""
    apart = max(1, len(T) // 5)
    begin = torch.arange(len(T) - apart)[:: max(1, len(T) // 300)]
    return inverse(T[begin]) @ T[begin + apart]


def _turn_error(P: Tensor, Q: Tensor) -> float:
    """RMS angle between the motions of two rows of poses, rad."""
    R = _motions(P)[:, :3, :3].mT @ _motions(Q)[:, :3, :3]
    return float(angle(R).square().mean().sqrt())


def _way_error(P: Tensor, Q: Tensor) -> float:
    """RMS distance between the ways of the motions of two rows of poses, each seen from its beginning, m."""
    return float((_motions(P)[:, :3, 3] - _motions(Q)[:, :3, 3]).square().sum(1).mean().sqrt())


def _ate(P: Tensor, Q: Tensor) -> float:
    source, target = P[:, :3, 3], Q[:, :3, 3]
    return float(distances(source, target, align(source, target)).square().mean().sqrt())


def _still(P: Tensor, Q: Tensor) -> bool:
    """Whether one of the two hardly turns: then its inverse is a turned copy."""
    eye = torch.eye(4, dtype=P.dtype)
    return min(_turn_error(T, eye.expand_as(T)) for T in (P, Q)) < LEAST_TURN


def _reordered(T: Tensor) -> Tensor:
    """The poses if what was read as x y z w had been w x y z."""
    fixed = T.clone()
    fixed[:, :3, :3] = rotation_from_quaternion(quaternion_from_rotation(T[:, :3, :3])[:, [1, 2, 3, 0]])
    return fixed


def _rotation_vectors(T: Tensor) -> Tensor:
    """(N, 3) axis times angle of (N, 4, 4) motions."""
    quaternion = quaternion_from_rotation(T[:, :3, :3])  # w >= 0
    length = quaternion[:, :3].norm(dim=1, keepdim=True)
    half = torch.atan2(length, quaternion[:, 3:])
    vectors: Tensor = 2 * half * quaternion[:, :3] / length.clamp(min=1e-12)
    return vectors
