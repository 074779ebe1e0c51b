"""Memory does not grow with the sequence: four times as many frames need less than 20 MB more."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

SCRIPT = """
import resource, sys
from dataclasses import replace
from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo
from idrgbdo_torch.odometry import run

def passes(sequence, times):
    for i in range(times):
        for frame in sequence:
            yield replace(frame, timestamp=frame.timestamp + 10.0 * i)

sequence = open_sequence(sys.argv[1], max_frames=int(sys.argv[3]))
done = run(IdRgbdo(), passes(sequence, int(sys.argv[2])))
print(len(done.records), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def peak_kb(folder: Path, times: int, frames: int) -> tuple[int, int]:
    """Frames tracked and peak resident kB of a process of its own."""
    command = [sys.executable, "-c", SCRIPT, str(folder), str(times), str(frames)]
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    return int(out[0]), int(out[1])


def test_memory_does_not_grow_with_the_sequence(data_dir: Path) -> None:
    frames = 50
    once, small = peak_kb(data_dir / "redkitchen_400", 1, frames)
    often, large = peak_kb(data_dir / "redkitchen_400", 4, frames)
    assert (once, often) == (frames, 4 * frames)
    assert large - small < 20_000, f"{large - small} kB more"
