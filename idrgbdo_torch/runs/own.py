"""The files of a run in its folder, told from those of others: only these are ever replaced or removed."""

from __future__ import annotations

import errno
import os
from collections.abc import Sequence
from pathlib import Path

from ..errors import IdRgbdoError
from ..text.files import is_plain_file, open_plain
from .rows import PATTERN

CHECKPOINT = "checkpoint.bin"
FILES = (
    *("trajectory.txt", "keyframes.txt", "frames.csv"),
    *("trajectory_refined.txt", "config.toml", "input.json", "summary.json", "outcome.json"),
    *("map.ply", "mesh.ply", "report.html"),
)
UNFINISHED = (*(f"{name}.part" for name in FILES), "checkpoint.part", "map_segment_[0-9]*.ply.part")
KEPT = (CHECKPOINT, PATTERN, "figures/trajectory.png", f"figures/frame_{6 * '[0-9]'}.png")  # where a run is continued
ALL = (*UNFINISHED, "map_segment_[0-9]*.ply", *KEPT, *FILES)
HEADING = {"timestamp", "status", "keyframe"}  # columns of any frames.csv
MOST_HEADING = 1 << 14  # bytes


def found(folder: Path) -> list[Path]:
    """What has a name that a run writes or removes."""
    return sorted(path for pattern in ALL for path in folder.glob(pattern))


def is_run(folder: Path) -> bool:
    """Whether the files with such names are those of a run. It writes the heading of frames.csv before all else."""
    path = folder / "frames.csv"
    if not is_plain_file(path):
        return False
    with open_plain(path) as file:
        heading = file.read(MOST_HEADING).decode(errors="replace").partition("\n")[0]
    return not heading or set(heading.split(",")) >= HEADING  # empty: of a run that was stopped there


def refuse_others(folder: Path) -> None:
    """Raises IdRgbdoError for files of others that a run would replace, OSError for a folder in the place of a file."""
    names = found(folder)
    for path in names:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not is_run(folder):
        refuse_any(folder, names, "run")


def refuse_any(folder: Path, found: Sequence[Path], what: str) -> None:
    """Raises IdRgbdoError where a folder that is none of ours has any such file. what: that would replace it."""
    if found:
        raise IdRgbdoError(
            f"out: expected a new folder, or one of an earlier {what}, got '{folder}' with a "
            f"'{found[0].relative_to(folder)}' that no {what} wrote; pass another --out"
        )


def clear(folder: Path, resumed: bool) -> None:
    """Remove what an earlier run left, what marks its folder last; resumed: all but its checkpoint and its figures."""
    kept = {path for pattern in KEPT for path in folder.glob(pattern)} if resumed else set()
    mark = folder / "frames.csv"
    for path in found(folder):
        if path not in kept and path != mark:
            path.unlink(missing_ok=True)
    mark.unlink(missing_ok=True)
