"""Numbers that no recording has are refused where they are read, naming the file; and none takes all memory."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from bag_writer import write_bag
from fuzz import recorded
from fuzz.promise import limits
from recordings import write_recording
from rendered import Film

from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.datasets.recording import Options
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.frame import BrokenFrame, RgbdFrame

INF = float("inf")


@pytest.mark.parametrize("time", ["nan", "inf", "-inf", "1e308", "1e25", "9" * 400, "²"])
@pytest.mark.parametrize("name", ["rgb.txt", "depth.txt"])
def test_times_that_are_none(name: str, time: str, tmp_path: Path) -> None:
    recording = write_recording(tmp_path)
    lines = (recording / name).read_text().splitlines()
    lines[2] = f"{time} {lines[2].split()[1]}"
    (recording / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(IdRgbdoError, match=rf"{name}, line 3: expected a timestamp, got"):
        open_sequence(recording)


@pytest.mark.parametrize("value", [float("nan"), INF, -INF, 1e308, 0.0, -60.0])
@pytest.mark.parametrize("field", ["fx", "fy", "cx"])
def test_a_camera_info_with_such_a_number(field: str, value: float, tmp_path: Path) -> None:
    film = recorded.film()
    camera = film.frames[0].camera
    object.__setattr__(camera := replace(camera), field, value)  # a Pinhole would refuse it
    frames = [replace(frame) for frame in film.frames]
    object.__setattr__(frames[0], "camera", camera)
    for frame in frames:
        object.__setattr__(frame, "camera", camera)
    path = write_bag(Film(tuple(frames), film.groundtruth), tmp_path / "a.bag")
    with pytest.raises(IdRgbdoError, match=r"a\.bag|principal point inside"):
        open_sequence(path)


@pytest.mark.parametrize("value", ["nan", "inf", "0", "-5", "1e308"])
@pytest.mark.parametrize("name", ["color", "depth"])
def test_intrinsics_of_scannet(name: str, value: str, tmp_path: Path) -> None:
    path = recorded.write(recorded.folder_of("scannet"), tmp_path)
    file = path / "intrinsic" / f"intrinsic_{name}.txt"
    words = file.read_text().split()
    file.write_text(" ".join([value, *words[1:]]))
    with pytest.raises(IdRgbdoError, match=rf"intrinsic_{name}\.txt: fx: expected a number above 0"):
        open_sequence(path)


@pytest.mark.parametrize("name", ["redwood", "replica"])
@pytest.mark.parametrize("value", ["NaN", "Infinity", "0", "-5", "1e308", "9" * 400])
def test_intrinsics_in_json(name: str, value: str, tmp_path: Path) -> None:
    path = recorded.write(recorded.folder_of(name), tmp_path)
    file = path / "camera_intrinsic.json" if name == "redwood" else tmp_path / "cam_params.json"
    assert "60.0" in file.read_text()
    file.write_text(file.read_text().replace("60.0", value, 1))
    with pytest.raises(IdRgbdoError, match=file.name):
        open_sequence(path)


@pytest.mark.parametrize("line", ["fps = 1e308", "fps = 1e-308", "depth_scale = 1e-320", "depth_scale = 1e308"])
def test_rates_and_scales(line: str, tmp_path: Path) -> None:
    path = recorded.write(recorded.folder_of("folder"), tmp_path)
    text = (path / "camera.toml").read_text().replace("fps = 30\n", "")
    (path / "camera.toml").write_text(f"{text}{line}\n")
    with pytest.raises(IdRgbdoError, match=rf"camera\.toml: {line.split()[0]}: expected a number at least"):
        open_sequence(path)


@pytest.mark.parametrize("value", [float("nan"), INF, 1e-320, 1e308, 0.0, -1.0])
def test_what_is_asked_for(value: float) -> None:
    with pytest.raises(IdRgbdoError, match=r"depth_scale: expected depth values per metre, above 0"):
        Options(depth_scale=value)
    if not 0 <= value < 1e307:
        with pytest.raises(IdRgbdoError, match="association_limit_s: expected seconds"):
            Options(association_limit_s=-1.0 if value == 1e308 else value)


def test_a_depth_camera_that_would_need_all_memory(tmp_path: Path) -> None:
    recording = write_recording(tmp_path, calibration=None)
    for fx, T, said in (
        (1e-3, "", "expected focal lengths of a depth camera of 64x48 pixels, got fx=0.001"),
        (0.1, "T_color_depth = [[1, 0, 0, 0.02], [0, 1, 0, 0], [0, 0, 1, 0]]\n", "each of its pixels covers 601x601"),
        (60, "T_color_depth = [[1, 0, 0, 1e308], [0, 1, 0, 0], [0, 0, 1, 0]]\n", r"camera\.toml: depth\.T_color_depth"),
        (60, "T_color_depth = [[1, 0, 0, nan], [0, 1, 0, 0], [0, 0, 1, 0]]\n", r"camera\.toml: depth\.T_color_depth"),
    ):
        (recording / "camera.toml").write_text(
            f"fx = 60\nfy = 60\ncx = 31.5\ncy = 23.5\n[depth]\nfx = {fx}\nfy = {fx}\ncx = 31.5\ncy = 23.5\n{T}"
        )
        with limits(10), pytest.raises(IdRgbdoError, match=said):
            open_sequence(recording)


def test_infinite_depth_is_unknown(tmp_path: Path) -> None:
    path = recorded.write(recorded.folder_of("arrays"), tmp_path)
    metres = np.full((48, 64), 1.5)
    metres[:4] = np.array([[np.inf], [-np.inf], [np.nan], [1e308]])
    np.save(path / "depth" / "0.npy", metres)
    frame = open_sequence(path).read(0)
    assert isinstance(frame, RgbdFrame)
    assert float(frame.depth[:4].max()) == 0 and float(frame.depth[4:].min()) == 1.5


def test_images_of_the_largest_size_fit_the_memory(tmp_path: Path) -> None:
    """A few kilobytes a file, 16 million pixels: some frames are decoded ahead, not all that fit a list."""
    recording = write_recording(tmp_path, frames=5, calibration="4000 4000 2047.5 2047.5")
    for kind, image in (
        ("rgb", np.zeros((4096, 4096, 3), np.uint8)),
        ("depth", np.full((4096, 4096), 5000, np.uint16)),
    ):
        data = cv2.imencode(".png", image)[1].tobytes()
        for path in (recording / kind).iterdir():
            path.write_bytes(data)
    with limits(60):
        sequence = open_sequence(recording)
        assert sum(isinstance(frame, RgbdFrame) for frame in sequence) == 5


@pytest.mark.parametrize("name", ["²²²²²²²²²².png", "٩.png", "9" * 200 + ".png", "①.png", "nan.png", "1e308.png"])
def test_names_of_images_with_strange_digits(name: str, tmp_path: Path) -> None:
    path = recorded.write(recorded.folder_of("folder"), tmp_path)
    for kind in ("color", "depth"):
        (path / kind / name).write_bytes((path / kind / "000000.png").read_bytes())
    assert len([frame for frame in open_sequence(path) if not isinstance(frame, BrokenFrame)]) >= recorded.FRAMES
