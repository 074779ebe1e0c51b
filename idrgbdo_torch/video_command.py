"""What `idrgbdo video` does; what it asks for stands in options.py, beside the options that it shares."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

from . import configfile
from .config import Config
from .errors import IdRgbdoError

if TYPE_CHECKING:
    from .options import Input, VideoCommand

FPS = 30.0  # where the recording does not say


def video(command: VideoCommand) -> int:
    """Track a recording, or that of a run again with the same settings, and write what is seen."""
    from .commands import open_input
    from .id_rgbdo import IdRgbdo
    from .terminal import progress_bar, show_table
    from .video import pictures, write_video

    sequence, settings, options, out = command.source, command.settings, command.input, command.out
    if (sequence / "frames.csv").exists():
        if settings != Config():
            raise IdRgbdoError("settings: a run is filmed with its own; leave them out, or name the recording instead")
        settings = configfile.load(command.source / "config.toml", Config())
        out = out or command.source / "video.mp4"
        sequence, options = _input_of(command.source, options)
    recording = open_input(sequence, options)
    out = out or Path("runs") / recording.name / "video.mp4"
    gaps = [b - a for a, b in zip(recording.timestamps, recording.timestamps[1:], strict=False) if b > a]
    fps = command.fps or (min(1 / median(gaps), 60.0) if gaps else FPS)
    with progress_bar(f"filming {recording.name}", len(recording)) as advance:
        shots = pictures(recording, IdRgbdo(settings), lambda result: advance(result.status.value))
        count = write_video(out, shots, fps, command.width)
    if not count:
        raise IdRgbdoError(f"source: no frame of '{sequence}' could be read; try idrgbdo check")
    show_table(recording.name, [("frames", str(count)), ("frames per second", f"{fps:.1f}"), ("video", str(out))])
    return 0


def _input_of(run: Path, options: Input) -> tuple[Path, Input]:
    """What a run tracked and how it was read, up to the last frame that it tracked."""
    from .source import recall
    from .trajectory import read_tum

    sequence, values = recall(run)
    for name in ("camera", "associations"):
        values[name] = Path(values[name]) if values.get(name) else None
    try:
        return sequence, replace(options, **values | {"max_frames": max(1, len(read_tum(run / "trajectory.txt")))})
    except TypeError as error:
        raise IdRgbdoError(
            f"source: what '{run}' tracked is of another version ({error}); name the recording"
        ) from error
