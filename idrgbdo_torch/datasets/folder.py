"""Anybody's folder of images: rgb/ and depth/ (or names like them), or both kinds in one folder; and camera.toml."""

from __future__ import annotations

import re
from pathlib import Path

from ..errors import IdRgbdoError
from ..trajectory import read_tum
from .by_name import pair_by_names
from .calibration import find_calibration
from .pairing import images, reader
from .poses import usable
from .recording import Options, Recording

COLOR_FOLDERS = ("rgb", "color", "colour", "image", "images")
# what is registered to colour goes first; depth/ beside it is what the depth camera saw
DEPTH_FOLDERS = ("aligned_depth", "depth_aligned", "aligned_depth_to_color", "depth_registered", "depth", "depths")
COLOR_WORD = re.compile(r"(?<![a-z])(rgb|colou?r|image|img)(?![a-z])", re.IGNORECASE)  # in names of one folder
DEPTH_WORD = re.compile(r"(?<![a-z])depth(?![a-z])", re.IGNORECASE)
DEPTH_SCALE = 1000.0  # millimetres


def recognise(path: Path) -> bool:
    """Whether there is a folder for colour and one for depth, or a folder of images whose names say which they are."""
    return all(subfolder(path, names) is not None for names in (COLOR_FOLDERS, DEPTH_FOLDERS)) or all(_mixed(path))


def read(folder: Path, options: Options) -> Recording:
    """Pair the images by the times in their names, else by number, else in their order.

    Raises IdRgbdoError where images or intrinsics are missing, saying what to write.
    """
    folders = [subfolder(folder, names) for names in (COLOR_FOLDERS, DEPTH_FOLDERS)]
    color, depth = _mixed(folder)
    where = "colour and depth side by side"
    if any(folders) or not (color and depth):
        color, depth = (images(path) if path is not None else [] for path in folders)
        for found, path, names in zip((color, depth), folders, (COLOR_FOLDERS, DEPTH_FOLDERS), strict=True):
            if not found:
                kind = ("rgb", "colour") if names is COLOR_FOLDERS else ("depth", "16-bit depth")
                raise IdRgbdoError(
                    f"sequence: expected images in '{path or folder / kind[0]}', found none; put the {kind[1]} images "
                    "there"
                )
        where = f"{color[0].parent.name}/ and {depth[0].parent.name}/"
    calibration = find_calibration(folder, options.camera)
    paired = pair_by_names(color, depth, folder, calibration.fps, options.association_limit_s)
    truth, unread = usable(read_tum, folder / "groundtruth.txt", None)
    return Recording(
        name=folder.resolve().name,
        title=f"folder of images, {where}, {paired.how}",
        timestamps=[time for time, _, _ in paired.frames],
        read=reader([(a, b) for _, a, b in paired.frames]),
        calibration=calibration,
        depth_scale=DEPTH_SCALE,
        groundtruth=truth,
        warnings=(*paired.warnings, *unread),
    )


def subfolder(path: Path, names: tuple[str, ...]) -> Path | None:
    """The first folder of these names; None where there is none."""
    return next((path / name for name in names if (path / name).is_dir()), None)


def _mixed(folder: Path) -> tuple[list[Path], list[Path]]:
    """The colour and the depth images of one folder, by the words in their names."""
    depth = [path for path in images(folder) if DEPTH_WORD.search(path.stem)]
    others = [path for path in images(folder) if not DEPTH_WORD.search(path.stem)]
    return [path for path in others if COLOR_WORD.search(path.stem)], depth
