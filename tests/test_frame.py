"""What comes in at the door: images as cameras give them, and one clear error for those in other units."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from rendered import Film

from idrgbdo_torch import IdRgbdo, IdRgbdoError, Pinhole, RgbdFrame, Status, align_pairs, host_points, pick_points

CAMERA = Pinhole(width=8, height=6, fx=8, fy=8, cx=3.5, cy=2.5)
RGB = np.random.default_rng(0).integers(0, 256, (6, 8, 3), dtype=np.uint8)
DEPTH = np.full((6, 8), 1500, dtype=np.uint16)


@pytest.mark.parametrize("tensors", [False, True])
@pytest.mark.parametrize("layout", ["hwc", "chw", "strided"])
def test_a_frame_from_what_a_driver_gives(layout: str, tensors: bool) -> None:
    rgb: Any = {"hwc": RGB, "chw": RGB.transpose(2, 0, 1), "strided": RGB[:, ::-1][:, ::-1]}[layout]
    depth: Any = DEPTH
    if tensors:
        rgb, depth = torch.from_numpy(np.ascontiguousarray(rgb)), torch.from_numpy(DEPTH)
    frame = RgbdFrame.from_images(1.5, rgb, depth, CAMERA, depth_scale=1000)
    assert frame.depth.dtype == torch.float32 and bool((frame.depth == 1.5).all())
    assert frame.color is not None and np.array_equal(frame.color.numpy(), RGB)
    luminance = RGB @ np.array([0.299, 0.587, 0.114])
    np.testing.assert_allclose(frame.gray.numpy(), luminance, atol=1e-3)


def test_float_depth_is_in_metres_and_what_is_none_becomes_0() -> None:
    depth = np.full((6, 8), 2.0)
    depth[0, :4] = np.nan, np.inf, -1.0, 0.0
    frame = RgbdFrame.from_images(0.0, RGB[..., 0], depth, CAMERA)
    assert frame.depth[0].tolist() == [0, 0, 0, 0, 2, 2, 2, 2]
    assert frame.color is not None and frame.color.shape == (6, 8, 3)
    same = RgbdFrame(0.0, frame.gray.numpy(), depth.astype(np.float32), CAMERA)  # type: ignore[arg-type]
    assert torch.equal(same.depth, frame.depth)


@pytest.mark.parametrize("tensors", [False, True])
@pytest.mark.parametrize("kind", [np.uint16, np.int16, np.int32, np.uint32, np.int64])
def test_the_largest_integer_is_unknown_depth(kind: type, tensors: bool) -> None:
    depth: Any = DEPTH.astype(kind)
    depth[0, :2] = 0, np.iinfo(kind).max
    frame = RgbdFrame.from_images(0.0, RGB, torch.from_numpy(depth) if tensors else depth, CAMERA, depth_scale=1000)
    assert frame.depth[0].tolist() == [0, 0, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5]


def test_the_largest_of_a_narrower_type_is_unknown_where_nothing_is_above() -> None:
    wide = DEPTH.astype(np.int32)
    wide[0, 0] = 65535
    assert RgbdFrame.from_images(0.0, RGB, wide, CAMERA, depth_scale=1000).depth[0, 0] == 0
    wide[0, 1] = 70000
    frame = RgbdFrame.from_images(0.0, RGB, wide, CAMERA, depth_scale=1000)
    assert frame.depth[0, :2].tolist() == pytest.approx([65.535, 70])


@pytest.mark.parametrize(
    ("rgb", "depth", "scale", "complaint"),
    [
        (RGB, DEPTH, None, "pass 1000 for millimetres"),
        (RGB / 255, DEPTH, 1000, "expected uint8"),
        (RGB[:3], DEPTH, 1000, "matching camera"),
        (RGB, DEPTH[:3], 1000, "depth: expected a float32"),
        (RGB, DEPTH, 0, "depth_scale: expected"),
    ],
)
def test_images_that_do_not_fit_are_refused(rgb: Any, depth: Any, scale: float | None, complaint: str) -> None:
    with pytest.raises(IdRgbdoError, match=complaint):
        RgbdFrame.from_images(0.0, rgb, depth, CAMERA, depth_scale=scale)


def test_gray_and_times_in_other_units_are_refused_and_darkness_is_not() -> None:
    gray, depth = torch.rand(60, 80), torch.ones(60, 80)
    camera = Pinhole(width=80, height=60, fx=80, fy=80, cx=39.5, cy=29.5)
    with pytest.raises(IdRgbdoError, match="multiply the image by 255"):
        RgbdFrame(0.0, gray, depth, camera)
    with pytest.raises(IdRgbdoError, match="0 to 65535"):
        RgbdFrame(0.0, (65535 * gray).index_put((torch.tensor(0), torch.tensor([0, 1])), torch.tensor([0.0, 65535.0])),
                  depth, camera)  # fmt: skip
    RgbdFrame(0.0, gray * torch.nan, depth, camera)  # a broken image is no other unit: tracking loses it
    with pytest.raises(IdRgbdoError, match="divide milliseconds"):
        RgbdFrame(1612345678000.0, 255 * gray, depth, camera)
    with pytest.raises(IdRgbdoError, match="color: expected"):
        RgbdFrame(0.0, 255 * gray, depth, camera, color=torch.zeros(3, 60, 80, dtype=torch.uint8))
    dark = torch.from_numpy(np.random.default_rng(1).integers(0, 2, (60, 80, 3), dtype=np.uint8))
    RgbdFrame.from_images(0.0, dark, depth, camera)
    RgbdFrame(0.0, 0 * gray, depth, camera)


def test_track_refuses_what_it_cannot_mean(desk: Film) -> None:
    first, second = desk.frames[:2]
    odometry = IdRgbdo()
    far = RgbdFrame(0.0, first.gray, 1000 * first.depth, first.camera)
    with pytest.raises(IdRgbdoError, match="depth: expected metres"):
        odometry.track(far)
    odometry.track(first)
    half = second.camera.at_level(1)
    small = RgbdFrame(second.timestamp, second.gray[::2, ::2], second.depth[::2, ::2], half)
    with pytest.raises(IdRgbdoError, match="camera: expected images of"):
        odometry.track(small)
    holes = second.depth.clone()
    holes[::9, ::7] = torch.nan
    assert odometry.track(RgbdFrame(second.timestamp, second.gray, holes, second.camera)).status is Status.OK


def test_align_pairs_is_ok_for_neighbours_and_never_for_nonsense(desk: Film) -> None:
    frames = desk.frames[:3]
    gray, depth = (
        torch.stack(images)[:, ::2, ::2] for images in zip(*((f.gray, f.depth) for f in frames), strict=True)
    )
    camera = frames[0].camera.at_level(1)
    points = host_points(gray[:-1], *pick_points(gray[:-1], depth[:-1], 80))
    target, z = gray[1:], depth[1:]
    good = align_pairs(points, target, camera, depth=z)
    assert bool(good.ok.all())
    as_arrays = align_pairs(points, target.numpy(), camera, depth=z.numpy())  # type: ignore[arg-type]
    assert torch.equal(as_arrays.T_target_host, good.T_target_host)
    holes = torch.where(z > 0, z, torch.nan)
    assert torch.equal(align_pairs(points, target, camera, depth=holes).T_target_host, good.T_target_host)
    noise = 255 * torch.rand(target.shape, generator=torch.Generator().manual_seed(0))
    torn = target.clone()
    torn[:, 50:60] = torch.nan
    for nonsense in (noise, torch.zeros_like(target), torch.full_like(target, 255.0), target.flip(2), torn):
        assert not bool(align_pairs(points, nonsense, camera).ok.any())
    for wrong, deep, complaint in (
        (target / 255, z, "multiply the image by 255"),
        (target, 1000 * z, "depth: expected metres"),
        (target[:, ::2, ::2], z[:, ::2, ::2], "gray: expected"),
        (target, z[:, ::2, ::2], "depth: expected"),
    ):
        with pytest.raises(IdRgbdoError, match=complaint):
            align_pairs(points, wrong, camera, depth=deep)
    far = host_points(gray[:-1], points.uv, points.inverse_depth / 1000)
    with pytest.raises(IdRgbdoError, match="depth: expected metres"):
        align_pairs(far, target, camera)
