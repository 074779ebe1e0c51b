"""`idrgbdo video`: a run or a recording as a film."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..config import Config
from ..errors import IdRgbdoError
from ..text import configfile
from .input import Input, Settings, input_of_run, open_input
from .output import Output, answer

FPS = 30.0  # where the recording does not say


@dataclass(frozen=True)
class VideoCommand:
    """Film a run or a recording: every frame with its tracked points, coloured by what each is worth."""

    source: Positional[Path]  # the folder of a run, which is tracked again; or a recording, as for `idrgbdo run`
    settings: Settings = field(default_factory=Config)
    input: Annotated[Input, arg(name="")] = field(default_factory=Input)
    config: Path | None = None  # TOML; its values are the defaults of the flags
    out: Path | None = None  # .mp4 or .gif; else video.mp4 in the run's folder, or in runs/<sequence>
    fps: configfile.Positive | None = None  # frames per second; else the recording's own
    width: configfile.Count | None = None  # px; else as large as the images, 480 for a gif
    output: Annotated[Output, arg(name="")] = field(default_factory=Output)


def video(command: VideoCommand) -> int:
    """Track a recording, or that of a run again with the same settings, and write what is seen."""
    from statistics import median

    from ..report.terminal import progress_bar, show_table
    from ..report.video import pictures, write_video
    from ..tracker.id_rgbdo import IdRgbdo

    sequence, settings, options, out = command.source, command.settings, command.input, command.out
    if (sequence / "frames.csv").exists():
        if settings != Config():
            raise IdRgbdoError("settings: a run is filmed with its own; leave them out, or name the recording instead")
        settings = configfile.load(command.source / "config.toml", Config())
        out = out or command.source / "video.mp4"
        sequence, options = input_of_run(command.source, options)
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
    answer(frames=count, frames_per_second=fps, video=out)
    return 0
