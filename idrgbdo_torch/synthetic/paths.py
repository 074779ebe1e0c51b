"""Camera paths in time: a recorded TUM trajectory, smoothed, or a built-in hand-held one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..errors import IdRgbdoError
from ..text.files import read_text

Array = npt.NDArray[np.float64]
GRID_HZ = 240.0  # of the stored samples; linear between them costs less than 0.02 mm at 5 m/s^2


@dataclass(frozen=True)
class CameraPath:
    """A smooth path T_world_cam(t), stored on a uniform time grid that begins a little before `first`."""

    first: float  # s, of the first frame
    times: Array  # (M,) s
    positions: Array  # (M, 3) m
    quaternions: Array  # (M, 4) x y z w, neighbours on the same hemisphere

    def pose(self, t: float | Array) -> Array:
        """(..., 4, 4) T_world_cam at the times t (...), held at both ends."""
        q, p = (np.stack([np.interp(t, self.times, c) for c in x.T], -1) for x in (self.quaternions, self.positions))
        T = np.zeros((*p.shape[:-1], 4, 4))
        T[..., :3, :3] = rotation_matrix(q / np.linalg.norm(q, axis=-1, keepdims=True))
        T[..., :3, 3] = p
        T[..., 3, 3] = 1.0
        return T


def rotation_matrix(q: Array) -> Array:
    """(..., 3, 3) rotation of unit quaternions (..., 4), x y z w."""
    x, y, z, w = np.moveaxis(q, -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, -1) for row in rows], -2)


def quaternion(R: Array) -> Array:
    """(4,) unit quaternion x y z w, w >= 0, of a rotation (3, 3): the dominant eigenvector of Bar-Itzhack's matrix."""
    K = np.zeros((4, 4))
    K[:3, :3] = R + R.T - np.trace(R) * np.eye(3)
    K[:3, 3] = K[3, :3] = [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]
    K[3, 3] = np.trace(R)
    q: Array = np.linalg.eigh(K)[1][:, -1]
    return -q if q[3] < 0 else q


def recorded_path(file: Path, start: float, duration: float) -> CameraPath:
    """The part [start, start + duration] (s) of a TUM trajectory file as a smooth path.

    Recorded poses jitter by millimetres, which no hand does: positions and quaternions are resampled and smoothed by a
    Gaussian of 40 ms, or of two sampling intervals where poses are sparse. Time stamps that count
    frames (0, 1, 2, ...) are read as 30 per second.
    Raises IdRgbdoError where the file is missing, malformed, or shorter than asked.
    """
    text = read_text(file, "trajectory", "give a TUM trajectory")
    try:
        rows = np.loadtxt(text.splitlines(), comments="#", ndmin=2, dtype=np.float64)
    except ValueError as error:
        raise IdRgbdoError(
            f"trajectory: expected a text file of 'timestamp tx ty tz qx qy qz qw', got {error}; give a TUM trajectory"
        ) from error
    if rows.shape[0] < 2 or rows.shape[1] < 8 or not np.isfinite(rows).all():
        raise IdRgbdoError(
            f"trajectory: expected at least 2 finite rows of 8 numbers, got {rows.shape} in {file}; "
            "give a TUM trajectory"
        )
    t, keep = np.unique(rows[:, 0], return_index=True)
    rows = rows[keep]
    if np.array_equal(t, np.round(t)) and np.median(np.diff(t)) == 1.0:
        t = t / 30.0
    smoothing_s = max(0.04, 2.0 * float(np.median(np.diff(t))))
    first, last = t[0] + start, t[0] + start + duration
    if start < 0 or last > t[-1]:
        raise IdRgbdoError(
            f"start: expected {duration:.1f} s from {start:.1f} s on within the trajectory's {t[-1] - t[0]:.1f} s; "
            "start earlier or ask for fewer frames"
        )
    q = rows[:, 4:8] / np.linalg.norm(rows[:, 4:8], axis=1, keepdims=True)
    q *= np.cumprod(np.r_[1.0, np.where(np.sum(q[1:] * q[:-1], 1) < 0, -1.0, 1.0)])[:, None]
    grid = np.arange(first - 0.1, last + 0.1 + 0.5 / GRID_HZ, 1.0 / GRID_HZ)
    pad = int(np.ceil(4 * smoothing_s * GRID_HZ))
    wide = grid[0] + np.arange(-pad, len(grid) + pad) / GRID_HZ
    kernel = np.exp(-0.5 * (np.arange(-pad, pad + 1) / (smoothing_s * GRID_HZ)) ** 2)
    kernel /= kernel.sum()
    smooth = np.stack(
        [np.convolve(np.interp(wide, t, c), kernel, mode="valid") for c in np.c_[rows[:, 1:4], q].T], axis=1
    )
    q = smooth[:, 3:] / np.linalg.norm(smooth[:, 3:], axis=1, keepdims=True)
    return CameraPath(first=first, times=grid, positions=smooth[:, :3], quaternions=q)


def handheld_path(duration: float, seed: int) -> CameraPath:
    """A built-in path: slow sweeps of a person's arm and body plus the small tremor of a hand; z is up."""
    rng = np.random.default_rng([seed, 101])
    t = np.arange(-0.1, duration + 0.1 + 0.5 / GRID_HZ, 1.0 / GRID_HZ)

    def sway(slow: float, fast: float) -> Array:
        """Sum of sinusoids of about the given amplitudes at 0.08 to 0.45 Hz and at 0.8 to 2.5 Hz."""
        hz = np.r_[rng.uniform(0.08, 0.45, 3), rng.uniform(0.8, 2.5, 3)]
        amplitude = np.r_[np.full(3, slow), np.full(3, fast)] * rng.uniform(0.4, 0.8, 6)
        phase = rng.uniform(0, 2 * np.pi, 6)
        return np.asarray((amplitude[:, None] * np.sin(2 * np.pi * hz[:, None] * t + phase[:, None])).sum(0))

    positions = np.stack([sway(0.30, 0.003), sway(0.22, 0.003), 1.45 + sway(0.12, 0.003)], axis=1)
    yaw, pitch, roll = sway(0.35, 0.007), -0.45 + sway(0.12, 0.007), sway(0.06, 0.006)
    # camera x right, y down, z forward; at yaw 0 it looks along world +y
    zero, one = np.zeros_like(t), np.ones_like(t)
    base = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    about = {
        "z": [[np.cos(yaw), -np.sin(yaw), zero], [np.sin(yaw), np.cos(yaw), zero], [zero, zero, one]],
        "x": [[one, zero, zero], [zero, np.cos(pitch), -np.sin(pitch)], [zero, np.sin(pitch), np.cos(pitch)]],
        "r": [[np.cos(roll), -np.sin(roll), zero], [np.sin(roll), np.cos(roll), zero], [zero, zero, one]],
    }
    Rz, Rx, Rr = (np.moveaxis(np.array(about[k]), -1, 0) for k in "zxr")
    q = np.array([quaternion(R) for R in Rz @ Rx @ base @ Rr])
    q *= np.cumprod(np.r_[1.0, np.where(np.sum(q[1:] * q[:-1], 1) < 0, -1.0, 1.0)])[:, None]
    return CameraPath(first=0.0, times=t, positions=positions, quaternions=q)
