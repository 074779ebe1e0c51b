"""What a run tracked, left in its folder: the recording and how it was read; and what tells it from another."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from ..errors import IdRgbdoError
from ..frame import BrokenFrame, RgbdFrame
from ..text.files import read_json
from .writing import write_whole

NAME = "input.json"
LISTS = (".txt", ".csv", ".json", ".toml", ".yaml", ".yml", ".log")
MOST_BYTES = 16 << 20  # of a list, and of each end of a recording that is one file, that are looked at
SAMPLED = 8  # frames whose images are compared: the first three, and others spread over the recording
CHOICE = {"start", "every", "max_frames"}  # the times of the frames tell these
OWN = {"trajectory.txt", "trajectory_refined.txt", "keyframes.txt", "frames.csv", "config.toml", "summary.json", NAME}


class Frames(Protocol):
    """A recording that can be read at any place."""

    timestamps: list[float]  # s

    def __len__(self) -> int: ...

    def read(self, index: int) -> RgbdFrame | BrokenFrame:
        """One frame, decoded now."""


@dataclass(frozen=True)
class Source:
    """How a recording is read, and what it holds."""

    options: str  # JSON
    lists: str  # SHA-256 of the text files beside the images, or of both ends of a recording that is one file
    images: str  # SHA-256 of some frames as they are tracked, and of all times


@dataclass(frozen=True)
class Reading:
    """A recording's place, and the options that it is read with."""

    sequence: Path
    options: Mapping[str, Any]

    def remember(self, folder: Path) -> None:
        """Write both into a run's folder; paths become absolute. Raises IdRgbdoError where that fails."""
        values = {"sequence": self.sequence, **self.options}
        plain = {name: str(value.resolve()) if isinstance(value, Path) else value for name, value in values.items()}
        write_whole(folder / NAME, json.dumps(plain, indent=2) + "\n")

    def source(self, frames: Frames | None) -> Source:
        """What tells the recording from others: not where it lies, but what is in it.

        frames: None where they can be read in their order alone; then the images are not compared.
        """
        plain = {
            name: value.name if isinstance(value, Path) else value
            for name, value in self.options.items()
            if name not in CHOICE
        }
        images = "" if frames is None else _images(frames)
        return Source(json.dumps(plain, sort_keys=True), _lists(self.sequence, self.options), images)


def difference(mine: Mapping[str, str] | None, saved: Any) -> str:
    """In what two sources differ, as a phrase."""
    if not mine or not isinstance(saved, dict):
        return "recording"
    if mine["options"] != saved.get("options"):
        try:
            before, now = json.loads(str(saved.get("options"))), json.loads(mine["options"])
            names = [name for name in now if before.get(name) != now[name]]
        except (ValueError, AttributeError):
            return "way of reading the recording"
        return ", ".join(f"{name} ({before.get(name)}, now {now[name]})" for name in names[:2])
    if mine["images"] != saved.get("images"):
        return "recording: images or times are not those that were tracked"
    return "recording: its lists have changed since"


def recall(folder: Path) -> tuple[Path, dict[str, Any]]:
    """The recording that the run in a folder tracked, and its reading options, paths as text."""
    if not (folder / NAME).exists():
        raise IdRgbdoError(f"source: the run '{folder}' does not say what it tracked; name the recording instead")
    try:
        options = dict(read_json(folder / NAME, "source"))
        sequence = Path(options.pop("sequence"))
        exists = sequence.exists()
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise IdRgbdoError(f"source: '{folder / NAME}' is damaged ({error}); name the recording instead") from error
    if not exists:
        raise IdRgbdoError(f"source: '{folder}' tracked '{sequence}', which is gone; name the recording instead")
    return sequence, options


def _lists(path: Path, options: Mapping[str, Any]) -> str:
    """Of the texts that say what is tracked. A frame's own file, one of thousands, is left to the images' digest."""
    digest = hashlib.sha256()
    named = [value for value in options.values() if isinstance(value, Path)]
    try:
        beside = sorted(path.iterdir()) if path.is_dir() else [path]
        texts = [file for file in beside if path.is_file() or (file.suffix in LISTS and file.name not in OWN)]
        for file in [*named, *texts]:
            if not file.is_file():
                continue
            with file.open("rb") as stream:
                size = file.stat().st_size
                digest.update(f"{file.name} {size}\n".encode(errors="surrogateescape") + stream.read(MOST_BYTES))
                stream.seek(max(size - MOST_BYTES, 0))
                digest.update(stream.read(MOST_BYTES))
    except OSError as error:
        raise IdRgbdoError(f"sequence: cannot read '{error.filename}': {error.strerror}; check its rights") from error
    return digest.hexdigest()


def _images(frames: Frames) -> str:
    digest = hashlib.sha256(str(frames.timestamps).encode())
    last = len(frames) - 1
    for index in sorted({0, min(1, last), min(2, last), *(last * k // SAMPLED for k in range(1, SAMPLED + 1))}):
        frame = frames.read(index)
        if isinstance(frame, RgbdFrame):
            for image in (frame.gray, frame.depth):
                digest.update(image.contiguous().numpy().tobytes())
    return digest.hexdigest()
