"""The map: points where their keyframes saw them, in the world, and never more than a limit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from idrgbdo_torch import IdRgbdo, Status
from idrgbdo_torch.config import Config
from idrgbdo_torch.definitions import se3
from idrgbdo_torch.definitions.camera import Pinhole, project
from idrgbdo_torch.frame import Keyframe, RgbdFrame, prepare
from idrgbdo_torch.kernels import selection as choice
from idrgbdo_torch.measurement import tracked_noise
from idrgbdo_torch.tracker.backends import backend_named
from idrgbdo_torch.tracker.keyframe import make_keyframe
from idrgbdo_torch.tracker.mapping import (
    Cloud,
    condense,
    keyframe_cloud,
    merge_in_voxels,
    surface_normals,
    world_cloud,
    write_ply,
)
from idrgbdo_torch.tracker.open3d_loader import load_open3d
from idrgbdo_torch.tracker.selection import point_bits

FUSED = backend_named("fused")
CAMERA = Pinhole(width=160, height=120, fx=130.0, fy=128.0, cx=80.5, cy=58.0)


def wall_frame(x_m: float = 0.0, timestamp: float = 0.0, color: bool = True) -> RgbdFrame:
    """A checked wall 2 m ahead, seen by a camera x_m to the right of the origin."""
    u = np.arange(CAMERA.width)[None, :]
    v = np.arange(CAMERA.height)[:, None]
    x = (u - CAMERA.cx) / CAMERA.fx * 2.0 + x_m
    y = (v - CAMERA.cy) / CAMERA.fy * 2.0
    squares = np.tanh(8 * np.sin(11 * x)) * np.tanh(8 * np.sin(13 * y))
    gray = (120 + 60 * squares + 10 * np.sin(3 * x + 2 * y)).astype(np.float32)
    rgb = np.stack([gray, np.full_like(gray, 30), 255 - gray], axis=-1).astype(np.uint8)
    return RgbdFrame(
        timestamp=timestamp,
        gray=torch.from_numpy(gray),
        depth=torch.full((CAMERA.height, CAMERA.width), 2.0),
        camera=CAMERA,
        color=torch.from_numpy(rgb) if color else None,
    )


def wall_keyframe(color: bool = True) -> Keyframe:
    return make_keyframe(prepare(wall_frame(color=color)), Config(), np.random.default_rng(0), FUSED)


def scattered(n: int, seed: int = 0) -> Cloud:
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(n, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    xyz, rgb = rng.uniform(-1, 1, (n, 3)).astype(np.float32), rng.integers(0, 256, (n, 3), dtype=np.uint8)
    return Cloud(xyz, rgb, normal.astype(np.float32))


def poses(n: int) -> list[np.ndarray]:
    twists = torch.from_numpy(np.random.default_rng(3).uniform(-1, 1, (n, 6)))
    return list(se3.exp(twists).numpy())


def test_a_keyframes_points_project_to_where_they_were_seen_in_their_colour() -> None:
    keyframe = wall_keyframe()
    cloud = keyframe_cloud(keyframe)
    assert len(cloud) == len(keyframe.points.uv) > 50
    uv, valid = project(CAMERA, torch.from_numpy(cloud.xyz))
    assert valid.all()
    np.testing.assert_allclose(uv.numpy(), keyframe.points.uv, atol=1e-3)
    np.testing.assert_allclose(cloud.xyz[:, 2], 2.0, atol=1e-5)
    np.testing.assert_array_equal(cloud.origins()[:, 1:], keyframe.points.uv)
    assert (cloud.origins()[:, 0] == keyframe.frame.timestamp).all()
    column, row = keyframe.points.uv.astype(int).T
    assert keyframe.frame.color is not None
    np.testing.assert_array_equal(cloud.rgb, keyframe.frame.color.numpy()[row, column])


def test_normals_look_back_from_the_surface_and_stop_at_its_edge() -> None:
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(float)
    n = np.array([0.3, -0.2, -1.0])
    n /= np.linalg.norm(n)
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones_like(u)], axis=-1)
    depth = (-2.0 / (rays @ n)).astype(np.float32)  # the plane n . P = -2 m
    depth[:, 100:] *= 0.5
    depth[50, 60] = 0.0
    row, column = np.array([60, 20, 60, 50, 1]), np.array([40, 130, 98, 57, 40])
    normal = surface_normals(depth, CAMERA, row, column)
    np.testing.assert_allclose(normal[:2], [n, n], atol=1e-4)
    np.testing.assert_array_equal(normal[2:4], 0.0)  # beside the jump, beside the hole
    np.testing.assert_allclose(normal[4], n, atol=1e-4)  # at the border one neighbour is nearer


def test_open3d_reads_the_point_cloud_back(tmp_path: Path) -> None:
    cloud = scattered(17)
    write_ply(tmp_path / "map.ply", cloud)
    back = load_open3d().io.read_point_cloud(str(tmp_path / "map.ply"))
    np.testing.assert_allclose(np.asarray(back.points), cloud.xyz)
    np.testing.assert_allclose(np.asarray(back.normals), cloud.normal)
    np.testing.assert_allclose(np.asarray(back.colors) * 255, cloud.rgb, atol=1e-6)


def test_refined_inverse_depths_move_points_and_impossible_ones_are_left_out() -> None:
    keyframe = wall_keyframe()
    inv_depth = keyframe.points.inv_depth.copy()
    inv_depth[0], inv_depth[1] = 0.8, -0.1
    cloud = keyframe_cloud(replace(keyframe, points=keyframe.points._replace(inv_depth=inv_depth)))
    assert len(cloud) == len(inv_depth) - 1
    assert cloud.xyz[0, 2] == pytest.approx(1 / 0.8)


def test_without_colour_a_point_is_gray() -> None:
    keyframe = wall_keyframe(color=False)
    cloud = keyframe_cloud(keyframe)
    column, row = keyframe.points.uv.astype(int).T
    expected = keyframe.frame.images[0][row, column].astype(np.uint8)
    np.testing.assert_array_equal(cloud.rgb, np.repeat(expected[:, None], 3, axis=1))


def test_clouds_are_laid_into_the_world_by_their_keyframes_poses() -> None:
    clouds, T_kf_world = [scattered(5, 1), scattered(7, 2)], poses(2)
    world = world_cloud(clouds, T_kf_world)
    expected = [
        se3.transform(se3.inverse(torch.from_numpy(T)), torch.from_numpy(cloud.xyz).double())
        for cloud, T in zip(clouds, T_kf_world, strict=True)
    ]
    np.testing.assert_allclose(world.xyz, torch.cat(expected).numpy(), atol=1e-6)
    np.testing.assert_array_equal(world.rgb, np.concatenate([cloud.rgb for cloud in clouds]))
    turned = [cloud.normal @ T[:3, :3] for cloud, T in zip(clouds, T_kf_world, strict=True)]
    np.testing.assert_allclose(world.normal, np.concatenate(turned), atol=1e-6)
    assert len(world_cloud([], [])) == 0


def test_a_voxel_keeps_the_mean_of_its_points_and_colours() -> None:
    xyz = np.array([[0.0, 0, 0], [0.1, 0, 0], [5.0, 0, 0]], np.float32)
    rgb = np.array([[10, 0, 200], [20, 0, 100], [7, 8, 9]], np.uint8)
    normal = np.array([[0, 0, -1], [0, -1, 0], [0, 0, 0]], np.float32)
    merged = merge_in_voxels(Cloud(xyz, rgb, normal), 1.0)
    order = np.argsort(merged.xyz[:, 0])
    np.testing.assert_allclose(merged.xyz[order], [[0.05, 0, 0], [5.0, 0, 0]], atol=1e-6)
    np.testing.assert_array_equal(merged.rgb[order], [[15, 0, 150], [7, 8, 9]])
    np.testing.assert_allclose(merged.normal[order], [[0, -(0.5**0.5), -(0.5**0.5)], [0, 0, 0]], atol=1e-6)


def test_below_the_limit_nothing_changes() -> None:
    clouds = [scattered(50), scattered(50)]
    assert condense(clouds, poses(2), [], limit=100) is clouds
    assert condense(clouds, poses(2), [0, 1], limit=10) is clouds  # all may still move


def test_above_the_limit_settled_points_merge_in_place_and_moving_ones_stay() -> None:
    clouds, T_kf_world = [scattered(400, seed) for seed in range(4)], poses(4)
    before = world_cloud(clouds, T_kf_world)
    out = condense(clouds, T_kf_world, [0, 3], limit=1000)
    assert [len(cloud) for cloud in out][2] == 0
    assert 0 < len(out[1]) <= 500
    assert out[0] is clouds[0]
    assert out[3] is clouds[3]
    after = world_cloud(out[1:2], T_kf_world[1:2])
    originals = before.xyz[400:1200]
    distance = np.linalg.norm(after.xyz[:, None] - originals[None], axis=-1).min(axis=1)
    assert distance.max() < 0.3  # a mean of points of one voxel
    np.testing.assert_allclose(after.xyz.mean(axis=0), originals.mean(axis=0), atol=0.05)


def test_memory_stays_bounded_however_many_keyframes_come() -> None:
    clouds: list[Cloud] = []
    T_kf_world = poses(30)
    most = 0
    for number in range(30):
        clouds = condense([*clouds, scattered(300, number)], T_kf_world[: number + 1], [number], limit=2000)
        most = max(most, sum(map(len, clouds)))
    assert most <= 2000 + 300
    assert len(clouds) == 30


@pytest.mark.parametrize("window", [True, False])
def test_the_map_of_a_run_lies_on_the_wall(window: bool) -> None:
    config = Config()
    config = replace(
        config,
        window=replace(config.window, enabled=window),
        keyframe=replace(config.keyframe, threshold_bits=0.02),
        selection=replace(config.selection, margin=8.0),
    )
    odometry = IdRgbdo(config)
    for index in range(12):
        result = odometry.track(wall_frame(0.01 * index, index / 30))
    assert len(odometry.history.keyframe_poses) > 1
    points, colors = odometry.map_points()
    assert len(points) == len(colors) > 100
    assert points.dtype == torch.float32
    assert colors.dtype == torch.uint8
    assert (points[:, 2] - 2.0).abs().median() < 0.005
    uv, bits = odometry.last_points()
    assert len(uv) == len(bits) > 10
    assert (bits > 0).all()
    assert result.points <= len(uv)
    assert ((uv >= 0) & (uv <= torch.tensor([CAMERA.width - 1, CAMERA.height - 1]))).all()


def test_the_bits_of_a_point_are_what_would_be_lost_without_it() -> None:
    keyframe = wall_keyframe()
    index = np.arange(0, len(keyframe.points.uv), 5)
    noise = tracked_noise(Config())
    uv, bits = point_bits(keyframe, np.eye(4), index, noise, FUSED)
    np.testing.assert_allclose(uv.numpy(), keyframe.points.uv[index])
    cam = keyframe.frame.intrinsics[0]
    rows, _, _ = choice.whitened_rows(cam, CAMERA.width, CAMERA.height, 0.0, keyframe.points, index, np.eye(4), noise)
    each = rows.transpose(0, 2, 1) @ rows  # (M, 6, 6)
    everything = each.sum(axis=0)
    for number in (0, 7, len(index) - 1):
        without = np.linalg.slogdet(everything - each[number]).logabsdet
        expected = 0.5 * (np.linalg.slogdet(everything).logabsdet - without) / np.log(2)
        assert float(bits[number]) == pytest.approx(expected, rel=1e-3)


def test_a_frame_that_is_lost_has_no_points() -> None:
    odometry = IdRgbdo()
    odometry.track(wall_frame())
    assert len(odometry.last_points()[0]) == 0  # the first frame is tracked against nothing
    frame = wall_frame(timestamp=0.1)
    elsewhere = replace(frame, gray=frame.gray.flip(0), depth=0.3 * frame.depth)
    assert odometry.track(elsewhere).status is Status.LOST
    assert len(odometry.last_points()[1]) == 0
