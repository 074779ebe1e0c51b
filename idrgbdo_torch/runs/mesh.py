"""A dense coloured mesh: all depth images fused into one truncated signed distance (Open3D's voxel blocks)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import torch

from ..definitions.camera import Pinhole
from ..definitions.se3 import inverse
from ..errors import IdRgbdoError
from ..frame import BrokenFrame, RgbdFrame
from ..tracker.open3d_loader import load_open3d
from ..trajectory import Trajectory, nearest

BLOCK = 8  # voxels along the side of a block
TRUNCATION = 5.0  # voxels: the signed distance is kept this far from the surface
COARSER = 1.5  # times the voxel, when the blocks run out
SAME_TIME_S = 5e-3  # between a frame and its pose
LEAST_POSES = 0.1  # of the frames, or of the poses where they are fewer; less is chance, or another clock


class Frames(Protocol):
    """A recording that can be read again."""

    timestamps: list[float]  # s

    def __len__(self) -> int: ...

    def read(self, index: int) -> RgbdFrame | BrokenFrame:
        """One frame, decoded now."""


@dataclass(frozen=True)
class MeshConfig:
    """How fine and how large a mesh may become."""

    voxel_m: float = 0.01
    depth_max_m: float = 3.0  # farther depth is too noisy: a Kinect's grows with the square
    blocks: int = 40_000  # of 8^3 voxels, 6 kB each: what is kept in memory; coarser voxels where they run out
    weight: float = 4.0  # frames that must have seen a voxel
    every: int = 1  # fuse every n-th frame

    def __post_init__(self) -> None:
        for name in ("voxel_m", "depth_max_m", "blocks", "every"):
            if not getattr(self, name) > 0:
                raise IdRgbdoError(f"{name}: expected a positive number, got {getattr(self, name)}; give a larger one")


@dataclass(frozen=True)
class Mesh:
    """Triangles in the world of the poses."""

    triangles: Any  # open3d.t.geometry.TriangleMesh with vertex colours and normals
    voxel_m: float  # as it came out
    frames: int  # fused

    @property
    def vertices(self) -> int:
        """How many there are."""
        return int(self.triangles.vertex.positions.shape[0])

    def write(self, path: Path) -> None:
        """A binary PLY. Raises IdRgbdoError where it cannot be written."""
        o3d = load_open3d()
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            written = o3d.t.io.write_triangle_mesh(str(path), self.triangles)
        except OSError as error:
            raise IdRgbdoError(f"mesh: cannot write '{path}': {error.strerror}; pass another --out") from error
        if not written:
            raise IdRgbdoError(f"mesh: cannot write '{path}'; make room there or pass another --out")


class _BudgetSpent(IdRgbdoError):
    """The blocks ran out: the surface is larger than they can hold at this voxel size."""


def fuse(
    frames: Frames,
    trajectory: Trajectory,
    config: MeshConfig | None = None,
    on_frame: Callable[[str], None] = lambda note: None,
) -> Mesh:
    """The mesh of all frames that have a pose. Images are read one after the other: memory holds the blocks alone.

    trajectory: T_world_cam at the frames' times, without those that are not to be believed. Where the blocks do not
    suffice it begins anew with larger voxels.
    Raises IdRgbdoError where no frame has a pose, or nothing was seen often enough.
    """
    config = config or MeshConfig()
    poses = _poses(frames, trajectory)
    voxel = config.voxel_m
    while True:
        try:
            return _fuse_at(frames, poses[:: config.every], config, voxel, on_frame)
        except _BudgetSpent:
            voxel *= COARSER


def _poses(frames: Frames, trajectory: Trajectory) -> list[tuple[int, torch.Tensor]]:
    """Numbers of the frames with a pose, and T_cam_world."""
    if len(trajectory) == 0:
        raise IdRgbdoError("trajectory: expected poses, got none that is to be believed; see why frames were lost")
    times = torch.tensor(frames.timestamps, dtype=torch.float64)
    index = nearest(trajectory.timestamps, times)
    near = (trajectory.timestamps[index] - times).abs() <= SAME_TIME_S
    found, frames_or_poses = int(near.sum()), min(len(times), len(trajectory))
    if found < max(LEAST_POSES * frames_or_poses, min(2, len(times))):
        clocks = [f"{float(t[0]):.6f} to {float(t[-1]):.6f} s" for t in (times, trajectory.timestamps)]
        raise IdRgbdoError(
            f"trajectory: expected poses at the times of the frames, got {found or 'none'} that is within 5 ms of one, "
            f"for {len(times)} frames ({clocks[0]}) and {len(trajectory)} poses ({clocks[1]}); "
            "pass the trajectory of this recording"
        )
    return [(n, inverse(trajectory.T_world_cam[index[n]])) for n in torch.nonzero(near)[:, 0].tolist()]


def _fuse_at(
    frames: Frames,
    poses: list[tuple[int, torch.Tensor]],
    config: MeshConfig,
    voxel_m: float,
    on_frame: Callable[[str], None],
) -> Mesh:
    """One pass. Raises _BudgetSpent as soon as more blocks are needed than allowed."""
    o3d = load_open3d()
    core = o3d.core
    grid = o3d.t.geometry.VoxelBlockGrid(
        attr_names=("tsdf", "weight", "color"),
        attr_dtypes=(core.float32, core.uint16, core.uint16),
        attr_channels=((1,), (1,), (3,)),
        voxel_size=voxel_m,
        block_resolution=BLOCK,
        block_count=min(config.blocks, 5000),  # grows
    )
    fused = 0
    for number, T_cam_world in poses:
        frame = frames.read(number)
        on_frame(f"{1000 * voxel_m:.0f} mm")
        if isinstance(frame, BrokenFrame) or not _reaches(frame, config.depth_max_m):
            continue
        _integrate(grid, frame, T_cam_world, config.depth_max_m)
        if grid.hashmap().size() > config.blocks:
            raise _BudgetSpent(f"blocks: {config.blocks} do not hold the surface at {voxel_m} m")
        fused += 1
    nothing = "mesh: no surface was seen often enough within depth_max_m; raise it or lower the weight"
    if fused == 0:
        raise IdRgbdoError(nothing)
    triangles = grid.extract_triangle_mesh(weight_threshold=min(config.weight, fused) - 0.5)
    if "colors" in triangles.vertex:
        triangles.vertex.colors = triangles.vertex.colors.clip(0.0, 1.0)  # interpolated; Open3D warns of 1.0001
    mesh = Mesh(triangles, voxel_m, fused)
    if mesh.vertices == 0:
        raise IdRgbdoError(nothing)
    return mesh


def _reaches(frame: RgbdFrame, depth_max_m: float) -> bool:
    """Whether any depth is near enough, where Open3D looks: at every fourth pixel. It raises an error where none is."""
    depth = frame.depth[::4, ::4]
    return bool(((depth > 0) & (depth < depth_max_m)).any())


def _integrate(grid: Any, frame: RgbdFrame, T_cam_world: torch.Tensor, depth_max_m: float) -> None:
    o3d = load_open3d()
    depth = o3d.t.geometry.Image(o3d.core.Tensor(frame.depth.numpy()))
    gray = frame.gray[..., None].expand(-1, -1, 3)
    rgb = (gray if frame.color is None else frame.color).float().contiguous()
    color = o3d.t.geometry.Image(o3d.core.Tensor(rgb.numpy() / 255.0))
    K = _intrinsics(frame.camera)
    extrinsic = o3d.core.Tensor(T_cam_world.numpy())
    blocks = grid.compute_unique_block_coordinates(depth, K, extrinsic, 1.0, depth_max_m, TRUNCATION)
    grid.integrate(blocks, depth, color, K, extrinsic, 1.0, depth_max_m, TRUNCATION)


def _intrinsics(camera: Pinhole) -> Any:
    return load_open3d().core.Tensor(camera.matrix().numpy())
