"""Record3D, an app for iPhones and iPads: its .r3d files as shared, unpacked, or exported as colour and EXR depth.

    take.r3d, a zip     metadata, rgbd/0.jpg, rgbd/0.depth, rgbd/0.conf (both compressed by lzfse), ...
    EXR_RGBD/           metadata.json, rgb/0.jpg (or .png), depth/0.exr, ...

Depth is in metres. Poses are ARKit's, a quaternion and a position a frame, of a camera that looks along -z with y up.
"""

from __future__ import annotations

import json
import re
import zipfile
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import IdRgbdoError
from ..text.files import MOST_JSON, plain_bytes, read_bytes
from . import arkit
from .builder import RawPair
from .calibration import Calibration
from .images import decode_color, read_depth
from .packed import floats, member_bytes, unpacked
from .pairing import FPS, alone_warning
from .poses import reference
from .recording import Options, Recording

Place = Path | zipfile.Path
METADATA = ("metadata", "metadata.json")
COLORS = (".jpg", ".jpeg", ".png")
RAW = (".depth", ".raw", ".bin")
DEPTHS = (*RAW, ".exr", ".npy", ".npz", ".png", ".tif", ".tiff")
CONFIDENCES = (".conf", ".png", ".npy")
MOST_FILE = 64 << 20  # bytes of an image
DEEPEST = 16  # folders in an archive
MOST_RATIO, SLACK = 30, 1 << 20  # times its packed bytes, plus bytes, of the metadata: numbers shrink to a third
TO_OURS = np.diag([1.0, -1.0, -1.0, 1.0])  # y up and -z forward to y down and z forward
DAMAGE = (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile, zlib.error, EOFError)


def recognise(path: Path) -> bool:
    """Whether it is an .r3d file, or a folder with Record3D's metadata beside rgbd/ or rgb/."""
    if path.is_file():
        return path.suffix.lower() == ".r3d"
    files = [path / name for name in METADATA if (path / name).is_file()]
    folders = any((path / name).is_dir() for name in ("rgbd", "rgb"))
    try:
        return bool(files) and folders and b'"K"' in read_bytes(files[0], MOST_JSON)
    except IdRgbdoError:
        return False


def read(path: Path, options: Options) -> Recording:
    """Pair the files by number. Raises IdRgbdoError where files are missing or cannot be read."""
    root = _root(path)
    metadata = _metadata(root, path)
    colors, depths, confidences = _files(root)
    numbers = [number for number in colors if number in depths]
    if not numbers:
        raise IdRgbdoError(
            f"{path}: expected rgbd/0.jpg and rgbd/0.depth, or rgb/0.jpg and depth/0.exr, got {len(colors)} colour and "
            f"{len(depths)} depth images without a common number; export the recording again"
        )
    alone = [Path(str(one)) for files in (colors, depths) for k, one in files.items() if k not in set(numbers)]
    rows = {number: place for place, number in enumerate(numbers)}  # where the metadata has a number's row
    counted = _list(metadata, "poses") or _list(metadata, "frameTimestamps")
    if max(numbers) < len(counted):
        rows = {number: number for number in numbers}
    lenses = _lenses(metadata, len(counted))

    def read_images(number: int) -> RawPair:
        color = decode_color(_bytes(colors[number]), str(colors[number]))
        depth = _depth(depths[number], metadata, color.shape[:2])
        return color, arkit.sure(depth, _confidence(confidences.get(number), depth.shape))

    first = arkit.first_good(lambda index: read_images(numbers[index]), len(numbers))
    own = arkit.own_or(path, options.camera, _calibration(metadata, lenses, path))
    usual = (own.fx, own.fy, own.cx, own.cy)

    def read_pair(index: int) -> RawPair:
        pair = read_images(numbers[index])
        return pair if lenses is None else arkit.steady(pair, lenses[rows[numbers[index]]], usual)

    times = _times(metadata, rows, own.fps or FPS)
    poses = _poses(metadata)
    where = {number: poses[row] for number, row in rows.items() if row < len(poses)}
    return Recording(
        name=path.stem if path.is_file() else path.resolve().name,
        title="Record3D" + (", .r3d file" if path.is_file() else ""),
        timestamps=list(times.values()),
        read=read_pair,
        calibration=arkit.with_depth_camera(own, first, str(path)),
        depth_scale=1000.0,  # where somebody saved it as images of 16 bits; floats are metres
        groundtruth=reference(times, where),
        warnings=alone_warning(alone, "of the same number"),
    )


def _root(path: Path) -> Place:
    """Where the metadata is: in the folder or archive, or in the one folder that is in it."""
    try:
        top: Place = path if path.is_dir() else _opened(path)
        inner = [place for place in top.iterdir() if place.is_dir() and not place.name.startswith(("_", "."))]
        for place in (top, *inner):
            if any((place / name).is_file() for name in METADATA):
                return place
    except (OSError, zipfile.BadZipFile) as error:
        raise IdRgbdoError(f"{path}: cannot open the recording ({error}); copy or share it again") from error
    raise IdRgbdoError(f"{path}: expected Record3D's metadata, found none; share the recording again")


def _opened(path: Path) -> zipfile.Path:
    """An archive, of which zipfile.Path names all folders above each file: those of deep ones would fill the memory."""
    archive = zipfile.ZipFile(path)
    if any(name.count("/") > DEEPEST for name in archive.namelist()):
        raise zipfile.BadZipFile("folders in folders in folders, which no recording has")
    return zipfile.Path(archive)


