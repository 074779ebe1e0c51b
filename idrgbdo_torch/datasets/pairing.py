"""Which colour image and which depth image make a frame: by their times, or by the numbers in their names."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch

from ..errors import IdRgbdoError
from ..text.files import unreadable
from ..trajectory import associate, nearest
from .builder import RawPair
from .images import IMAGE_SUFFIXES, read_color, read_depth

FPS = 30.0  # where nothing tells the times
LEAST_OFF_S, ODD = 0.01, 10  # a time is odd that is so far, and so many times as far as usual, from that of recording
MOST_ALONE = 0.1  # of the images of a kind; where more have no partner, something is wrong
RATES = (2, 3)  # of which one kind can be recorded so many times as often as the other
RATE_OFF = 0.02  # of the images: what was dropped
FEWEST_COUNTED = 10  # images of which a ratio of rates is told
MOST_REPEATED = 0.1  # of the times of a kind; a clock that repeats more is none

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
    try:
        files = list(folder.iterdir()) if folder.is_dir() else []
    except OSError as error:
        raise unreadable(folder, error, "sequence", "check its rights") from error
    return sorted(p for p in files if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith("."))


def numbered(folder: Path, pattern: str) -> dict[int, Path]:
    """The images of a folder by the number that `pattern` finds in their names."""
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
    alone = [path for of_one in (color, depth) for number, path in of_one.items() if number not in pairs]
    return pairs, (*alone_warning(alone, "of the same number"), *own_counts_warning(list(color), list(depth)))


def alone_warning(alone: Sequence[Path], how: str) -> tuple[str, ...]:
    """A sentence that counts the images without partner and names the first."""
    if not alone:
        return ()
    images_have = "image has" if len(alone) == 1 else "images have"
    are = "is" if len(alone) == 1 else "are"
    where = f"{alone[0].parent.name}/{alone[0].name}"
    first = where if len(alone) == 1 else f"the first is {where}"
    return (f"{len(alone)} {images_have} no partner {how} and {are} left out: {first}",)


def own_counts_warning(color: Sequence[int], depth: Sequence[int]) -> tuple[str, ...]:
    """A sentence where the numbers look like those of two streams of different rates, each of which counts its own.

    color, depth: increasing numbers. A kind that ends early looks the same; this can't be told from the names.
    """
    fewer, more = sorted((len(color), len(depth)))
    rate = round(more / fewer)
    gaps = any(numbers[-1] - numbers[0] + 1 != len(numbers) for numbers in (color, depth))
    if fewer < FEWEST_COUNTED or rate not in RATES or gaps or color[0] != depth[0]:
        return ()
    if abs(more - rate * fewer) > rate + RATE_OFF * more:
        return ()
    times = "twice" if rate == 2 else f"{rate} times"
    names = ("colour", "depth") if len(color) > len(depth) else ("depth", "colour")
    return (
        f"there are {times} as many {names[0]} as {names[1]} images, both counted from {color[0]} on: if each stream "
        "has a count of its own, images of the same number were not taken at the same time; list the pairs then, lines "
        "`time colour time depth`, and pass the list with --associations",
    )


def share_alone(color: Sequence[float], depth: Sequence[float], pairs: int) -> float:
    """The share without partner, while both were recorded, of the kind that has fewer images.

    color, depth: increasing times, or numbers. What comes half as often, starts later or ends earlier loses none.
    """
    first, last = max(color[0], depth[0]), min(color[-1], depth[-1])
    fewer = min(sum(first <= x <= last for x in of_one) for of_one in (color, depth))
    return max(0.0, 1 - pairs / fewer) if fewer else 0.0


def unpaired_warning(
    color: Sequence[tuple[float, T]], depth: Sequence[tuple[float, T]], pairs: int, limit_s: float
) -> tuple[str, ...]:
    """A sentence where many images have no partner in time, though both cameras were recorded then."""
    alone = share_alone([time for time, _ in color], [time for time, _ in depth], pairs)
    if alone <= MOST_ALONE:
        return ()
    return (
        f"{len(color)} colour and {len(depth)} depth images make only {pairs} pairs within {limit_s:g} s; the others "
        "are left out; check the two clocks, or raise --association-limit",
    )


def out_of_time(
    images: Sequence[tuple[float, tuple[float, int]]], paired: Collection[tuple[float, int]]
) -> list[tuple[float, int]]:
    """Those without partner whose own time (s) is far from that of their recording (ns), by what is usual for them.

    images: each a time and a stamp, of which the second number is the time of recording.
    """
    apart = np.array([time - recorded / 1e9 for time, (_, recorded) in images])
    off = np.abs(apart - np.median(apart))
    odd = np.flatnonzero(off > max(LEAST_OFF_S, ODD * float(np.median(off))))
    return [images[place][1] for place in odd.tolist() if images[place][1] not in paired]


def missing_files(pairs: Sequence[FilePair]) -> tuple[str, ...]:
    """A sentence where a list names files that are not there."""
    files = [path for pair in pairs for path in pair]
    missing = [path for path in files if not os.path.exists(path)]
    if not missing:
        return ()
    frames = sum(not (os.path.exists(a) and os.path.exists(b)) for a, b in pairs)
    return (
        f"{len(missing)} of {len(files)} listed image files do not exist, so that {frames} of {len(pairs)} frames are "
        f"lost; the first is '{missing[0]}'",
    )


def reader(pairs: Sequence[FilePair]) -> Callable[[int], RawPair]:
    """The function that reads frame number i of these files."""
    return lambda index: (read_color(pairs[index][0]), read_depth(pairs[index][1]))
