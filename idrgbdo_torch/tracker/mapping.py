"""The map of a run: the candidate points of its keyframes with their colours, in the world, within bounded memory."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..definitions.camera import Pinhole
from ..definitions.growing import Column
from ..frame import Keyframe
from .open3d_loader import load_open3d

Array = NDArray[np.float64]

LIMIT = 500_000  # points kept, 25 bytes each
FIRST_VOXEL = 0.005  # m, side of the cubes in which points are merged once there are more; doubled as often as needed
REACH = 3  # px between a point and the neighbours that its normal is taken from
UNIT = 32767  # of a kept normal, its length
SMOOTH = 0.05  # relative difference in depth above which a neighbour belongs to another surface


@dataclass(frozen=True)
class Cloud:
    """Coloured points with normals in some frame of reference."""

    xyz: NDArray[np.float32]  # (N, 3) m
    rgb: NDArray[np.uint8]  # (N, 3)
    normal: NDArray[np.float32]  # (N, 3) of unit length, towards the camera; 0 where unknown
    origin: Array | None = None  # (N, 3) time (s) of the keyframe that has it, and its px there; nan where unknown

    def tensors(self) -> tuple[Tensor, Tensor]:
        """The points (N, 3) float32 and their colours (N, 3) uint8."""
        return torch.from_numpy(self.xyz), torch.from_numpy(self.rgb)

    def __len__(self) -> int:
        return len(self.xyz)

    def origins(self) -> Array:
        """The same, nan for every point where nothing was said."""
        return np.full((len(self), 3), np.nan) if self.origin is None else self.origin


NOTHING = Cloud(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8), np.zeros((0, 3), np.float32))


class Kept(NamedTuple):
    """A cloud in half the memory: normals to 16 bits, and the keyframe's time once."""

    xyz: NDArray[np.float32]  # (N, 3) m
    rgb: NDArray[np.uint8]  # (N, 3)
    normal: NDArray[np.int16]  # (N, 3) in units of 1 / UNIT
    uv: NDArray[Any] | None  # (N, 2) px in the keyframe; None where unknown
    time: float  # s, of the keyframe

    @staticmethod
    def of(cloud: Cloud) -> Kept:
        """Of a keyframe's cloud, or of one without origins."""
        normal = np.rint(cloud.normal * UNIT).astype(np.int16)
        if cloud.origin is None or not len(cloud):
            return Kept(cloud.xyz, cloud.rgb, normal, None, 0.0)
        uv = cloud.origin[:, 1:]
        whole = uv.astype(np.uint16)
        exact = np.array_equal(whole, uv)  # as those of nearly all candidates are
        return Kept(cloud.xyz, cloud.rgb, normal, whole if exact else uv.astype(np.float32), float(cloud.origin[0, 0]))

    def cloud(self) -> Cloud:
        """As a cloud."""
        normal = self.normal.astype(np.float32) / np.float32(UNIT)
        if self.uv is None:
            return Cloud(self.xyz, self.rgb, normal)
        return Cloud(self.xyz, self.rgb, normal, np.column_stack([np.full(len(self.uv), self.time), self.uv]))


def keyframe_cloud(keyframe: Keyframe) -> Cloud:
    """The candidates of a keyframe in its own coordinates, at their inverse depths as refined so far.

    The colour is that of the pixel, gray where the frame came without colour.
    """
    camera = keyframe.frame.camera
    uv, inv_depth = keyframe.points.uv, keyframe.points.inv_depth
    ahead = inv_depth > 0.0
    uv, depth = uv[ahead], 1.0 / inv_depth[ahead]
    x = (uv[:, 0] - camera.cx) / camera.fx * depth
    y = (uv[:, 1] - camera.cy) / camera.fy * depth
    column, row = np.rint(uv).astype(np.int64).T
    if keyframe.frame.color is not None:
        rgb = keyframe.frame.color.numpy()[row, column]
    else:
        rgb = np.repeat(keyframe.frame.images[0][row, column, None].clip(0, 255), 3, axis=1)
    normal = surface_normals(keyframe.frame.depth, camera, row, column)
    origin = np.column_stack([np.full(len(uv), keyframe.frame.timestamp), uv])
    return Cloud(np.column_stack([x, y, depth]).astype(np.float32), rgb.astype(np.uint8), normal, origin)


def surface_normals(
    depth: NDArray[np.float32], camera: Pinhole, row: NDArray[np.int64], column: NDArray[np.int64]
) -> NDArray[np.float32]:
    """(N, 3) unit normals at pixels of a depth image (H, W), m, towards the camera, from neighbours REACH px away.

    Inverse depth is linear over the image of a plane, d = n . ray / offset, so its slopes give the normal.
    0 where one of the four has no depth or lies on another surface.
    """
    height, width = depth.shape
    left, right = np.maximum(column - REACH, 0), np.minimum(column + REACH, width - 1)
    above, below = np.maximum(row - REACH, 0), np.minimum(row + REACH, height - 1)
    z = depth[row, column]
    around = np.stack([depth[row, left], depth[row, right], depth[above, column], depth[below, column]])  # (4, N)
    known = (z > 0) & (np.abs(around - z) < SMOOTH * z).all(axis=0)
    d = 1.0 / np.where(known, around, 1.0).astype(np.float64)
    du, dv = (d[1] - d[0]) / (right - left), (d[3] - d[2]) / (below - above)
    ahead = 1.0 / np.where(known, z, 1.0) - (column - camera.cx) * du - (row - camera.cy) * dv
    normal = -np.column_stack([camera.fx * du, camera.fy * dv, ahead])
    length = np.sqrt(np.einsum("nk,nk->n", normal, normal))
    return np.asarray(normal * (known / length)[:, None], np.float32)


