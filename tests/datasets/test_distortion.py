"""A distortion in a camera file is read, wherever it stands and whatever it is called, or refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from idrgbdo_torch.datasets.calibration import find_calibration
from idrgbdo_torch.errors import IdRgbdoError

F = {"fx": 262.5, "fy": 263.5, "cx": 159.5, "cy": 119.25}
K = [[262.5, 0, 159.5], [0, 263.5, 119.25], [0, 0, 1]]
D = [0.1, -0.2, 0.001, 0.002, 0.05]
NAMED = dict(zip(("k1", "k2", "p1", "p2", "k3"), D, strict=True))
LINES = "\n".join(f"{name} = {value}" for name, value in NAMED.items())
VINS = """%YAML:1.0
---
model_type: PINHOLE
camera_name: camera
image_width: 320
image_height: 240
distortion_parameters:
   k1: 0.1
   k2: -0.2
   p1: 0.001
   p2: 0.002
   k3: 0.05
projection_parameters:
   fx: 262.5
   fy: 263.5
   cx: 159.5
   cy: 119.25
min_dist: 30
"""
OKVIS = """cameras:
  rgb:
    intrinsics: {cols: 1, rows: 4, data: [262.5, 263.5, 159.5, 119.25]}
    distortion:
      type: radial-tangential
      parameters:
        cols: 1
        rows: 5
        data: [0.1, -0.2, 0.001, 0.002, 0.05]
