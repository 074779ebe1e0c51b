"""The mesh lies on the surface that was filmed, within its budget of memory."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from faults import Recording
from rendered import SMALL, Film, clearance

from idrgbdo_torch import IdRgbdo
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.frame import BrokenFrame, RgbdFrame
from idrgbdo_torch.odometry import run
from idrgbdo_torch.runs.mesh import Mesh, MeshConfig, fuse
from idrgbdo_torch.synthetic import RenderedSequence
from idrgbdo_torch.tracker.open3d_loader import load_open3d
from idrgbdo_torch.trajectory import Trajectory

SURFACE_M = 0.02  # a vertex is on the surface within this


@pytest.fixture(scope="module")
def room() -> RenderedSequence:
    """The room that the desk stands in."""
    return RenderedSequence(SMALL)


def distances(room: RenderedSequence, mesh: Mesh, T_world_first: torch.Tensor) -> np.ndarray:
    """m of every fifth vertex from the true surface; the mesh's world is that of its first camera at T_world_first."""
    T = room.T_scene_world @ T_world_first.numpy()
    vertices = mesh.triangles.vertex.positions.numpy()[::5].astype(np.float64)
    return clearance(room.renderer.world, vertices @ T[:3, :3].T + T[:3, 3])


def test_nine_of_ten_vertices_lie_within_2_cm_of_the_room_by_the_tracked_poses(
    desk: Film, room: RenderedSequence
) -> None:
    odometry = IdRgbdo()
    run(odometry, desk.frames)
    mesh = fuse(Recording(list(desk.frames)), odometry.trajectory())
    assert mesh.voxel_m == 0.01
    assert mesh.frames == 40
    assert mesh.vertices > 20_000
    away = distances(room, mesh, desk.groundtruth.T_world_cam[0])
    assert (away < SURFACE_M).mean() >= 0.9
    assert np.median(away) < 0.005


def test_wrong_poses_do_not_lie_on_the_surface(desk: Film, room: RenderedSequence) -> None:
    poses = desk.groundtruth.T_world_cam.clone()
    poses[:, 0, 3] += torch.linspace(0.0, 0.3, len(poses), dtype=torch.float64)
    mesh = fuse(Recording(list(desk.frames)), Trajectory(desk.groundtruth.timestamps, poses))
    away = distances(room, mesh, torch.eye(4, dtype=torch.float64))
    assert (away < SURFACE_M).mean() < 0.9


def test_where_the_blocks_run_out_the_voxels_become_larger(desk: Film) -> None:
    frames = Recording(list(desk.frames[:6]))
    fine = fuse(frames, desk.groundtruth)
    coarse = fuse(frames, desk.groundtruth, MeshConfig(blocks=800))
    assert coarse.voxel_m > fine.voxel_m == 0.01
    assert coarse.vertices < 0.5 * fine.vertices


def test_frames_without_pose_or_image_are_left_out_and_every_nth_is_taken(desk: Film) -> None:
    class Damaged(Recording):
        def read(self, index: int) -> RgbdFrame | BrokenFrame:
            return BrokenFrame(self.timestamps[index], "gone") if index == 3 else super().read(index)

    some = desk.groundtruth.at(torch.arange(8))
    seen: list[str] = []
    mesh = fuse(Damaged(list(desk.frames[:10])), some, MeshConfig(voxel_m=0.04), seen.append)
    assert mesh.frames == 7
    assert len(seen) == 8
    assert fuse(Recording(list(desk.frames[:10])), some, MeshConfig(voxel_m=0.04, every=3)).frames == 3


def test_the_file_is_a_coloured_mesh(desk: Film, tmp_path: Path) -> None:
    mesh = fuse(Recording(list(desk.frames[:5])), desk.groundtruth, MeshConfig(voxel_m=0.03))
    mesh.write(tmp_path / "new" / "mesh.ply")
    back = load_open3d().io.read_triangle_mesh(str(tmp_path / "new" / "mesh.ply"))
    assert len(back.vertices) == mesh.vertices
    assert len(back.triangles) > 100
    colors = np.asarray(back.vertex_colors)
    assert colors.std() > 0.05
    seen = torch.stack([frame.color for frame in desk.frames[:5] if frame.color is not None]).double().mean((0, 1, 2))
    np.testing.assert_allclose(colors.mean(axis=0) * 255, seen.numpy(), atol=25)


def test_without_colour_it_is_gray(desk: Film) -> None:
    frames = [replace(frame, color=None) for frame in desk.frames[:5]]
    colors = fuse(Recording(frames), desk.groundtruth, MeshConfig(voxel_m=0.03)).triangles.vertex.colors.numpy()
    np.testing.assert_allclose(colors[:, 0], colors[:, 2], atol=1e-6)


def test_a_pose_for_every_tenth_frame_or_for_some_in_a_row_will_do(desk: Film) -> None:
    every_tenth = desk.groundtruth.at(torch.arange(0, 40, 10))
    assert fuse(Recording(list(desk.frames)), every_tenth, MeshConfig(voxel_m=0.04)).frames == 4
    assert fuse(Recording(list(desk.frames[20:24])), desk.groundtruth, MeshConfig(voxel_m=0.04)).frames == 4
    assert fuse(Recording(list(desk.frames[:1])), desk.groundtruth, MeshConfig(voxel_m=0.04)).frames == 1


def test_another_recordings_poses_and_an_empty_mesh_are_errors(desk: Film) -> None:
    frames = Recording(list(desk.frames[:3]))
    later = Trajectory(desk.groundtruth.timestamps + 100.0, desk.groundtruth.T_world_cam)
    with pytest.raises(IdRgbdoError, match="trajectory: expected poses at the times of the frames"):
        fuse(frames, later)
    with pytest.raises(
        IdRgbdoError, match=r"got 1 that is within 5 ms of one, for 40 frames \(0.* and 40 poses \(1\.29"
    ):
        fuse(  # the clocks differ, and the last frame meets the first pose by chance
            Recording(list(desk.frames)),
            Trajectory(desk.groundtruth.timestamps + (desk.frames[-1].timestamp - 0.002), desk.groundtruth.T_world_cam),
        )
    with pytest.raises(IdRgbdoError, match="got 1 that is within 5 ms of one, for 3 frames"):
        fuse(frames, desk.groundtruth.at(torch.tensor([0])))
    with pytest.raises(IdRgbdoError, match="mesh: no surface"):
        fuse(frames, desk.groundtruth, MeshConfig(depth_max_m=0.1))
    with pytest.raises(IdRgbdoError, match="voxel_m: expected a positive number"):
        MeshConfig(voxel_m=0.0)