def _metadata(root: Place, path: Path) -> dict[str, Any]:
    place = next(root / name for name in METADATA if (root / name).is_file())
    try:
        packed = place.root.getinfo(place.at).compress_size if isinstance(place, zipfile.Path) else MOST_JSON
        found = json.loads(_bytes(place, min(MOST_JSON, MOST_RATIO * packed + SLACK)).decode("utf-8"))
    except (*DAMAGE, RecursionError) as error:
        raise IdRgbdoError(f"{path}: cannot read {place.name} ({error}); share the recording again") from error
    return found if isinstance(found, dict) else {}


def _list(metadata: dict[str, Any], name: str) -> list[Any]:
    found = metadata.get(name)
    return found if isinstance(found, list) else []


def _files(root: Place) -> tuple[dict[int, Place], dict[int, Place], dict[int, Place]]:
    """Colour, depth and confidence by number."""

    def numbered(folders: tuple[str, ...], suffixes: tuple[str, ...]) -> dict[int, Place]:
        folder = next((root / name for name in folders if (root / name).is_dir()), None)
        files = folder.iterdir() if folder is not None else ()
        found = ((re.search(r"(\d+)\.\w+$", one.name), one) for one in files if _suffix(one) in suffixes)
        return dict(sorted((int(match[1]), one) for match, one in found if match))

    return (
        numbered(("rgbd", "rgb"), COLORS),
        numbered(("rgbd", "depth"), RAW if (root / "rgbd").is_dir() else DEPTHS),
        numbered(("rgbd", "conf", "confidence"), (".conf",) if (root / "rgbd").is_dir() else CONFIDENCES),
    )


def _suffix(place: Place) -> str:
    return Path(place.name).suffix.lower()


def _bytes(place: Place, most: int = MOST_FILE) -> bytes:
    try:
        if isinstance(place, Path):
            return plain_bytes(place, most)
        return member_bytes(place.root, place.root.getinfo(place.at), most)
    except DAMAGE as error:
        raise IdRgbdoError(f"{place}: cannot read the file ({error}); copy or download it again") from error


def _depth(place: Place, metadata: dict[str, Any], color: tuple[int, ...]) -> NDArray[Any]:
    if _suffix(place) in RAW:
        stated = metadata.get("dh"), metadata.get("dw")
        return floats(_bytes(place), str(place), stated, color)
    if isinstance(place, Path):
        return read_depth(place)
    raise IdRgbdoError(f"{place}: expected raw depth in an .r3d file; unpack the archive")


def _confidence(place: Place | None, shape: tuple[int, ...]) -> NDArray[Any] | None:
    """(h, w) of 0, 1, 2; None where there is none that can be read."""
    if place is None or _suffix(place) != ".conf":
        return None
    values = np.frombuffer(unpacked(_bytes(place), str(place)), np.uint8)
    return values.reshape(shape) if values.size == np.prod(shape) else None


def _calibration(metadata: dict[str, Any], lenses: arkit.Lenses | None, path: Path) -> Calibration:
    """The median of the frames' lenses, or K, which is stored by columns."""
    try:
        K = np.reshape(np.array(metadata["K"], np.float64), (3, 3))
        K = K.T if K[0, 2] == 0 else K
        fx, fy, cx, cy = (K[0, 0], K[1, 1], K[0, 2], K[1, 2]) if lenses is None else arkit.usual_lens(lenses)
        size = [round(float(metadata[name])) for name in ("w", "h")] if {"w", "h"} <= set(metadata) else [None, None]
        fps = float(metadata["fps"]) if metadata.get("fps") else None
    except DAMAGE as error:
        raise IdRgbdoError(f"{path}: expected the camera's matrix K in the metadata ({error}); correct it") from error
    camera = Calibration(float(fx), float(fy), float(cx), float(cy), fps=fps, origin="camera of metadata")
    return replace(camera, width=size[0], height=size[1])


def _lenses(metadata: dict[str, Any], frames: int) -> arkit.Lenses | None:
    """fx, fy, cx, cy of each frame, where there is a row for each."""
    try:
        rows = np.array(_list(metadata, "perFrameIntrinsicCoeffs"), np.float64)
    except (ValueError, TypeError):
        return None
    return rows if rows.shape == (frames, 4) and frames and bool((rows[:, :2] > 0).all()) else None


def _times(metadata: dict[str, Any], rows: dict[int, int], fps: float) -> dict[int, float]:
    """Seconds by number: those of the metadata where they are times of all frames, else the numbers'."""
    stamps = _list(metadata, "frameTimestamps")
    if len(stamps) > max(rows.values()):
        try:
            times = {number: float(stamps[row]) for number, row in rows.items()}
        except (TypeError, ValueError):
            times = {}
        if times and bool((np.diff(list(times.values())) > 0).all()):
            return times
    return {number: number / fps for number in rows}


def _poses(metadata: dict[str, Any]) -> NDArray[np.float64]:
    """(N, 4, 4) T_world_cam in our axes; none where there are none."""
    try:
        rows = np.array(_list(metadata, "poses"), np.float64)
    except (ValueError, TypeError):
        return np.zeros((0, 4, 4))
    if rows.ndim != 2 or rows.shape[1] != 7:
        return np.zeros((0, 4, 4))
    return np.asarray(arkit.rigid(rows[:, 4:], rows[:, :4]) @ TO_OURS)
