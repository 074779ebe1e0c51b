"""Every format: the same rendered film, written as the format's documentation says, gives the known trajectory."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import format_writers
import numpy as np
import pytest
import torch
from rendered import SMALL, Film, rotation_deg

from idrgbdo_torch import IdRgbdo
from idrgbdo_torch.commands import cli
from idrgbdo_torch.commands import input as options
from idrgbdo_torch.datasets import FORMATS, RgbdSequence, guess, open_sequence
from idrgbdo_torch.datasets.builder import FrameBuilder
from idrgbdo_torch.datasets.calibration import Calibration, DepthCamera, find_calibration, scaled
from idrgbdo_torch.datasets.published import BONN, ICL_NUIM, camera_by_name
from idrgbdo_torch.datasets.rectify import Registration
from idrgbdo_torch.datasets.seven_scenes import KINECT
from idrgbdo_torch.definitions.se3 import inverse
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.evaluation import evaluate
from idrgbdo_torch.frame import BrokenFrame, RgbdFrame
from idrgbdo_torch.odometry import Status, run
from idrgbdo_torch.synthetic import RenderedSequence
from idrgbdo_torch.synthetic.sensor import measure

ATE_LIMIT_M = 0.01
BROKEN = 7

WRITERS: dict[str, tuple[str, Callable[[Film, Path], format_writers.Files]]] = {
    "tum": ("tum", format_writers.tum),
    "icl_png": ("icl_nuim", format_writers.icl_png),
    "icl_povray": ("icl_nuim", format_writers.icl_povray),
    "redwood": ("redwood", format_writers.redwood),
    "replica": ("replica", format_writers.replica),
    "scannet": ("scannet", format_writers.scannet),
    "folder": ("folder", format_writers.own_folder),
}


@pytest.fixture(scope="session")
def film(desk: Film) -> Film:
    """30 frames of the rendered desk."""
    return Film(desk.frames[:30], desk.groundtruth.at(torch.arange(30)))


@pytest.fixture(scope="session")
def small_7scenes(film: Film) -> tuple[list[np.ndarray], Calibration]:
    """Depth in millimetres of a camera of its own 2.6 cm beside the colour camera, and the calibration of both."""
    K, d = KINECT, KINECT.depth
    assert d.fx is not None and d.fy is not None
    camera = film.frames[0].camera
    calibration = Calibration(
        *(camera.fx, camera.fy, camera.cx, camera.cy),
        depth=DepthCamera(d.fx / 2, d.fy / 2, 159.5, 119.5, K.depth.T_color_depth),
    )
    T = calibration.T_color_depth()
    beside = RenderedSequence(replace(SMALL, fx=d.fx / 2, fy=d.fy / 2))
    depths = []
    for index in range(len(film.frames)):
        pose = beside._pose(beside.timestamps[index]) @ T
        raw = measure(beside.renderer.depth(pose), SMALL.sensor, np.random.default_rng([1, index]))
        depths.append((raw // 5).astype(np.uint16))
    return depths, calibration


def same_motion(sequence: RgbdSequence, film: Film) -> bool:
    """Whether the loader's reference has the film's motion between its first and its last pose."""
    truth = sequence.groundtruth
    assert truth is not None
    ends = truth.timestamps[[0, -1]].tolist()
    numbers = [round((time - sequence.timestamps[0]) * 30) for time in ends]
    expected = film.T(*numbers)
    difference = inverse(expected) @ (inverse(truth.T_world_cam[0]) @ truth.T_world_cam[-1])
    return float(difference[:3, 3].norm()) < 1e-5 and rotation_deg(difference) < 0.05


def check_trajectory(sequence: RgbdSequence, film: Film) -> None:
    """Track it: no frame is lost, and the path is the known one, by the loader's reference and by the film's."""
    assert len(sequence) == len(film.frames)
    assert sequence.warnings == []
    frame = sequence.read(9)
    assert isinstance(frame, RgbdFrame)
    known = (frame.depth > 0) & (film.frames[9].depth > 0)
    assert float((frame.depth - film.frames[9].depth)[known].abs().median()) < 0.01
    assert float((frame.gray - film.frames[9].gray).abs().median()) < 4  # JPEG; resized
    done = run(IdRgbdo(), sequence)
    assert Status.LOST not in done.statuses
    estimate = done.trajectory()
    assert sequence.groundtruth is not None
    assert same_motion(sequence, film)
    assert evaluate(estimate, sequence.groundtruth).ate.rmse_m <= ATE_LIMIT_M
    shifted = replace(film.groundtruth, timestamps=estimate.timestamps)
    assert evaluate(estimate, shifted).ate.rmse_m <= ATE_LIMIT_M


def lose_one(sequence: RgbdSequence, reason: str) -> None:
    """One frame is broken, and tracking goes on behind it."""
    frames = list(sequence)
    broken = [index for index, frame in enumerate(frames) if isinstance(frame, BrokenFrame)]
    assert broken == [BROKEN]
    lost = frames[BROKEN]
    assert isinstance(lost, BrokenFrame)
    assert reason in lost.reason
    statuses = run(IdRgbdo(), frames[:12]).statuses
    assert [index for index, status in enumerate(statuses) if status is Status.LOST] == [BROKEN]


@pytest.mark.parametrize("kind", WRITERS)
def test_the_known_trajectory_comes_out(kind: str, film: Film, tmp_path: Path) -> None:
    name, write = WRITERS[kind]
    folder = tmp_path / "room" / "take1"
    write(film, folder)
    assert guess(folder) == name
    check_trajectory(open_sequence(folder), film)


@pytest.mark.parametrize("which", [0, 1], ids=["colour", "depth"])
@pytest.mark.parametrize("kind", WRITERS)
def test_one_broken_file_costs_one_frame(kind: str, which: int, film: Film, tmp_path: Path) -> None:
    name, write = WRITERS[kind]
    files = write(Film(film.frames[:12], film.groundtruth), tmp_path / "take1")
    path = files(BROKEN)[which]
    path.write_bytes(path.read_bytes()[:300])
    lose_one(open_sequence(tmp_path / "take1", format=name), "download it again")


def test_7scenes_is_registered(film: Film, small_7scenes: tuple[list[np.ndarray], Calibration], tmp_path: Path) -> None:
    depths, calibration = small_7scenes
    folder = tmp_path / "redkitchen" / "seq-01"
    files = format_writers.seven_scenes(film, folder, depths, calibration.T_color_depth())
    d = calibration.depth
    rows = [list(row) for row in d.T_color_depth]
    extra = f"[depth]\nfx = {d.fx}\nfy = {d.fy}\ncx = {d.cx}\ncy = {d.cy}\nT_color_depth = {rows}\n"
    format_writers.camera_toml(film, folder, extra)
    sequence = open_sequence(folder)
    assert (guess(folder), sequence.name) == ("7scenes", "redkitchen_seq-01")
    check_trajectory(sequence, film)
    frame = sequence.read(3)
    assert isinstance(frame, RgbdFrame)
    inner = np.s_[40:-40, 50:-50]  # the depth camera's view is narrower
    share, expected = (float((depth[inner] > 0).float().mean()) for depth in (frame.depth, film.frames[3].depth))
    assert share > 0.9 * expected
    path = files(BROKEN)[1]
    path.write_bytes(path.read_bytes()[:300])
    lose_one(open_sequence(folder, max_frames=12), "truncated PNG")


def test_7scenes_without_a_camera_file_has_the_published_cameras(tmp_path: Path) -> None:
    for kind, image in (
        ("color", np.full((480, 640, 3), 99, np.uint8)),
        ("depth", np.full((480, 640), 1500, np.uint16)),
    ):
        format_writers.save(tmp_path / "seq-03" / f"frame-000000.{kind}.png", image)
    sequence = open_sequence(tmp_path / "seq-03")
    frame = sequence.read(0)
    assert isinstance(frame, RgbdFrame)
    assert (sequence.camera.fx, sequence.groundtruth) == (525.0, None)
    inner = frame.depth[80:400, 100:540]
    assert float((inner > 0).float().mean()) > 0.999  # no holes
    tilt = np.array(KINECT.depth.T_color_depth)[2]  # z of a point on the wall in the colour camera
    u = (400 - 320 + 525 * 0.0256 / 1.5) / 525  # near enough
    assert float(frame.depth[240, 400]) == pytest.approx(1.5 * (tilt[0] * u + tilt[2]) + tilt[3], abs=2e-3)


def test_registration_agrees_with_rendering_and_leaves_no_holes_where_depth_is_coarser() -> None:
    """A slanted plane seen by a depth camera of half the resolution, with a step in front of it."""
    color = Calibration(500, 500, 159.5, 119.5)
    T = ((1.0, 0, 0, -0.05), (0, 1.0, 0, 0.01), (0, 0, 1.0, 0.0))
    calibration = replace(color, depth=DepthCamera(200, 200, 79.5, 59.5, T))
    v, u = np.indices((120, 160))
    plane = (1 / (0.5 + 0.1 * (u - 79.5) / 200)).astype(np.float32)  # z (0.5 + 0.1 x/z) = 1
    depth = np.where((np.abs(u - 60) < 10) & (np.abs(v - 60) < 10), np.float32(0.8), plane)
    depth[:, :3] = 0
    registered = Registration(calibration, color.pinhole(320, 240)).depth(depth)
    v, u = np.indices((240, 320))
    x = (u - 159.5) / 500
    expected = (1 - 0.1 * 0.05) / (0.5 + 0.1 * x)  # the depth camera's x is the colour camera's plus 0.05
    centre_u = 159.5 + 500 * ((60 - 79.5) / 200 * 0.8 - 0.05) / 0.8
    centre_v = 119.5 + 500 * ((60 - 59.5) / 200 * 0.8 + 0.01) / 0.8
    box = (np.abs(u - centre_u) < 22) & (np.abs(v - centre_v) < 22)
    near = (np.abs(u - centre_u) < 60) & (np.abs(v - centre_v) < 30)
    assert np.allclose(registered[box], 0.8, atol=1e-6)
    background = ~near & (u > 30) & (u < 290) & (v > 20) & (v < 220)
    assert (registered[background] > 0).mean() == 1
    errors = (registered - expected)[background]
    assert np.abs(errors).max() < 0.0025
    assert abs(errors.mean()) < 0.0003  # no shift by a part of a pixel


def test_cameras_in_one_place_are_registered_by_a_map() -> None:
    calibration = replace(Calibration(100, 100, 31.5, 23.5), depth=DepthCamera(50, 50, 15.5, 11.5))
    depth = np.arange(24 * 32, dtype=np.float32).reshape(24, 32) + 1
    registered = Registration(calibration, calibration.pinhole(64, 48)).depth(depth)
    assert registered.shape == (48, 64)
    np.testing.assert_array_equal(registered[2:-2:2, 2:-2:2].ravel()[:3], depth[1:-1, 1:-1].ravel()[:3])


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("[depth]\nfx = 500", "[depth]: expected fx, fy, cx and cy"),
        ("[depth]\nfx=9\nfy=9\ncx=9\ncy=9\nT_color_depth=[[1,0,0]]", "expected 3 or 4 rows of 4"),
        (
            "[depth]\nfx=9\nfy=9\ncx=9\ncy=9\nT_color_depth=[[1,0,0,-32.0],[0,1,0,-2.1],[0,0,1,4]]",
            "expected a translation in metres, of at most 2, got -32, -2.1, 4; divide it by 1000",
        ),
        ("[depth]\nfx=9\nfy=9\ncx=9\ncy=9\nT_color_depth=[[2,0,0,0],[0,1,0,0],[0,0,1,0]]", "expected a rotation"),
    ],
)
def test_wrong_depth_cameras_are_refused(make_recording: Callable[..., Path], text: str, complaint: str) -> None:
    folder = make_recording(calibration=None)
    (folder / "camera.toml").write_text("fx = 60\nfy = 60\ncx = 31.5\ncy = 23.5\n" + text)
    with pytest.raises(IdRgbdoError) as caught:
        open_sequence(folder)
    assert complaint in str(caught.value)


def test_registered_depth_of_a_lens_that_distorts_is_not_undistorted_twice() -> None:
    calibration = Calibration(60, 60, 31.5, 23.5, k1=0.4, depth=DepthCamera(60, 60, 31.5, 23.5))
    color = np.random.default_rng(5).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    depth = np.arange(48 * 64, dtype=np.uint16).reshape(48, 64) + 500
    frame = FrameBuilder(calibration, color, 1000.0).frame(0.0, color, depth)
    np.testing.assert_allclose(frame.depth.numpy(), depth / 1000, rtol=1e-6)
    assert frame.color is not None
    assert not np.array_equal(frame.color.numpy()[..., ::-1], color)


def test_published_cameras_are_known_by_name(tmp_path: Path) -> None:
    assert camera_by_name(tmp_path / "rgbd_bonn_balloon") is BONN
    for name in ("living_room_traj2_frei_png", "traj0_frei_png", "lr_kt1", "ICL-NUIM_office"):
        assert camera_by_name(tmp_path / name) is ICL_NUIM
    assert camera_by_name(tmp_path / "kitchen_trajectory_2") is None


def test_a_camera_scales_with_its_images() -> None:
    half = scaled(Calibration(1000, 1000, 639.5, 479.5, 0.1, width=1280, height=960), (1280, 960), (640, 480))
    assert (half.fx, half.fy, half.cx, half.cy, half.k1, half.width) == (500, 500, 319.5, 239.5, 0.1, None)


def test_intrinsics_of_larger_images_are_noticed(make_recording: Callable[..., Path]) -> None:
    with pytest.raises(IdRgbdoError, match=r"principal point inside the images of 64x48, got cx=319\.5"):
        open_sequence(make_recording(calibration="525 525 319.5 239.5"))


def test_the_scannet_frame_without_pose_has_no_reference(film: Film, tmp_path: Path) -> None:
    format_writers.scannet(Film(film.frames[:8], film.groundtruth), tmp_path / "scene")
    sequence = open_sequence(tmp_path / "scene")
    assert sequence.groundtruth is not None
    assert len(sequence.groundtruth) == 7
    (tmp_path / "scene" / "intrinsic" / "extrinsic_depth.txt").write_text("1 0 0 0.03\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    (warning,) = open_sequence(tmp_path / "scene").warnings
    assert "stand apart" in warning


def test_redwood_without_intrinsics_has_the_usual_camera(tmp_path: Path) -> None:
    for number in (3, 4):
        format_writers.save(tmp_path / "r" / "rgb" / f"{number:05}.jpg", np.full((480, 640, 3), 9, np.uint8))
        format_writers.save(tmp_path / "r" / "depth" / f"{number:05}.png", np.full((480, 640), 1500, np.uint16))
    (tmp_path / "r" / "trajectory.log").write_text(
        "".join(f"{i} {i} {i + 1}\n1 0 0 {i}\n0 1 0 0\n0 0 1 0\n0 0 0 1\n" for i in range(2))
    )
    sequence = open_sequence(tmp_path / "r")
    assert (guess(tmp_path / "r"), sequence.camera.fx) == ("redwood", 525.0)
    assert sequence.groundtruth is not None
    assert sequence.groundtruth.positions[:, 0].tolist() == [0, 1]
    assert sequence.groundtruth.timestamps.tolist() == sequence.timestamps == [0.1, 4 / 30]


def images_only(folder: Path, names: list[str], depth_names: list[str] | None = None, camera: bool = True) -> Path:
    for number, (a, b) in enumerate(zip(names, depth_names or names, strict=False)):
        format_writers.save(folder / "rgb" / a, np.full((48, 64, 3), 50 + number, np.uint8))
        format_writers.save(folder / "depth" / b, np.full((48, 64), 1500, np.uint16))
    if camera:
        (folder / "camera.toml").write_text("fx = 60\nfy = 60\ncx = 31.5\ncy = 23.5\n")
    return folder


@pytest.mark.parametrize(
    ("names", "depth_names", "times"),
    [
        (["0001.png", "0003.png"], None, [1 / 30, 3 / 30]),
        (["img_7.png", "img_8.jpg"], ["depth_7.png", "depth_8.png"], [7 / 30, 8 / 30]),
        (["12.50.png", "12.75.png"], ["12.51.png", "12.74.png"], [12.5, 12.75]),
        (["1700000000123.png", "1700000000456.png"], None, [1700000000.123, 1700000000.456]),
        (["1700000000123456789.png", "1700000000156456789.png"], None, [1700000000.123456789, 1700000000.156456789]),
        (["a.png", "b.png"], ["x.png", "y.png"], [0, 1 / 30]),
        (["1.png", "2.png"], ["101.png", "102.png"], [0, 1 / 30]),
    ],
)
def test_images_are_paired_by_their_names(
    tmp_path: Path, names: list[str], depth_names: list[str] | None, times: list[float]
) -> None:
    sequence = open_sequence(images_only(tmp_path / "mine", names, depth_names))
    assert sequence.timestamps == pytest.approx(times, abs=1e-9)
    assert [type(frame) for frame in sequence] == [RgbdFrame, RgbdFrame]
    assert sequence.recognised.startswith("folder of images, rgb/ and depth/, paired ")
    assert "1000 depth values per metre (the format's default), no ground truth" in sequence.recognised


def test_images_without_partner_are_left_out_with_a_warning(tmp_path: Path) -> None:
    folder = images_only(tmp_path / "mine", ["0.png", "1.png", "2.png"])
    (folder / "depth" / "1.png").unlink()
    sequence = open_sequence(folder)
    assert sequence.timestamps == [0, 2 / 30]
    assert sequence.warnings == ["1 image has no partner of the same number and is left out: rgb/1.png"]


def test_an_own_folder_without_camera_says_what_to_write(tmp_path: Path) -> None:
    folder = images_only(tmp_path / "mine", ["0.png", "1.png"], camera=False)
    with pytest.raises(IdRgbdoError) as caught:
        open_sequence(folder)
    assert f"write '{folder / 'camera.toml'}' with the lines `fx = 525.0`" in str(caught.value)
    (folder / "camera.toml").write_text("fx = 60.0\nfy = 60.0\ncx = 31.5\ncy = 23.5\ndepth_scale = 1000.0\nfps = 15\n")
    assert open_sequence(folder).timestamps == [0, 1 / 15]


def test_an_own_folder_that_cannot_be_paired(tmp_path: Path) -> None:
    folder = images_only(tmp_path / "mine", ["a.png", "b.png"], ["x.png", "y.png"])
    (folder / "depth" / "y.png").unlink()
    with pytest.raises(IdRgbdoError, match=r"which of the 2 images .* belongs to which of the 1"):
        open_sequence(folder)
    (folder / "depth" / "x.png").unlink()
    with pytest.raises(IdRgbdoError, match=r"expected images in '.*depth', found none; put the 16-bit depth images"):
        open_sequence(folder)


def test_depth_may_be_floats_in_metres(tmp_path: Path) -> None:
    folder = images_only(tmp_path / "mine", ["0.png", "1.png"], ["0.tiff", "1.tiff"])
    depth = np.full((48, 64), 1.5, np.float32)
    depth[0, :3] = [np.nan, np.inf, -1]
    assert cv2.imwrite(str(folder / "depth" / "0.tiff"), depth)
    (folder / "depth" / "1.tiff").unlink()
    np.save(folder / "depth" / "1.npy", depth.astype(np.float64))
    sequence = open_sequence(folder)
    assert sequence.warnings == []
    for frame in sequence:
        assert isinstance(frame, RgbdFrame)
        assert frame.depth[0, :4].tolist() == [0, 0, 0, 1.5]
    (folder / "depth" / "1.npy").write_bytes(b"no array")
    assert isinstance(open_sequence(folder).read(1), BrokenFrame)


def test_a_wrong_depth_scale_is_noticed_in_any_format(tmp_path: Path) -> None:
    folder = images_only(tmp_path / "mine", ["0.png"])
    (warning,) = open_sequence(folder, depth_scale=5000).warnings
    assert "0.3 m; the raw median 1500 is 1.5 m with 1000 (millimetres): pass that of your camera" in warning


def test_an_unknown_folder_says_what_was_looked_for(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("no recording")
    with pytest.raises(IdRgbdoError) as caught:
        open_sequence(tmp_path)
    message = str(caught.value)
    for part in ("rgb.txt and depth.txt (tum)", "results/frame*.jpg (replica)", "camera.toml", "fx = 525.0"):
        assert part in message
    assert "\n" not in message
    with pytest.raises(IdRgbdoError, match="no known format"):
        open_sequence(tmp_path / "notes.txt")
    with pytest.raises(IdRgbdoError, match=r"expected a folder at '.*', found a file"):
        open_sequence(tmp_path / "notes.txt", format="tum")


def test_a_format_may_be_named(film: Film, tmp_path: Path) -> None:
    format_writers.redwood(Film(film.frames[:3], film.groundtruth), tmp_path / "r")
    format_writers.camera_toml(film, tmp_path / "r")
    assert guess(tmp_path / "r") == "redwood"
    sequence = open_sequence(tmp_path / "r", format="folder")
    assert sequence.recognised.startswith("folder of images, color/ and depth/")
    with pytest.raises(IdRgbdoError, match="no format 'redwod'; did you mean 'redwood'"):
        open_sequence(tmp_path / "r", format="redwod")
    folders = {"icl_nuim", "tum", "7scenes", "scannet", "replica", "redwood", "folder"}
    assert set(FORMATS) == {"ros", "record3d", "stray_scanner", *folders}


@pytest.mark.parametrize(
    "name", ["7scenes", "redwood", "replica", "scannet", "folder", "tum", "icl_nuim", "record3d", "stray_scanner"]
)
def test_a_named_format_that_is_not_there_is_one_line(name: str, tmp_path: Path) -> None:
    with pytest.raises(IdRgbdoError) as caught:
        open_sequence(tmp_path, format=name)
    assert "\n" not in str(caught.value)


def test_run_says_what_was_recognised(
    film: Film, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    format_writers.own_folder(Film(film.frames[:4], film.groundtruth.at(torch.arange(4))), tmp_path / "mine")
    assert cli.main(["run", "mine", "--format", "folder", "--max-frames", "3"]) == 0
    shown = capsys.readouterr().out
    assert "reading folder of images, color/ and depth/, paired by number, 30 frames per second: 3 frames" in shown


def test_the_camera_files_of_the_documentation_are_cameras(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "data.md").read_text()
    plain, with_depth = re.findall(r"^```toml\n(.*?)^```", page, flags=re.MULTILINE | re.DOTALL)
    for name, text in (("plain", plain), ("with_depth", with_depth)):
        (tmp_path / f"{name}.toml").write_text(text)
    first, second = (find_calibration(tmp_path, tmp_path / f"{name}.toml") for name in ("plain", "with_depth"))
    assert (first.fx, first.depth_scale, first.fps, first.depth.fx) == (525, 1000, 30, None)
    assert second.depth.fx == 385
    assert second.T_color_depth()[:3, 3].tolist() == [0.015, 0, 0]


def test_every_format_is_documented() -> None:
    page = (Path(__file__).parents[2] / "docs" / "data.md").read_text()
    assert set(re.findall(r"^\| `(\w+)` \| .* \| .* \| .* \| .* \|$", page, flags=re.MULTILINE)) == set(FORMATS)
    help_text = next(line for line in Path(options.__file__).read_text().splitlines() if "format: str | None" in line)
    assert all(name in help_text for name in FORMATS)


def test_a_run_is_evaluated_against_any_formats_reference(
    film: Film, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    format_writers.redwood(film, tmp_path / "room")
    assert cli.main(["run", "room", "--max-frames", "8"]) == 0
    assert "ATE" in capsys.readouterr().out
    assert cli.main(["evaluate", "runs/room/latest", "room"]) == 0
    assert "8 of 8 estimated, of 30 reference poses" in capsys.readouterr().out
    (tmp_path / "room" / "trajectory.log").unlink()
    assert cli.main(["evaluate", "runs/room/latest", "room"]) == 1
    assert "holds no reference poses" in capsys.readouterr().err
