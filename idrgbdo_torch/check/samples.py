"""The frames that a check looks at: runs of neighbours, spread over the recording, read one run at a time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..datasets import RgbdSequence
from ..frame import BrokenFrame

Floats = NDArray[np.float32]
Bytes = NDArray[np.uint8]

RUNS, LENGTH = 6, 24  # at most so many runs of so many frames: seconds of work, 60 MB at 640x480


@dataclass(frozen=True)
class Sample:
    """One frame as a check needs it."""

    index: int  # in the sequence
    timestamp: float  # s
    gray: Bytes  # (H, W)
    depth: Floats  # (H, W) m, 0 where invalid
    color: Bytes | None  # (H, W, 3) RGB


def spread(frames: int, runs: int = RUNS, length: int = LENGTH) -> list[range]:
    """Runs of neighbouring frame numbers, evenly spread; all frames in runs where there are no more than asked for."""
    if frames <= runs * length:
        return [range(first, min(first + length, frames)) for first in range(0, frames, length)]
    return [range(int(first), int(first) + length) for first in np.linspace(0, frames - length, runs)]


def read_runs(sequence: RgbdSequence, broken: list[str]) -> Iterator[list[Sample]]:
    """The runs, each as the list of its frames; the reasons of those that cannot be read are appended to `broken`."""
    for numbers in spread(len(sequence)):
        run = []
        for index in numbers:
            frame = sequence.read(index)
            if isinstance(frame, BrokenFrame):
                broken.append(frame.reason)
                continue
            gray = np.rint(frame.gray.numpy()).clip(0, 255).astype(np.uint8)
            color = None if frame.color is None else frame.color.numpy()
            run.append(Sample(index, frame.timestamp, gray, frame.depth.numpy(), color))
        yield run
