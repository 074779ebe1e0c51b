"""Timed poses: TUM text in and out, association of two clocks, rigid alignment."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from .errors import IdRgbdoError, door
from .text.tum import read_rows

TUM_HEADER = "# timestamp tx ty tz qx qy qz qw (camera to world, seconds and metres)\n"


@dataclass(frozen=True)
class Trajectory:
    """Poses T_world_cam over time."""

    timestamps: Tensor  # (N,) float64 seconds, increasing
    T_world_cam: Tensor  # (N, 4, 4) float64
    notes: tuple[str, ...] = ()  # what a reader should know: other units, repeated times; sentences

    def __post_init__(self) -> None:
        times, poses = self.timestamps, self.T_world_cam
        for name, given in (("timestamps", times), ("T_world_cam", poses)):
            if not isinstance(given, Tensor) or given.is_nested or given.layout != torch.strided or given.is_meta:
                raise IdRgbdoError(f"{name}: expected a dense float64 tensor, got {type(given).__name__}; convert it")
        if times.dtype != torch.float64 or times.dim() != 1:
            raise IdRgbdoError(
                f"timestamps: expected (N,) float64, got {tuple(times.shape)} {times.dtype}; convert them"
            )
        if poses.dtype != torch.float64 or tuple(poses.shape) != (len(times), 4, 4):
            raise IdRgbdoError(
                f"T_world_cam: expected ({len(times)}, 4, 4) float64, one pose a timestamp, "
                f"got {tuple(poses.shape)} {poses.dtype}; convert them"
            )
        if not bool((times[1:] > times[:-1]).all() & times.isfinite().all()):  # nor NaN
            raise IdRgbdoError("timestamps: expected increasing times, got a step back or a repeated time; sort them")

    def __len__(self) -> int:
        return len(self.timestamps)

    @property
    def positions(self) -> Tensor:
        """(N, 3) float64 camera centres in the world, m."""
        return self.T_world_cam[:, :3, 3]

    def path_length_m(self) -> float:
        """Sum of the distances between neighbouring positions, m."""
        return float(self.positions.diff(dim=0).norm(dim=1).sum())

    def at(self, indices: Tensor) -> Trajectory:
        """The poses at (M,) increasing indices (or a boolean mask)."""
        return Trajectory(self.timestamps[indices], self.T_world_cam[indices], self.notes)


def in_time(timestamps: Tensor) -> Tensor:
    """(M,) indices that sort times (N,) float64; of equal times the last, as read_tum takes them.

    A clock that stands still, goes back or jumps for a frame costs one pose, not the trajectory.
    """
    order = timestamps.argsort(stable=True)
    times = timestamps[order]
    return order[torch.cat([times[1:] > times[:-1], torch.ones(min(len(times), 1), dtype=torch.bool)])]


def timed(timestamps: Tensor, T_world_cam: Tensor) -> Trajectory:
    """Poses (N, 4, 4) at times (N,) in any order, by time; `notes` of the result says where some share one."""
    order = in_time(timestamps)
    left_out = len(timestamps) - len(order)
    repeated = f"{left_out} of {len(timestamps)} frames have the time of a later one, whose pose stands for both"
    return Trajectory(timestamps[order], T_world_cam[order], (repeated,) if left_out else ())


def rotation_from_quaternion(quaternion: Tensor) -> Tensor:
    """(..., 3, 3) rotation of (..., 4) quaternions x, y, z, w of any length but zero."""
    x, y, z, w = (quaternion / quaternion.norm(dim=-1, keepdim=True)).unbind(-1)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)  # (..., 3, 3)


def quaternion_from_rotation(R: Tensor) -> Tensor:
    """(..., 4) unit quaternion x, y, z, w with w >= 0 of (..., 3, 3) rotations, accurate at every angle.

    The symmetric matrix q q^T has a column for each component; the one with the largest diagonal is safe to divide by.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = (row.unbind(-1) for row in R.unbind(-2))
    outer = (  # 4 q q^T, order x, y, z, w
        (1 + xx - yy - zz, xy + yx, xz + zx, zy - yz),
        (xy + yx, 1 - xx + yy - zz, yz + zy, xz - zx),
        (xz + zx, yz + zy, 1 - xx - yy + zz, yx - xy),
        (zy - yz, xz - zx, yx - xy, 1 + xx + yy + zz),
    )
    rows = torch.stack([torch.stack(row, dim=-1) for row in outer], dim=-2)  # (..., 4, 4)
    largest = rows.diagonal(dim1=-2, dim2=-1).argmax(dim=-1)[..., None, None].expand(*R.shape[:-2], 1, 4)
    quaternion = rows.gather(-2, largest)[..., 0, :]
    quaternion = quaternion / quaternion.norm(dim=-1, keepdim=True)
    return torch.where(quaternion[..., 3:] < 0, -quaternion, quaternion)


