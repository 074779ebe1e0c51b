"""The map of a run: the candidate points of its keyframes with their colours, in the world, within bounded memory."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .frame import Keyframe
from .open3d_loader import load_open3d

Array = NDArray[np.float64]

LIMIT = 1_000_000  # points kept, 15 bytes each
FIRST_VOXEL = 0.005  # m, side of the cubes in which points are merged once there are more; doubled as often as needed


@dataclass(frozen=True)
class Cloud:
    """Coloured points in some frame of reference."""

    xyz: NDArray[np.float32]  # (N, 3) m
    rgb: NDArray[np.uint8]  # (N, 3)

    def __len__(self) -> int:
        return len(self.xyz)


NOTHING = Cloud(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8))


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
    return Cloud(np.column_stack([x, y, depth]).astype(np.float32), rgb.astype(np.uint8))


def world_cloud(clouds: Sequence[Cloud], T_kf_world: Sequence[Array]) -> Cloud:
    """All keyframes' clouds (each in its own coordinates) as one in the world."""
    xyz = [np.zeros((0, 3), np.float32)]
    for cloud, T in zip(clouds, T_kf_world, strict=True):
        xyz.append(((cloud.xyz - T[:3, 3]) @ T[:3, :3]).astype(np.float32))  # R^T (P - t)
    return Cloud(np.concatenate(xyz), np.concatenate([np.zeros((0, 3), np.uint8), *(cloud.rgb for cloud in clouds)]))


def condense(
    clouds: list[Cloud], T_kf_world: Sequence[Array], moving: Collection[int], limit: int = LIMIT
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
        out[number] = Cloud(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8))
    T = T_kf_world[first]
    out[first] = Cloud((merged.xyz @ T[:3, :3].T + T[:3, 3]).astype(np.float32), merged.rgb)
    return out


def merge_in_voxels(cloud: Cloud, size: float) -> Cloud:
    """One point per cube of side `size` (m) that holds any: the mean of its points, and of their colours."""
    o3d = load_open3d()
    points = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud.xyz.astype(np.float64)))
    points.colors = o3d.utility.Vector3dVector(cloud.rgb / 255.0)
    merged = points.voxel_down_sample(size)
    rgb = np.rint(np.asarray(merged.colors) * 255.0).astype(np.uint8)
    return Cloud(np.asarray(merged.points).astype(np.float32), rgb)
