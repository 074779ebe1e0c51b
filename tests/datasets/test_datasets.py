"""Recordings in TUM's layout: real ones, tiny ones made on the spot, and every kind of broken one."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.datasets.calibration import Calibration, find_calibration
from idrgbdo_torch.datasets.published import camera_by_name
from idrgbdo_torch.datasets.rectify import Undistortion
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.frame import BrokenFrame, RgbdFrame

Make = Callable[..., Path]


def truncate(path: Path, share: float = 0.6) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])


def images(folder: Path, kind: str) -> list[Path]:
    return sorted((folder / kind).iterdir())


@pytest.mark.parametrize(
    ("name", "frames", "focal"),
    [
        ("redkitchen_400", 400, 525.0),
        ("tum_fr1_xyz_10", 10, 517.306408),
        ("tum_fr1_desk_9", 9, 517.306408),
        ("tum_fr3_cabinet_58", 58, 535.4),
    ],
)
def test_real_sequences_open_and_read(data_dir: Path, name: str, frames: int, focal: float) -> None:
    sequence = open_sequence(data_dir / name)
    assert (sequence.name, len(sequence), sequence.camera.fx, sequence.warnings) == (name, frames, focal, [])
    assert sequence.groundtruth is not None
    frame = sequence.read(frames - 1)
    assert isinstance(frame, RgbdFrame)
    assert frame.gray.shape == frame.depth.shape == (480, 640)
    assert 0.5 < float(frame.depth[frame.depth > 0].median()) < 4.5
    assert 20 < float(frame.gray.mean()) < 235
    associations = [line.split() for line in (data_dir / name / "associations.txt").read_text().splitlines()]
    assert sequence.timestamps == [float(fields[0]) for fields in associations]


def test_millimetres_read_as_tum_units_are_noticed(data_dir: Path) -> None:
    (warning,) = open_sequence(data_dir / "redwood_5").warnings
    assert "0.372 m" in warning
    assert "1.9 m with 1000 (millimetres): pass that of your camera with --depth-scale" in warning
    assert open_sequence(data_dir / "redwood_5", depth_scale=1000).warnings == []


def test_frames_hold_what_the_files_hold(make_recording: Make) -> None:
    folder = make_recording()
    sequence = open_sequence(folder)
    assert sequence.timestamps == pytest.approx([100 + i / 30 for i in range(4)], abs=1e-6)
    frame = list(sequence)[2]
    assert isinstance(frame, RgbdFrame)
    bgr = cv2.imread(str(images(folder, "rgb")[2]))
    assert bgr is not None
    assert frame.color is not None
    np.testing.assert_array_equal(frame.color.numpy(), bgr[..., ::-1])
    expected = torch.from_numpy(bgr.astype(np.float32)) @ torch.tensor([0.114, 0.587, 0.299])
    torch.testing.assert_close(frame.gray, expected, rtol=0, atol=1e-3)
    assert frame.gray.dtype == frame.depth.dtype == torch.float32
    assert bool((frame.depth[0] == 0).all())
    torch.testing.assert_close(frame.depth[1:], torch.full((47, 64), 1.5), rtol=0, atol=1e-6)


def test_saturated_depth_is_invalid(make_recording: Make) -> None:
    folder = make_recording()
    depth = np.full((48, 64), 7500, np.uint16)
    depth[5, 6] = 65535
    cv2.imwrite(str(images(folder, "depth")[0]), depth)
    frame = open_sequence(folder).read(0)
    assert isinstance(frame, RgbdFrame)
    assert float(frame.depth[5, 6]) == 0
    assert int((frame.depth == 0).sum()) == 1


def test_start_every_and_max_frames_choose_frames(make_recording: Make) -> None:
    folder = make_recording(frames=9)
    whole = open_sequence(folder).timestamps
    assert open_sequence(folder, start=2, every=3, max_frames=2).timestamps == [whole[2], whole[5]]
    with pytest.raises(IdRgbdoError, match="start: expected less than the sequence's 9 frames, got 9"):
        open_sequence(folder, start=9)
    with pytest.raises(IdRgbdoError, match="every: expected at least 1, got 0"):
        open_sequence(folder, every=0)


def test_intrinsics_come_from_the_flag_then_the_folder_then_its_name(make_recording: Make, tmp_path: Path) -> None:
    folder = make_recording("rgbd_dataset_freiburg2_thing", calibration="60 61 31 23")
    camera = tmp_path / "camera.toml"
    camera.write_text("fx = 70\nfy = 71\ncx = 32\ncy = 24\ndepth_scale = 2500")
    sequence = open_sequence(folder, camera=camera)
    assert (sequence.camera.fx, sequence.camera.fy, sequence.camera.cx, sequence.camera.cy) == (70, 71, 32, 24)
    frame = sequence.read(0)
    assert isinstance(frame, RgbdFrame)
    assert float(frame.depth.max()) == 3.0
    assert find_calibration(folder) == Calibration(60, 61, 31, 23)
    (folder / "calibration.txt").unlink()
    with pytest.raises(IdRgbdoError, match="calibrated for 640x480"):  # its name's
        open_sequence(folder)
    for name, focal in (("my_fr1_room", 517.306408), ("freiburg3_long_office", 535.4)):
        known = camera_by_name(tmp_path / name)
        assert known is not None and known.fx == focal


@pytest.mark.parametrize(
    ("text", "complaint"),
    [("60 60 31", "got 3 numbers"), ("60 60 31 x", "got text"), ("0 60 31 23", "fx: expected a number above 0")],
)
def test_wrong_calibration_files_are_refused(make_recording: Make, text: str, complaint: str) -> None:
    with pytest.raises(IdRgbdoError, match=r"calibration\.txt: ") as caught:
        open_sequence(make_recording(calibration=text))
    assert complaint in str(caught.value)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("fx = 60\nfy = 60\ncx = 31", "cy: expected the camera's value in pixels, got none"),
        ("fx = 60\nfy = 60\ncx = 31\ncy = 23\nwidth = 640", "calibrated for 640x48, but the images are 64x48"),
        ("focal = 60", "focal: no such key"),
    ],
)
def test_wrong_camera_files_are_refused(make_recording: Make, tmp_path: Path, text: str, complaint: str) -> None:
    camera = tmp_path / "camera.toml"
    camera.write_text(text)
    with pytest.raises(IdRgbdoError) as caught:
        open_sequence(make_recording(), camera=camera)
    assert complaint in str(caught.value)


def test_distorted_images_become_pinhole_images() -> None:
    """A picture of a smooth scene through a distorting lens, undistorted, is the picture of the pinhole."""
    calibration = Calibration(fx=200, fy=210, cx=160, cy=118, k1=0.26, k2=-0.95, p1=-0.005, p2=0.003, k3=1.16)
    camera = calibration.pinhole(320, 240)
    v, u = np.mgrid[0:240, 0:320].astype(np.float64)

    def scene(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 128 + 60 * np.sin(9 * x + 1) + 50 * np.cos(8 * y - 2 * x)

    seen_x, seen_y = (u - 160) / 200, (v - 118) / 210
    x, y = seen_x, seen_y
    k1, k2, p1, p2, k3 = calibration.distortion[:5]
    for _ in range(200):  # invert the radial-tangential model by fixed point
        r2 = x**2 + y**2
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        dx, dy = 2 * p1 * x * y + p2 * (r2 + 2 * x**2), p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
        x, y = (seen_x - dx) / radial, (seen_y - dy) / radial
    distorted = np.rint(scene(x, y)).astype(np.uint8)
    expected = scene(seen_x, seen_y)
    undistortion = Undistortion(calibration, camera)
    color = undistortion.color(np.repeat(distorted[..., None], 3, axis=2))
    inner = np.s_[20:-20, 20:-20]
    assert np.abs(color[..., 0] - expected)[inner].max() < 3
    assert np.abs(distorted - expected)[inner].max() > 20  # so the distortion matters here
    depth = distorted.astype(np.float32) + 1000
    remapped = undistortion.depth(depth)
    assert set(np.unique(remapped)) <= {0, *np.unique(depth)}  # nearest neighbour invents nothing
    assert np.abs(remapped - 1000.0 - expected)[inner].max() < 6


def test_no_such_folder(tmp_path: Path) -> None:
    with pytest.raises(IdRgbdoError, match=r"expected a folder at '.*nowhere', found nothing"):
        open_sequence(tmp_path / "nowhere")


@pytest.mark.parametrize("name", ["rgb.txt", "depth.txt"])
def test_no_list(make_recording: Make, name: str) -> None:
    folder = make_recording()
    (folder / name).unlink()
    with pytest.raises(IdRgbdoError, match=f"has no {name}"):
        open_sequence(folder)


def test_no_pair_within_the_limit_says_how_far_apart(make_recording: Make) -> None:
    folder = make_recording(frames=1, depth_delay_s=0.25)
    with pytest.raises(IdRgbdoError, match=r"within 0\.02 s of each other, the closest two are 0\.250 s apart"):
        open_sequence(folder)
    assert len(open_sequence(folder, association_limit_s=0.3)) == 1


def test_associations_may_be_given(make_recording: Make) -> None:
    folder = make_recording(depth_delay_s=0.25)
    rows = [
        f"{d.stem} depth/{d.name} {c.stem} rgb/{c.name}"
        for c, d in zip(images(folder, "rgb"), images(folder, "depth"), strict=True)
    ]
    (folder / "pairs.txt").write_text("\n".join(rows[:3]))
    sequence = open_sequence(folder, associations=folder / "pairs.txt")
    assert sequence.timestamps == [float(path.stem) for path in images(folder, "rgb")[:3]]
    assert all(isinstance(frame, RgbdFrame) for frame in sequence)


def test_associations_alone_will_do(make_recording: Make) -> None:
    folder = make_recording()
    pairs = zip(images(folder, "rgb"), images(folder, "depth"), strict=True)
    rows = [f"{c.stem} rgb/{c.name} {d.stem} depth/{d.name}" for c, d in pairs]
    (folder / "associations.txt").write_text("\n".join(rows))
    expected = open_sequence(folder).timestamps
    for name in ("rgb.txt", "depth.txt"):
        (folder / name).unlink()
    sequence = open_sequence(folder)
    assert sequence.recognised.startswith(
        "TUM RGB-D layout: 4 frames of 64x48, 5000 depth values per metre (the format's default), with "
    )
    assert sequence.timestamps == expected


def test_unknown_intrinsics(make_recording: Make) -> None:
    with pytest.raises(IdRgbdoError, match=r"unknown intrinsics .* --camera F\.toml"):
        open_sequence(make_recording(calibration=None))


@pytest.mark.parametrize("kind", ["rgb", "depth"])
def test_truncated_pngs_only_are_an_error(make_recording: Make, kind: str) -> None:
    folder = make_recording()
    for path in images(folder, kind):
        truncate(path)
    with pytest.raises(IdRgbdoError, match=r"100\.\d+\.png: truncated PNG"):
        open_sequence(folder)


def test_a_broken_first_frame_costs_that_frame(make_recording: Make) -> None:
    folder = make_recording(frames=3)
    truncate(images(folder, "rgb")[0])
    sequence = open_sequence(folder)
    assert sequence.camera.width == 64
    assert [type(frame) for frame in sequence] == [BrokenFrame, RgbdFrame, RgbdFrame]


def test_colour_and_depth_of_different_sizes(make_recording: Make) -> None:
    folder = make_recording()
    for path in images(folder, "depth"):
        cv2.imwrite(str(path), np.ones((24, 32), np.uint16))
    with pytest.raises(IdRgbdoError, match="expected depth of the colour image's size 64x48, got 32x24"):
        open_sequence(folder)


def test_colour_in_place_of_depth(make_recording: Make) -> None:
    folder = make_recording()
    for path in images(folder, "depth"):
        cv2.imwrite(str(path), np.arange(48 * 64 * 3, dtype=np.uint32).reshape(48, 64, 3).astype(np.uint8))
    with pytest.raises(IdRgbdoError, match="expected a 16-bit depth image of one channel, got uint8 with 3"):
        open_sequence(folder)


def test_a_depth_image_without_any_depth_is_noticed(make_recording: Make) -> None:
    (warning,) = open_sequence(make_recording(depth_m=0)).warnings
    assert "no valid depth" in warning


def break_frame_2(folder: Path, how: str) -> None:
    """Damage the files of one frame in one way."""
    color, depth = images(folder, "rgb")[2], images(folder, "depth")[2]
    if how == "truncated":
        truncate(color)
    elif how == "last byte missing":
        color.write_bytes(color.read_bytes()[:-1])
    elif how == "flipped bit":
        data = bytearray(depth.read_bytes())
        data[len(data) // 2] ^= 4
        depth.write_bytes(data)
    elif how == "missing":
        depth.unlink()
    elif how == "empty":
        depth.write_bytes(b"")
    elif how == "text":
        depth.write_text("not an image")
    else:
        for path, shape in ((color, (24, 32, 3)), (depth, (24, 32))):
            cv2.imwrite(str(path), np.ones(shape, np.uint8 if len(shape) == 3 else np.uint16))


@pytest.mark.parametrize(
    ("how", "reason"),
    [
        ("truncated", "truncated PNG"),
        ("last byte missing", "truncated PNG"),
        ("flipped bit", "damaged PNG"),
        ("missing", "No such file"),
        ("empty", "empty image file"),
        ("text", "that OpenCV can decode"),
        ("smaller", r"image of shape \(24, 32\), where most have \(48, 64\)"),
    ],
)
def test_a_broken_frame_in_the_middle_costs_that_frame(make_recording: Make, how: str, reason: str) -> None:
    folder = make_recording()
    break_frame_2(folder, how)
    frames = list(open_sequence(folder))
    assert [type(frame) for frame in frames] == [RgbdFrame, RgbdFrame, BrokenFrame, RgbdFrame]
    broken = frames[2]
    assert isinstance(broken, BrokenFrame)
    assert re.search(reason, broken.reason)


def test_truncated_jpeg_is_broken(make_recording: Make) -> None:
    folder = make_recording(frames=3)
    lines = []
    for path in images(folder, "rgb"):
        image = cv2.imread(str(path))
        assert image is not None
        cv2.imwrite(str(path.with_suffix(".jpg")), image)
        lines.append(f"{path.stem} rgb/{path.stem}.jpg")
    (folder / "rgb.txt").write_text("\n".join(lines))
    truncate(folder / "rgb" / f"{lines[1].split()[0]}.jpg")
    good, broken, last = open_sequence(folder)
    assert isinstance(good, RgbdFrame)
    assert isinstance(broken, BrokenFrame)
    assert "truncated JPEG" in broken.reason
    assert isinstance(last, RgbdFrame)


def test_list_errors_name_the_line(make_recording: Make) -> None:
    folder = make_recording()
    (folder / "rgb.txt").write_text("# images\n100.0 rgb/a.png extra\n")
    with pytest.raises(IdRgbdoError, match=r"rgb\.txt, line 2: expected `timestamp file`, got 3 fields"):
        open_sequence(folder)
    (folder / "rgb.txt").write_text("# images\nnoon rgb/a.png\n")
    with pytest.raises(IdRgbdoError, match=r"rgb\.txt, line 2: expected a timestamp, got 'noon'"):
        open_sequence(folder)
    (folder / "rgb.txt").write_text("# images\n")
    with pytest.raises(IdRgbdoError, match="lists no image"):
        open_sequence(folder)
