"""Calibrations as other programs write them are read, and which camera is taken is said."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from calibration_files import D5, FILES, MATRIX, REALSENSE, K

from idrgbdo_torch.datasets import guess, open_sequence
from idrgbdo_torch.datasets.calibration import Calibration, find_calibration
from idrgbdo_torch.datasets.yaml_text import parse_yaml
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.frame import RgbdFrame


@pytest.mark.parametrize("name", FILES)
def test_a_camera_is_read_from(name: str, tmp_path: Path) -> None:
    text, more = FILES[name]
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    camera = find_calibration(tmp_path, path)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == K
    D = more.get("D", ())
    assert isinstance(D, tuple)
    assert camera.distortion == (*D, *[0.0] * (8 - len(D)))
    assert (camera.width, camera.height) == more.get("size", (None, None))
    assert camera.depth_scale == more.get("depth_scale")
    assert camera.fps == more.get("fps")


def test_opencvs_own_writer(tmp_path: Path) -> None:
    matrix = np.array([[262.5, 0, 159.5], [0, 263.5, 119.25], [0, 0, 1]])
    for name in ("a.yaml", "a.yml"):
        storage = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_WRITE)
        storage.write("camera_matrix", matrix)
        storage.write("dist_coeffs", np.array([[0.1, -0.2, 0.001, 0.002, 0.05]]))
        storage.release()
        camera = find_calibration(tmp_path, tmp_path / name)
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == K
        assert camera.distortion[:5] == D5


@pytest.mark.parametrize(
    ("name", "text", "complaint"),
    [
        ("a.toml", "fx = 262,5\nfy = 1\n", "is not TOML: .* decimals have a point, not a comma"),
        (
            "a.toml",
            "fx = 262.5\nfy = -262.5\ncx = 1\ncy = 1\n",
            "fy: expected a focal length above 0, got -262.5; write 262",
        ),
        ("a.yaml", "Camera.fx: 1\nCamera.fy: -1\nCamera.cx: 2\nCamera.cy: 2\n", "a y axis that points up"),
        ("a.json", '{"depth": 1}', "found none of the names .* write a camera.toml with `fx"),
        ("a.json", "{", "expected JSON"),
        ("a.yaml", "just text\n", "expected `key: value`, got 'just text'"),
        ("a.yaml", "k: [1, 2\n", "a list in brackets has no end"),
        ("a.txt", "1 2 3", "got 3 numbers"),
        ("a.xml", "<opencv_storage/>", "cameras are read from TOML, YAML, JSON and plain numbers"),
        (
            "a.yaml",
            "cam0:\n  intrinsics: [1, 1, 2, 2]\n  distortion_model: equidistant\n  distortion_coeffs: [0.1, 0, 0, 0]\n",
            "expected radial and tangential distortion .* got 'equidistant'; rectify the images",
        ),
        (
            "a.yaml",
            "cam0:\n  intrinsics: [1, 1, 2, 2]\ncam1:\n  intrinsics: [1, 1, 2, 2]\n",
            r"several cameras \(cam0, cam1\); write the colour camera's",
        ),
        ("a.json", json.dumps({**REALSENSE, "model": 2, "coeffs": [0.1] * 5}), "got 'inverse_brown_conrady'"),
        ("a.yaml", f"M1:\n  data: [{MATRIX}]\nM2:\n  data: [{MATRIX}]\n", "holds two cameras"),
    ],
)
def test_what_is_no_camera_is_answered_with_what_to_write(name: str, text: str, complaint: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(IdRgbdoError, match=complaint) as caught:
        find_calibration(tmp_path, tmp_path / name)
    assert "\n" not in str(caught.value)


def test_yaml_as_calibrations_have_it() -> None:
    text = "a: 1 # one\nb:\n  c: [1, [2, 3]]\n  d:\n  - x: 1\n    y: two\n  - x: 3\nempty:\nquoted: 'a: b'\n"
    assert parse_yaml(text, "") == {
        "a": 1.0,
        "b": {"c": [1.0, [2.0, 3.0]], "d": [{"x": 1.0, "y": "two"}, {"x": 3.0}]},
        "empty": "",
        "quoted": "a: b",
    }


def images(folder: Path, size: tuple[int, int] = (320, 240), depth: str = "depth") -> Path:
    """Two frames, numbered, of depth 1.5 m in millimetres in the folder `depth`, 2.5 m in any other."""
    for number in range(2):
        shutil.rmtree(folder / "x", ignore_errors=True)
        for name in ("color", depth):
            (folder / name).mkdir(parents=True, exist_ok=True)
        color = np.random.default_rng(number).integers(0, 256, (size[1], size[0], 3), np.uint8)
        cv2.imwrite(str(folder / "color" / f"{number}.png"), color)
        value = 1500 if depth == "depth" else 2500
        cv2.imwrite(str(folder / depth / f"{number}.png"), np.full(size[::-1], value, np.uint16))
    return folder


@pytest.mark.parametrize("name", ["camera.yaml", "calibration.json", "intrinsics.txt", "metadata"])
def test_a_calibration_in_the_folder_is_found_and_said(name: str, tmp_path: Path) -> None:
    folder = images(tmp_path / "mine")
    content = {".yaml": "ost.yaml", ".json": "realsense.json", ".txt": "K.txt", "": "metadata"}[Path(name).suffix]
    (folder / name).write_text(FILES[content][0])
    sequence = open_sequence(folder)
    assert sequence.camera.fx == 262.5
    assert sequence.recognised.endswith(f", camera of {name}")
    (folder / "camera.toml").write_text("fx = 1\nfy = 1\ncx = 159.5\ncy = 119.5\n")
    assert open_sequence(folder).camera.fx == 1  # the one for this program goes first


def test_an_unknown_name_is_hinted_at(tmp_path: Path) -> None:
    folder = images(tmp_path / "mine")
    (folder / "left_arm.yaml").write_text(FILES["ost.yaml"][0])
    with pytest.raises(IdRgbdoError, match=r"unknown intrinsics .* is it in left_arm\.yaml\?"):
        open_sequence(folder)


def test_intrinsics_of_another_size_are_a_warning_with_the_lines_to_write(tmp_path: Path) -> None:
    folder = images(tmp_path / "mine")
    for text, part in (
        (
            "fx = 525\nfy = 525\ncx = 319.5\ncy = 239.5\n",
            "from 640x480, write `fx = 262.5`, `fy = 262.5`, `cx = 159.5`",
        ),
        ("fx = 131\nfy = 131\ncx = 79.5\ncy = 59.5\n", "from 160x120, write `fx = 262`"),
        ("fx = 262\nfy = 262\ncx = 119.5\ncy = 159.5\n", "give the intrinsics of these images"),
    ):
        (folder / "camera.toml").write_text(text)
        (warning,) = open_sequence(folder).warnings
        assert "is far from the middle of images of 320x240" in warning
        assert part in warning
    (folder / "camera.toml").write_text("fx = 917\nfy = 917\ncx = 639.5\ncy = 359.5\n")
    with pytest.raises(IdRgbdoError, match="inside the images of 320x240"):
        open_sequence(folder)
    (folder / "camera.toml").write_text("fx = 917\nfy = 917\ncx = 640\ncy = 480\nwidth = 1280\nheight = 960\n")
    with pytest.raises(IdRgbdoError, match=r"calibrated for 1280x960, .* write `fx = 229\.25`"):
        open_sequence(folder)
    (folder / "camera.toml").write_text("fx = 525\nfy = 525\ncx = 170\ncy = 110\n")  # as cameras are
    assert open_sequence(folder).warnings == []


def lists(folder: Path, kinds: tuple[str, ...] = ("color", "depth")) -> Path:
    """The images as TUM lists them."""
    for kind in kinds:
        lines = [f"{1560000083 + number / 30:.6f} {kind}/{number}.png" for number in range(2)]
        (folder / f"{kind}.txt").write_text("#Time Path\n" + "\n".join(lines) + "\n")
    return folder


def associations(folder: Path) -> Path:
    """Numbered pairs, as people write them for other programs."""
    (folder / "associations.txt").write_text("1 color/0.png 1 depth/0.png\n2 color/1.png 2 depth/1.png\n")
    return folder


def test_numbered_pairs_alone_are_not_icl_nuim(tmp_path: Path) -> None:
    folder = associations(images(tmp_path / "mine", (640, 480)))
    assert guess(folder) == "tum"
    with pytest.raises(IdRgbdoError, match="unknown intrinsics"):
        open_sequence(folder)
    (folder / "living_room_traj2.gt.freiburg").write_text("1 0 0 0 0 0 0 1\n")
    assert guess(folder) == "icl_nuim"
    named = associations(images(tmp_path / "living_room_traj2_frei_png", (640, 480)))
    assert open_sequence(named).recognised.endswith("camera of ICL-NUIM")
    assert open_sequence(named).camera.fx == 481.2
    small = associations(images(tmp_path / "lr_kt1", (320, 240)))
    with pytest.raises(IdRgbdoError, match=r"camera of ICL-NUIM: calibrated for 640x480, but the images are 320x240"):
        open_sequence(small)


def test_freiburgs_cameras_are_said_and_checked_against_the_images(tmp_path: Path) -> None:
    sequence = open_sequence(lists(images(tmp_path / "rgbd_dataset_freiburg2_mine", (640, 480))))
    assert sequence.recognised.endswith("camera of TUM freiburg2, by the folder's name")
    with pytest.raises(IdRgbdoError, match=r"TUM freiburg1, by the folder's name: calibrated for 640x480"):
        open_sequence(lists(images(tmp_path / "my_fr1_test", (320, 240))))
    with pytest.raises(IdRgbdoError, match="unknown intrinsics"):
        open_sequence(lists(images(tmp_path / "fr12", (640, 480))))
    with pytest.raises(IdRgbdoError, match="unknown intrinsics"):
        open_sequence(lists(images(tmp_path / "wafr1", (640, 480))))


def test_folders_without_lists_are_nobodys_by_their_name(tmp_path: Path) -> None:
    folder = images(tmp_path / "robot_fr1", (640, 480))
    with pytest.raises(IdRgbdoError, match=r"unknown intrinsics .*; write '.*camera\.toml'"):
        open_sequence(folder)
    (folder / "d435.json").write_text(FILES["open3d.json"][0].replace("320", "640").replace("240", "480"))
    assert open_sequence(folder).recognised.endswith("camera of d435.json")


@pytest.mark.parametrize("listed", [True, False])
@pytest.mark.parametrize("unregistered", [True, False])
def test_aligned_depth_goes_before_depth(tmp_path: Path, listed: bool, unregistered: bool) -> None:
    """As OpenLORIS has it: color.txt, aligned_depth.txt, depth.txt."""
    folder = images(tmp_path / "cafe", depth="aligned_depth")
    if unregistered:
        images(folder)
    if listed:
        lists(folder, ("color", "aligned_depth", *(["depth"] if unregistered else [])))
    (folder / "camera.toml").write_text("fx = 262\nfy = 262\ncx = 159.5\ncy = 119.5\n")
    sequence = open_sequence(folder)
    assert "aligned_depth" in sequence.recognised
    frame = sequence.read(0)
    assert isinstance(frame, RgbdFrame)
    assert float(frame.depth.median()) == 2.5
    assert sequence.warnings == []


def test_a_folder_with_open3ds_camera_is_read_as_one_with_another(tmp_path: Path) -> None:
    """Registered depth goes first, groundtruth.txt is read, and so is a distortion beside the matrix."""
    folder = images(images(tmp_path / "mine"), depth="aligned_depth")
    camera = {"width": 320, "height": 240, "intrinsic_matrix": [262.5, 0, 0, 0, 262.5, 0, 159.5, 119.5, 1]}
    (folder / "d435.json").write_text(json.dumps({**camera, "dist_coeffs": [0.1]}))
    (folder / "groundtruth.txt").write_text("0 0 0 0 0 0 0 1\n0.033 1 0 0 0 0 0 1\n")
    sequence = open_sequence(folder)
    assert sequence.recognised.startswith("Open3D/Redwood layout, color/ and aligned_depth/, paired by number")
    frame = sequence.read(0)
    assert isinstance(frame, RgbdFrame)
    assert float(frame.depth.median()) == 2.5
    assert sequence.groundtruth is not None and sequence.groundtruth.positions[:, 0].tolist() == [0, 1]
    assert find_calibration(folder, folder / "d435.json").k1 == 0.1
    (folder / "d435.json").write_text(json.dumps({**camera, "lens_distortion_3": [0.1]}))
    with pytest.raises(IdRgbdoError, match="lens_distortion_3: expected distortion as k1"):
        open_sequence(folder)
    (folder / "camera.toml").write_text("fx = 262\nfy = 262\ncx = 159.5\ncy = 119.5\n")
    assert open_sequence(folder).camera.fx == 262


def test_color_txt_is_a_list(tmp_path: Path) -> None:
    folder = images(tmp_path / "mine")
    for kind in ("color", "depth"):
        (folder / f"{kind}.txt").write_text(f"10.5 {kind}/1.png\n10.25 {kind}/0.png\n")
    (folder / "camera.toml").write_text("fx = 262\nfy = 262\ncx = 159.5\ncy = 119.5\ndepth_scale = 1000\n")
    sequence = open_sequence(folder)
    assert (guess(folder), sequence.timestamps) == ("tum", [10.25, 10.5])
    (folder / "color.txt").unlink()
    with pytest.raises(IdRgbdoError, match=r"has no rgb\.txt; write it.* or remove depth\.txt"):
        open_sequence(folder)


def test_a_camera_of_the_usual_kind_is_not_doubted() -> None:
    for camera, size in (
        (Calibration(517.3, 516.5, 318.6, 255.3), (640, 480)),
        (Calibration(601.3, 601.0, 638.3, 367.0), (1280, 720)),
        (Calibration(1404.3, 1404.3, 724.6, 963.8), (1440, 1920)),
        (Calibration(262.5, 262.5, 79.5, 59.5), (161, 121)),
    ):
        assert camera.size_doubt(*size) == ""


AZURE = (0.5, -2.6, 0.0004, -0.0003, 1.5, 0.38, -2.4, 1.4)  # such as its factory calibration has


@pytest.mark.parametrize(
    ("k", "folds"),
    [
        (AZURE, False),
        (AZURE[:5], True),  # the three of the denominator are forgotten
        ((0.26, -0.95, -0.005, 0.003, 1.16), False),  # TUM's first Kinect
        ((-0.33, 0.13, 0.0, 0.0), False),
        ((-0.9,), True),
        ((-0.3,), False),  # in the corners alone
        ((), False),
    ],
)
def test_a_distortion_that_folds_the_image_is_doubted(k: tuple[float, ...], folds: bool) -> None:
    names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    camera = Calibration(517.0, 517.0, 319.5, 239.5, **dict(zip(names, k, strict=False)))
    assert camera.distortion_doubt(640, 480).startswith("the distortion folds the image over") == folds


def test_a_wide_view_without_distortion_is_not_doubted() -> None:
    assert Calibration(20.0, 20.0, 319.5, 239.5).distortion_doubt(640, 480) == ""
