"""Anybody's folder of images: rgb/ and depth/ (or names like them), and camera.toml."""

from __future__ import annotations

from pathlib import Path

from ..errors import IdRgbdoError
from ..trajectory import read_tum
from .calibration import find_calibration
from .pairing import FPS, images, numbered, pair_by_number, pair_by_time, reader
from .recording import Options, Recording

COLOR_FOLDERS = ("rgb", "color", "colour", "image", "images")
DEPTH_FOLDERS = ("depth", "depths")
DEPTH_SCALE = 1000.0  # millimetres
EPOCH_DIGITS = {13: 1e3, 16: 1e6, 19: 1e9}  # digits of a time since 1970 in ms, us, ns: ticks per second


def recognise(path: Path) -> bool:
    """Whether there is a folder for colour and one for depth."""
    return _subfolder(path, COLOR_FOLDERS) is not None and _subfolder(path, DEPTH_FOLDERS) is not None


def read(folder: Path, options: Options) -> Recording:
    """Pair the images by the times in their names, else by number, else in their order.

    Raises IdRgbdoError where images or intrinsics are missing, saying what to write.
    """
    found = [_subfolder(folder, names) for names in (COLOR_FOLDERS, DEPTH_FOLDERS)]
    for path, names in zip(found, (COLOR_FOLDERS, DEPTH_FOLDERS), strict=True):
        if path is None or not images(path):
            raise IdRgbdoError(
                f"sequence: expected images in '{folder / names[0]}', found none; put the "
                f"{'colour' if names is COLOR_FOLDERS else '16-bit depth'} images there"
            )
    color, depth = (path for path in found if path is not None)
    calibration = find_calibration(folder, options.camera)
    fps = calibration.fps or FPS
    color_times, depth_times = _times(color), _times(depth)
    warnings: tuple[str, ...] = ()
    if color_times and depth_times:
        frames = pair_by_time(color_times, depth_times, options.association_limit_s, folder)
        how = "paired by the times in their names"
    elif set(numbered(color)) & set(numbered(depth)):
        pairs, warnings = pair_by_number(numbered(color), numbered(depth), folder)
        frames = [(number / fps, *files) for number, files in pairs.items()]
        how = f"paired by number, {fps:g} frames per second"
    else:
        frames = [(k / fps, *files) for k, files in enumerate(_in_order(color, depth))]
        how = f"paired in the order of their names, {fps:g} frames per second"
    truth = folder / "groundtruth.txt"
    return Recording(
        name=folder.resolve().name,
        title=f"folder of images, {color.name}/ and {depth.name}/, {how}",
        timestamps=[time for time, _, _ in frames],
        read=reader([(a, b) for _, a, b in frames]),
        calibration=calibration,
        depth_scale=DEPTH_SCALE,
        groundtruth=read_tum(truth) if truth.exists() else None,
        warnings=warnings,
    )


def _subfolder(path: Path, names: tuple[str, ...]) -> Path | None:
    return next((path / name for name in names if (path / name).is_dir()), None)


def _times(folder: Path) -> list[tuple[float, Path]]:
    """The images by the time in their names, s; empty where not all names are times."""
    times = [(_time(path.stem), path) for path in images(folder)]
    known = [(time, path) for time, path in times if time is not None]
    return sorted(dict(known).items()) if len(known) == len(times) else []


def _time(stem: str) -> float | None:
    """Seconds, of a name that is a decimal number or a whole one of as many digits as a time since 1970 has."""
    seconds, point, fraction = stem.partition(".")
    if point and seconds.isdigit() and fraction.isdigit():
        return float(stem)
    return int(stem) / EPOCH_DIGITS[len(stem)] if stem.isdigit() and len(stem) in EPOCH_DIGITS else None


def _in_order(color: Path, depth: Path) -> list[tuple[Path, Path]]:
    """The images side by side. Raises IdRgbdoError where there is more of one than of the other."""
    a, b = images(color), images(depth)
    if len(a) != len(b):
        raise IdRgbdoError(
            f"sequence: cannot tell which of the {len(a)} images in '{color}' belongs to which of the {len(b)} in "
            f"'{depth}'; give the two images of a frame the same number or time as their names, e.g. 000000.png"
        )
    return list(zip(a, b, strict=True))