"""


def read(tmp_path: Path, content: dict[str, Any] | str) -> tuple[float, ...]:
    path = tmp_path / ("a.yaml" if isinstance(content, str) else "a.json")
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    camera = find_calibration(tmp_path, path)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == tuple(F.values())
    return camera.distortion


@pytest.mark.parametrize(
    "content",
    [
        VINS,
        OKVIS,
        {"color_camera": {"intrinsics": F, "distortion": {**NAMED, "metric_radius": 1.7}}, "depth_camera": {"k1": 5.5}},
        {"intrinsics": F, "distortion": NAMED},
        {"intrinsics": F, "distortion": D},
        {"intrinsics": F, **NAMED},
        {**F, "distortion": NAMED},
        {**F, "distortion": {"model": "brown_conrady", "coeffs": D}},
        {**F, "distortion": {"radial": [0.1, -0.2, 0.05], "tangential": [0.001, 0.002]}},
        {"color_intrinsics": F, "color_distortion": D, "depth_intrinsics": F, "depth_distortion": [9.5]},
        {"camera_matrix": K, "dist_coeff": [D]},
        {"camera_matrix": K, "dist_coeff": 0, "dist_coeffs": [D]},
        {"camera_matrix": K, "distortion": [0.0] * 5, "distCoeffs": D},
        {"camera_matrix": K, "distortion_params": D, "undistorted": False, "max_distance": 3.5},
        {"camera_matrix": K, "distortion_parameters": D},
        {"camera_matrix": K, "distortion_coefficient": D},
        {"camera_matrix": K, "rgb_distortion_coefficients": {"rows": 1, "cols": 5, "data": D}},
        {"camera_matrix": K, "radial_distortion": [0.1, -0.2, 0.05], "tangential_distortion": [0.001, 0.002]},
        {"IntrinsicMatrix": K, "RadialDistortion": [0.1, -0.2, 0.05], "TangentialDistortion": [0.001, 0.002]},
        "camera_matrix: [262.5, 0, 159.5, 0, 263.5, 119.25, 0, 0, 1]\ndist_coeff: 0.1 -0.2 0.001 0.002 0.05\n",
    ],
)
def test_a_distortion_is_read(content: dict[str, Any] | str, tmp_path: Path) -> None:
    assert read(tmp_path, content) == (*D, 0, 0, 0)


@pytest.mark.parametrize("D_", [D, {"rows": 1, "cols": 5, "data": D}, ", ".join(map(str, D))])
def test_what_is_called_d_is_read_unless_it_is_one_number(D_: Any, tmp_path: Path) -> None:
    assert read(tmp_path, {**F, "D": D_}) == (*D, 0, 0, 0)


def test_a_matrix_called_k_beside_a_radial_model_is_the_matrix(tmp_path: Path) -> None:
    K = [[262.5, 0, 159.5], [0, 263.5, 119.25], [0, 0, 1]]
    assert read(tmp_path, {"model": "radial-tangential", "K": K, "width": 320, "height": 240}) == (0,) * 8


def test_the_same_coefficients_may_be_written_twice(tmp_path: Path) -> None:
    assert read(tmp_path, {**F, "k1": round(D[0], 5), "D": [D[0], *[0.0] * 4]})[0] == pytest.approx(D[0], abs=1e-5)


def test_a_flag_that_is_no_lens_is_none(tmp_path: Path) -> None:
    assert read(tmp_path, {**F, **NAMED, "wide_fov": True, "inverse_depth": True})[:4] == tuple(D[:4])


def test_one_coefficient_without_a_number_is_the_first_radial_one(tmp_path: Path) -> None:
    assert read(tmp_path, {"model": "SIMPLE_RADIAL", **F, "k": 0.1})[:2] == (0.1, 0)


@pytest.mark.parametrize("text", [f"distortion = {D}", f"dist_coeffs = {D}", "[distortion]\n" + LINES])
def test_a_list_in_our_own_file_is_read(text: str, tmp_path: Path) -> None:
    path = tmp_path / "camera.toml"
    path.write_text("fx = 262.5\nfy = 263.5\ncx = 159.5\ncy = 119.25\n" + text)
    assert find_calibration(tmp_path).distortion == (*D, 0, 0, 0)
    path.write_text("k1 = 0.3\n" + path.read_text())
    with pytest.raises(IdRgbdoError, match=r"expected one distortion, got dist.* and k1"):
        find_calibration(tmp_path)


@pytest.mark.parametrize(
    "content",
    [
        {**F, "distortion": [0.0] * 5},
        {**F, "distortion": "none", "distortion_model": "plumb_bob", "distortion_coefficients": []},
        {**F, "distortion": {"k1": 0, "k2": 0}, "num_distortion_coeffs": 5, "dist_coeffs": None},
        {"rgb_undistorted": F, "undistort": 1, "depth_distortion": D},
        {"color": F, "depth": {**F, "fx": 99.5, "coeffs": D}},
        {**F, "max_dist": 4.5, "dist_threshold": 0.07, "radial_thresh": 0.5, "baseline_dist": 0.05},
        {**F, "distortion_error": 0.2, "rms_distortion": 0.3, "distortion_center": [0.5, 0.5]},
        {**F, "P1": [*range(1, 13)], "P2": [[1.5, 2, 3, 4]] * 3},
        {"color": F, "d": 1.5},
        {"rgb": F, "D": 0.05, "k": 1.0, "wide_fov": True},
    ],
)
def test_none_is_read_as_none(content: dict[str, Any], tmp_path: Path) -> None:
    assert read(tmp_path, content) == (0,) * 8


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ({**F, "lens_distortion_poly3": [0.1, 0.2]}, "lens_distortion_poly3: expected distortion as k1, k2, p1, p2"),
        ({"camera": F, "radial_polynomial": [0.1]}, "radial_polynomial: expected distortion as k1"),
        ({**F, "distortion_curve": 0.5}, "distortion_curve: expected distortion as k1"),
        ({**F, "distortion": {"k1": 0.1, "t1": 0.001}}, "t1: expected distortion as k1"),
        ({**F, "distortion": [0.1, "x"]}, r"distortion: expected numbers, got \[0\.1, 'x'\]"),
        ({**F, "distortion": "0.1 x"}, "distortion: expected numbers, got"),
        ({**F, "distortion": D, "dist_coeffs": [0.3]}, "expected one distortion, got distortion and dist_coeffs"),
        ({"intrinsics": {**F, "k1": 0.2}, "distortion": D}, "expected one distortion, got k1 and distortion"),
        ({**F, "tangential": [0.1, 0.2, 0.3]}, "tangential: expected at most 2 distortion coefficients, got 3"),
        ({"camera_model": "OPENCV_FISHEYE", "intrinsics": F, "distortion": D}, "got 'opencv_fisheye'; rectify"),
        ({**F, "is_fisheye": True, **NAMED}, "got 'is_fisheye'; rectify"),
        ({**F, "fisheye": True, **NAMED}, "got 'fisheye'; rectify"),
        ({**F, "distortion": {"type": "equidistant", "coeffs": D}}, "got 'equidistant'; rectify"),
    ],
)
def test_a_distortion_that_cannot_be_read_is_refused(content: dict[str, Any], complaint: str, tmp_path: Path) -> None:
    with pytest.raises(IdRgbdoError, match=complaint) as caught:
        read(tmp_path, content)
    assert "\n" not in str(caught.value)