def tum_line(timestamp: float, T_world_cam: Tensor) -> str:
    """One line of a TUM trajectory file: `timestamp tx ty tz qx qy qz qw`, with its line feed."""
    numbers = T_world_cam[:3, 3].tolist() + quaternion_from_rotation(T_world_cam[:3, :3]).tolist()
    return f"{timestamp:.6f} " + " ".join(f"{round(number, 9) + 0.0:.9f}" for number in numbers) + "\n"


def tum_text(trajectory: Trajectory) -> str:
    """A trajectory as TUM text."""
    poses = zip(trajectory.timestamps.tolist(), trajectory.T_world_cam, strict=True)
    return TUM_HEADER + "".join(tum_line(time, pose) for time, pose in poses)


@door
def write_tum(path: Path | str, trajectory: Trajectory) -> None:
    """Write a trajectory as TUM text. Raises IdRgbdoError where the file cannot be written."""
    Path(path).write_text(tum_text(trajectory), encoding="utf-8")


@door
def read_tum(path: Path | str) -> Trajectory:
    """Read TUM text: `timestamp tx ty tz qx qy qz qw` a line, # for comments, commas and tabs as good as blanks.

    Timestamps above 1e11 are milliseconds, microseconds or nanoseconds, and become seconds. Like the TUM tools it sorts
    by time, keeps the last of equal times, and leaves out poses that are marked invalid (a zero quaternion or a NaN);
    `notes` of the result says what of this was done.
    Raises IdRgbdoError with file and line for anything else that is not eight numbers with a unit quaternion, for
    timestamps that are no clock, and where a second run follows the first.
    """
    found = read_rows(Path(path))
    rows = torch.tensor(found.poses, dtype=torch.float64)  # (N, 7)
    T_world_cam = torch.eye(4, dtype=torch.float64).repeat(len(rows), 1, 1)
    T_world_cam[:, :3, 3] = rows[:, :3]
    T_world_cam[:, :3, :3] = rotation_from_quaternion(rows[:, 3:])
    return Trajectory(torch.tensor(found.times, dtype=torch.float64), T_world_cam, found.notes)


def associate(times_a: Tensor, times_b: Tensor, max_difference: float = 0.02) -> tuple[Tensor, Tensor]:
    """Indices (into a, into b) that pair two clocks: as many pairs as possible, then the least sum of differences.

    times_a, times_b: (N,), (M,) float64 increasing seconds. No pair is further apart than max_difference (s), no index
    is used twice, and pairs never cross. Where images come at half the rate of poses this is the nearest pose of each;
    where two cameras run half a period apart it does not drop frames, as pairing the closest first would.
    """
    a, b = times_a.tolist(), times_b.tolist()
    first = torch.searchsorted(times_b, times_a - max_difference, side="left").tolist()
    last = torch.searchsorted(times_b, times_a + max_difference, side="right").tolist()
    # best[j]: (pairs, -sum of differences, chain of pairs) with the a's so far and b[:j]; a's windows only move right
    best: list[tuple[int, float, _Chain]] = [(0, 0.0, None)]
    for i in range(len(a)):
        best.extend(best[-1:] * (last[i] + 1 - len(best)))
        before = best[first[i]]
        for j in range(first[i], last[i]):
            count, gain, chain = before
            before = best[j + 1]
            paired = (count + 1, gain - abs(a[i] - b[j]), (i, j, chain))
            best[j + 1] = max(best[j + 1], paired, best[j], key=lambda entry: entry[:2])
    pairs = []
    chain = best[-1][2]
    while chain is not None:
        i, j, chain = chain
        pairs.append((i, j))
    indices = torch.tensor(pairs[::-1], dtype=torch.int64).reshape(-1, 2)
    return indices[:, 0], indices[:, 1]


_Chain = tuple[int, int, "_Chain"] | None


def nearest(sorted_times: Tensor, times: Tensor) -> Tensor:
    """(N,) indices of the entries of sorted_times (M,) nearest to times (N,), the earlier of two equally near."""
    right = torch.searchsorted(sorted_times, times).clamp(max=len(sorted_times) - 1)
    left = (right - 1).clamp(min=0)
    take_left = (times - sorted_times[left]).abs() <= (sorted_times[right] - times).abs()
    return torch.where(take_left, left, right)


def align(source: Tensor, target: Tensor) -> Tensor:
    """(4, 4) rigid T_target_source that minimises sum |target - T source|^2 over (N, 3) points; no scale.

    Horn 1987, Umeyama 1991: rotation from the singular vectors of the covariance, a reflection turned back.
    """
    centre_source, centre_target = source.mean(dim=0), target.mean(dim=0)
    covariance = (target - centre_target).T @ (source - centre_source)  # (3, 3)
    U, _, Vh = torch.linalg.svd(covariance)
    sign = torch.ones(3, dtype=source.dtype)
    sign[2] = torch.linalg.det(U) * torch.linalg.det(Vh)
    R = U @ torch.diag(sign) @ Vh
    T_target_source = torch.eye(4, dtype=source.dtype)
    T_target_source[:3, :3] = R
    T_target_source[:3, 3] = centre_target - R @ centre_source
    return T_target_source
