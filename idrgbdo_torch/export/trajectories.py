"""The poses alone: for evo, in KITTI's format, and as a line to look at beside the points."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..tracker.mapping import Cloud, write_ply
from ..trajectory import Trajectory, write_tum
from .tracked import TrackedRun

FRUSTUM_M = 0.05  # how far its corners lie before the camera
RED = (205, 48, 48)


def write_evo(folder: Path, run: TrackedRun, frames: Sequence[int], reference: Trajectory | None) -> list[str]:
    """estimate.tum, and reference.tum where there is one; the files' names."""
    write_tum(folder / "estimate.tum", run.trajectory(frames))
    if reference is None:
        return ["estimate.tum"]
    write_tum(folder / "reference.tum", reference)
    return ["estimate.tum", "reference.tum"]


def write_kitti(folder: Path, run: TrackedRun, frames: Sequence[int]) -> list[str]:
    """poses.txt with the twelve numbers of T_world_cam a line, and times.txt; the files' names.

    KITTI's camera has our axes. Its files have no times and no gaps: a line a frame, of those that are handed on.
    """
    lines = [" ".join(f"{x:.9e}" for x in run.T_world_cam[number, :3].ravel()) for number in frames]
    (folder / "poses.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "times.txt").write_text("".join(f"{run.times[number]:.6e}\n" for number in frames), encoding="utf-8")
    return ["poses.txt", "times.txt"]


def write_clouds(folder: Path, run: TrackedRun, frames: Sequence[int], cloud: Cloud) -> list[str]:
    """points.ply and cameras.ply, small frusta as lines; the files' names."""
    write_ply(folder / "points.ply", Cloud(cloud.xyz, cloud.rgb, cloud.normal))
    write_frusta(folder / "cameras.ply", run.T_world_cam[list(frames)])
    return ["points.ply", "cameras.ply"]


def write_frusta(path: Path, T_world_cam: NDArray[np.float64]) -> None:
    """Cameras (N, 4, 4) as a PLY of vertices and edges: the centre, four corners, and the path."""
    shape = FRUSTUM_M * np.array([[0, 0, 0], [-0.6, -0.45, 1], [0.6, -0.45, 1], [0.6, 0.45, 1], [-0.6, 0.45, 1]])
    xyz = np.einsum("nij,kj->nki", T_world_cam[:, :3, :3], shape) + T_world_cam[:, None, :3, 3]
    own = np.array([[0, 1], [0, 2], [0, 3], [0, 4], [1, 2], [2, 3], [3, 4], [4, 1]])
    first = 5 * np.arange(len(T_world_cam))
    edges = np.concatenate(
        [(own[None] + first[:, None, None]).reshape(-1, 2), np.column_stack([first[:-1], first[1:]])]
    )
    header = (
        f"ply\nformat ascii 1.0\nelement vertex {5 * len(first)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element edge {len(edges)}\nproperty int vertex1\nproperty int vertex2\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
    )
    color = " ".join(map(str, RED))
    vertices = "".join(f"{x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in xyz.reshape(-1, 3).tolist())
    lines = "".join(f"{a} {b} {color}\n" for a, b in edges.tolist())
    path.write_text(header + vertices + lines, encoding="ascii")
