"""Which colour image and which depth image make a frame: by their times, or by the numbers in their names."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import torch

from ..errors import IdRgbdoError
from ..trajectory import associate, nearest
from .builder import RawPair
from .images import read_color, read_depth

IMAGE_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".npy"}
FPS = 30.0  # where nothing tells the times

T = TypeVar("T")
FilePair = tuple[Path, Path]  # colour, depth


def pair_by_time(
    color: Sequence[tuple[float, T]], depth: Sequence[tuple[float, T]], limit_s: float, where: Path
) -> list[tuple[float, T, T]]:
    """(time of the colour image, colour, depth) of each frame. Raises IdRgbdoError where no two are within limit_s."""
    color_times, depth_times = (torch.tensor([time for time, _ in x], dtype=torch.float64) for x in (color, depth))
    of_color, of_depth = associate(color_times, depth_times, limit_s)
    if len(of_color) == 0:
        gaps = (depth_times[nearest(depth_times, color_times)] - color_times).abs()
        raise IdRgbdoError(
            f"sequence: no colour and depth image of '{where}' are within {limit_s:g} s of each other, the closest "
            f"two are {float(gaps.min()):.3f} s apart; check the two clocks or raise --association-limit"
        )
    pairs = zip(of_color.tolist(), of_depth.tolist(), strict=True)
    return [(color[i][0], color[i][1], depth[j][1]) for i, j in pairs]


def images(folder: Path) -> list[Path]:
    """The image files of a folder, by name; none where there is no folder."""
    files = folder.iterdir() if folder.is_dir() else ()
    return sorted(p for p in files if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith("."))


def numbered(folder: Path, pattern: str = r"(\d+)\D*\.\w+$") -> dict[int, Path]:
    """The images of a folder by the number that `pattern` finds in their names; the last one by default."""
    found = ((re.search(pattern, path.name), path) for path in images(folder))
    return dict(sorted((int(number[1]), path) for number, path in found if number))


def pair_by_number(
    color: Mapping[int, Path], depth: Mapping[int, Path], where: Path
) -> tuple[dict[int, FilePair], tuple[str, ...]]:
    """The files of each number that both have, and a warning where some have no partner.

    Raises IdRgbdoError where no number is common to both.
    """
    pairs = {number: (path, depth[number]) for number, path in color.items() if number in depth}
    if not pairs:
        raise IdRgbdoError(
            f"sequence: expected colour and depth images with the same numbers in '{where}', got {len(color)} colour "
            f"and {len(depth)} depth images without a common one; name them alike, e.g. 000000.png in both folders"
        )
    alone = len(color) + len(depth) - 2 * len(pairs)
    return pairs, (f"{alone} images have no partner of the same number and are left out",) if alone else ()


def reader(pairs: Sequence[FilePair]) -> Callable[[int], RawPair]:
    """The function that reads frame number i of these files."""
    return lambda index: (read_color(pairs[index][0]), read_depth(pairs[index][1]))