def world_cloud(clouds: Sequence[Cloud], T_kf_world: Sequence[Array]) -> Cloud:
    """All keyframes' clouds (each in its own coordinates) as one in the world."""
    xyz, normal = [NOTHING.xyz], [NOTHING.normal]
    for cloud, T in zip(clouds, T_kf_world, strict=True):
        xyz.append(((cloud.xyz - T[:3, 3]) @ T[:3, :3]).astype(np.float32))  # R^T (P - t)
        normal.append((cloud.normal @ T[:3, :3]).astype(np.float32))
    origin = [NOTHING.origins(), *(cloud.origins() for cloud in clouds)]
    rgb = [NOTHING.rgb, *(cloud.rgb for cloud in clouds)]
    return Cloud(np.concatenate(xyz), np.concatenate(rgb), np.concatenate(normal), np.concatenate(origin))


def together(clouds: Iterable[Cloud]) -> Cloud:
    """Clouds in one world as one."""
    parts = [NOTHING, *clouds]
    return Cloud(*(np.concatenate(arrays) for arrays in zip(*((c.xyz, c.rgb, c.normal) for c in parts), strict=True)))


def condense(
    clouds: list[Cloud], T_kf_world: Column | Sequence[Array], moving: Collection[int], limit: int = LIMIT
) -> list[Cloud]:
    """The same clouds, or, where they hold more than `limit` points together, fewer points at the same places.

    Then all keyframes but the `moving` ones (whose poses may still change) share one cloud: merged in voxels to at most
    half the limit, it becomes that of the first of them, and the others are left empty.
    """
    settled = [number for number in range(len(clouds)) if number not in moving]
    if sum(map(len, clouds)) <= limit or not settled:
        return clouds
    first = settled[0]
    merged = world_cloud([clouds[number] for number in settled], [T_kf_world[number] for number in settled])
    voxel = FIRST_VOXEL
    while len(merged) > limit // 2:
        merged = merge_in_voxels(merged, voxel)
        voxel *= 2.0
    out = list(clouds)
    for number in settled:
        out[number] = NOTHING
    R, t = T_kf_world[first][:3, :3], T_kf_world[first][:3, 3]
    out[first] = Cloud((merged.xyz @ R.T + t).astype(np.float32), merged.rgb, (merged.normal @ R.T).astype(np.float32))
    return out


def merge_in_voxels(cloud: Cloud, size: float) -> Cloud:
    """One point per cube of side `size` (m) that holds any: the mean of its points, of their colours and normals."""
    o3d = load_open3d()
    points = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud.xyz.astype(np.float64)))
    points.colors = o3d.utility.Vector3dVector(cloud.rgb / 255.0)
    points.normals = o3d.utility.Vector3dVector(cloud.normal.astype(np.float64))
    merged = points.voxel_down_sample(size)
    rgb = np.rint(np.asarray(merged.colors) * 255.0).astype(np.uint8)
    normal = np.asarray(merged.normals)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(length > 1e-6, normal / np.maximum(length, 1e-6), 0.0)
    return Cloud(np.asarray(merged.points).astype(np.float32), rgb, normal.astype(np.float32))


def write_ply(path: Path, cloud: Cloud) -> None:
    """A binary PLY point cloud: colours, normals (0, 0, 0 where unknown), and where known keyframes' times and px."""
    path.write_bytes(ply_bytes(cloud))


def ply_bytes(cloud: Cloud) -> bytes:
    """The contents of such a file."""
    columns: dict[str, NDArray[Any]] = {"x": cloud.xyz[:, 0], "y": cloud.xyz[:, 1], "z": cloud.xyz[:, 2]}
    columns |= {f"n{axis}": cloud.normal[:, number] for number, axis in enumerate("xyz")}
    columns |= {name: cloud.rgb[:, number] for number, name in enumerate(("red", "green", "blue"))}
    if cloud.origin is not None:
        u, v = cloud.origin[:, 1:].T.astype(np.float32)
        columns |= {"time": cloud.origin[:, 0], "u": u, "v": v}
    kinds = {"f4": "float", "u1": "uchar", "f8": "double"}
    layout = [(name, values.dtype.str[1:]) for name, values in columns.items()]
    vertices = np.empty(len(cloud), dtype=[(name, f"<{kind}") for name, kind in layout])
    for name, values in columns.items():
        vertices[name] = values
    properties = "".join(f"property {kinds[kind]} {name}\n" for name, kind in layout)
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(cloud)}\n{properties}end_header\n"
    return header.encode("ascii") + vertices.tobytes()
