"""What the images of a recording are like, by most of them: any single one may be damaged, or of something else."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import IdRgbdoError

LOOK_AT = 30  # frames that may be broken before the first good one
Pair = tuple[NDArray[np.uint8], NDArray[Any]]  # (H, W, 3) colour and (h, w) depth


class Kind(NamedTuple):
    """What all frames of a recording have in common."""

    color: tuple[int, int]  # height, width
    depth: tuple[int, int]
    floats: bool  # depth, rather than whole numbers

    @classmethod
    def of(cls, pair: Pair) -> Kind:
        """Of one frame's images."""
        color, depth = pair
        return cls((color.shape[0], color.shape[1]), (depth.shape[0], depth.shape[1]), depth.dtype.kind == "f")


def usual_pair(
    read: Callable[[int], Pair], numbers: Sequence[int], stated: tuple[int | None, int | None] = (None, None)
) -> tuple[int, Pair]:
    """The number and the images of the first frame that is like most of those looked at: the first good one, and some
    others spread over the recording.

    read: the images of a frame by its number, of `numbers`. stated: (height, width) of colour by the calibration,
    which goes before the majority. Raises the first frame's error where none can be read.
    """
    first_number, first = _first(read, numbers)
    spread = {numbers[k] for k in (0, 1, len(numbers) // 3, 2 * len(numbers) // 3, -1) if -1 <= k < len(numbers)}
    kinds = {first_number: Kind.of(first)}
    for number in sorted(spread - {first_number}):
        try:
            kinds[number] = Kind.of(read(number))
        except IdRgbdoError:
            continue
    as_stated = [kind for kind in kinds.values() if kind.color == stated]
    counted = Counter(as_stated or kinds.values())
    usual = max(counted, key=lambda kind: counted[kind])  # the first of those that are as many
    if kinds[first_number] == usual:
        return first_number, first
    number = next(number for number, kind in kinds.items() if kind == usual)
    return number, read(number)


def _first(read: Callable[[int], Pair], numbers: Sequence[int]) -> tuple[int, Pair]:
    first_error: IdRgbdoError | None = None
    spread = numbers[LOOK_AT :: max(len(numbers) // LOOK_AT, 1)]  # the first minute may be missing
    for number in (*numbers[:LOOK_AT], *spread):
        try:
            return number, read(number)
        except IdRgbdoError as error:
            first_error = first_error or error
    raise first_error or IdRgbdoError("sequence: expected frames, got none; check the recording")
