"""Calibrations as other programs write them, and as people write them down.

TOML (ours), YAML (OpenCV, ROS camera_info, Kalibr, ORB-SLAM), JSON (Open3D, RealSense, Record3D, instant-ngp), plain
numbers. They name the same things differently, so they are read by the names that any of them uses.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import IdRgbdoError
from ..text.files import MOST_JSON, damage_named, is_named, parse_json, parse_toml, read_text
from ..text.plain import shown
from .camera_words import by_name, number, numbers
from .distortion import ORDER, lists_distortion, read_distortion
from .yaml_text import parse_yaml

MATRICES = (
    "camera_matrix", "cameramatrix", "intrinsic_matrix", "intrinsicmatrix", "camera_intrinsics", "k", "m1", "m",
    "intrinsics", "intrinsic", "projection_matrix",
)  # fmt: skip
SCALARS = {
    "fx": ("fx", "fl_x", "focal_x", "fu"),
    "fy": ("fy", "fl_y", "focal_y", "fv"),
    "cx": ("cx", "ppx", "center_x", "pu"),
    "cy": ("cy", "ppy", "center_y", "pv"),
    "width": ("image_width", "width", "w", "imagewidth"),
    "height": ("image_height", "height", "h", "imageheight"),
    "depth_scale": ("depthmapfactor", "depth_map_factor", "depth_scale", "depth_factor", "png_depth_scale", "scale"),
    "fps": ("fps", "rate_hz"),
}
SIZE = ("width", "height")
SIZES = ("resolution", "image_size", "imagesize", "size")
LEAST_SCALE = 50.0  # depth values per metre; what is called "scale" and is smaller is something else
Levels = tuple[Mapping[str, Any], ...]  # a mapping and those around it, inner ones first
COLMAPS = ("OPENCV", "FULL_OPENCV", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")  # nobody else has these models
HALF = 0.5  # px, from the corner of the top-left pixel, where COLMAP and nerfstudio count from, to its centre
COLORFUL = ("color", "colour", "rgb")
SUFFIXES = (".yaml", ".yml", ".json", ".txt")
NAMES = ("camera", "calibration", "calib", "intrinsics", "intrinsic", "camera_info", "camera_intrinsics", "ost", "K")


def usual_file(folder: Path) -> Path | None:
    """A calibration under one of the usual names; None where there is none."""
    files = (folder / f"{name}{suffix}" for name in NAMES for suffix in SUFFIXES)
    record3d = folder / "metadata"
    return next((path for path in (*files, record3d) if is_named(path)), None)


def camera_values(path: Path) -> dict[str, Any]:
    """What a calibration file says, under the names of Calibration's fields.

    Raises IdRgbdoError for a file that cannot be read, holds no camera or several, or a lens of another kind.
    """
    text = read_text(path, "configuration", "pass an existing text file", most=MOST_JSON)
    with damage_named(str(path), "a camera", f"correct it, or write {_lines()}"):
        return _upright(_values(path, text, str(path)), str(path))


def _values(path: Path, text: str, where: str) -> dict[str, Any]:
    suffix = path.suffix.lower()
    if suffix == ".toml":
        return _toml(text, where)
    if text.lstrip().startswith("{"):
        return _camera(_json(text, where), where)
    if suffix in (".yaml", ".yml") or text.startswith("%YAML"):
        return _camera(parse_yaml(text, where), where)
    if suffix in (".xml", ".json"):
        raise IdRgbdoError(f"{where}: cameras are read from TOML, YAML, JSON and plain numbers; write {_lines()}")
    return _numbers(text, where)


def _toml(text: str, where: str) -> dict[str, Any]:
    """Our own file. Capitals, numbers in quotes and the distortion as a list or a table are forgiven."""
    values = _lower(parse_toml(text, where))
    others = {key: value for key, value in values.items() if not lists_distortion(key)}
    return {**others, **_distortion((values,), "", where)} if others != values else values


def _lower(data: Mapping[str, Any]) -> dict[str, Any]:
    """Keys in small letters, numbers without quotes."""
    keys = {key: "T_color_depth" if key.lower() == "t_color_depth" else key.lower() for key in data}
    return {keys[k]: _lower(v) if isinstance(v, Mapping) else number(v) for k, v in data.items()}


def _upright(values: dict[str, Any], where: str) -> dict[str, Any]:
    """The values. Raises IdRgbdoError for a camera whose axes do not point right and down."""
    for key in ("fx", "fy"):
        value = values.get(key)
        if isinstance(value, int | float) and -math.inf < value < 0:
            raise IdRgbdoError(
                f"{where}: {key}: expected a focal length above 0, got {value:g}; write {-value:g} (some "
                "data sets, such as ICL-NUIM, have a y axis that points up; here it points down)"
            )
    return values


def _json(text: str, where: str) -> dict[str, Any]:
    data = parse_json(text, where, f"correct it, or write {_lines()}")
    return data if isinstance(data, dict) else {}


def _camera(data: Mapping[str, Any], where: str) -> dict[str, Any]:
    """The camera in a mapping, or in the one of its parts that holds the colour camera."""
    values = _read(data)
    if "fx" in values:
        return {**values, **_distortion((data,), "", where)}
    parts = {name: levels for name, levels in _parts(data, (data,)) if "fx" in _read(levels[0])}
    chosen = {name: levels for name, levels in parts.items() if _colorful(name, levels[0])} or parts
    if len(chosen) == 1:
        ((name, levels),) = chosen.items()
        return {**_outer(values), **_read(levels[0]), **_distortion(levels, name, where)}
    if chosen:
        raise IdRgbdoError(
            f"{where}: holds several cameras ({shown(', '.join(chosen), quoted=False)}); "
            "write the colour camera's into a file of its own"
        )
    raise IdRgbdoError(f"{where}: expected a camera, found none of the names that are known; write {_lines()}")


def _parts(data: Mapping[str, Any], around: Levels) -> list[tuple[str, Levels]]:
    """The mappings inside a mapping, two levels deep, the outer ones first; each with those around it."""
    inner = [(name, (part, *around)) for name, part in data.items() if isinstance(part, Mapping)]
    if len(around) > 1:
        return inner
    return inner + [(f"{name}.{n}", below) for name, levels in inner for n, below in _parts(levels[0], levels)]


def _colorful(name: str, part: Mapping[str, Any]) -> bool:
    words = f"{name} {part.get('rostopic', '')}".lower()
    return any(color in words for color in COLORFUL)


def _outer(values: dict[str, Any]) -> dict[str, Any]:
    """What stands around the camera and counts for it."""
    return {key: value for key, value in values.items() if key in ("depth_scale", "fps", *SIZE)}


def _distortion(levels: Levels, name: str, where: str) -> dict[str, float]:
    """The distortion of the camera of this name, whose numbers stand in the first of the levels."""
    named = by_name(levels[0])
    if "m1" in named and "m2" in named:
        raise IdRgbdoError(f"{where}: holds two cameras (M1, M2); write {_lines()} of the colour camera")
    return read_distortion(levels, name, where, f"write {_lines()} of the rectified ones")


def _read(data: Mapping[str, Any]) -> dict[str, Any]:
    """The values of one mapping, by whatever names they have there, without the distortion."""
    named = by_name(data)
    values: dict[str, Any] = {}
    for field, names in SCALARS.items():
        value = next((number(named[name]) for name in names if name in named), None)
        if isinstance(value, int | float) and not isinstance(value, bool):
            values[field] = float(value)  # OverflowError, which the caller names, where it has hundreds of digits
    for name in MATRICES:
        matrix = _intrinsics(numbers(named.get(name)))
        if "fx" not in values and matrix is not None:
            values.update(zip(("fx", "fy", "cx", "cy"), matrix, strict=True))
    if "fl_x" in named or named.get("camera_model") in COLMAPS:
        values.update({name: values[name] - HALF for name in ("cx", "cy") if name in values})
    scale = values.pop("depth_scale", 0.0)
    if 0 < scale < 0.1:  # metres per value, as RealSense has it
        whole = round(1.0 / scale)
        values["depth_scale"] = float(whole) if abs(whole * scale - 1.0) < 1e-4 else 1.0 / scale
    elif scale >= LEAST_SCALE or (scale == 1.0 and "scale" not in named):
        values["depth_scale"] = scale
    size = next((numbers(named[name]) for name in SIZES if name in named), [])
    if len(size) == 2:
        values.update(width=size[0], height=size[1])
    values.update({name: round(values[name]) for name in SIZE if math.isfinite(values.get(name, math.inf))})
    if "fx" not in values:
        return _outer(values)
    return {key: value for key, value in values.items() if value > 0 or key not in ("depth_scale", "fps", *SIZE)}


def _intrinsics(K: list[float]) -> tuple[float, float, float, float] | None:
    """fx, fy, cx, cy of four numbers, or of a matrix of 3 or 4 rows, stored by rows or by columns; None for another."""
    if len(K) == 4:
        return K[0], K[1], K[2], K[3]
    shape = {9: (3, 3), 12: (3, 4), 16: (4, 4)}.get(len(K))
    if shape is None:
        return None
    M = np.reshape(K, shape)
    if shape != (3, 4) and M[0, 2] == 0 and M[2, 0] != 0:
        M = M.T
    if M[0, 0] == 0 or tuple(M[2, :3]) != (0, 0, 1) or M[1, 0] != 0:
        return None
    return float(M[0, 0]), float(M[1, 1]), float(M[0, 2]), float(M[1, 2])


def _numbers(text: str, where: str) -> dict[str, Any]:
    """fx fy cx cy [k1 k2 p1 p2 [k3 [k4 k5 k6]]], or a matrix of 3x3, 3x4 or 4x4."""
    expected = "fx fy cx cy [k1 k2 p1 p2 [k3 [k4 k5 k6]]] in pixels, or a matrix"
    try:
        fields = " ".join(line.split("#")[0] for line in text.splitlines()).replace(",", " ").split()
        numbers = [float(field) for field in fields]
    except ValueError as error:
        raise IdRgbdoError(
            f"{where}: expected {expected}, got text ({shown(error, quoted=False)}); correct it"
        ) from error
    matrix = _intrinsics(numbers) if len(numbers) in (9, 12, 16) else None
    if matrix is not None:
        return dict(zip(("fx", "fy", "cx", "cy"), matrix, strict=True))
    if len(numbers) not in (4, 8, 9, 12):
        raise IdRgbdoError(f"{where}: expected {expected}, got {len(numbers)} numbers; correct it")
    return dict(zip(("fx", "fy", "cx", "cy", *ORDER), numbers, strict=False))


def _lines() -> str:
    return "a camera.toml with `fx = ...`, `fy = ...`, `cx = ...`, `cy = ...`"
