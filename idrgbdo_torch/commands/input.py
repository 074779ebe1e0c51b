"""What commands share of their input: how a recording or a trajectory is found, read and configured."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import FlagConversionOff, arg

from ..config import Config
from ..errors import IdRgbdoError
from ..text.configfile import Count, Index, NonNegative, Positive

if TYPE_CHECKING:
    from ..datasets import RgbdSequence
    from ..trajectory import Trajectory


Settings = Annotated[Config, arg(name=""), FlagConversionOff]


@dataclass(frozen=True)
class Input:
    """How the recording is read."""

    camera: Path | None = None  # TOML with fx, fy, cx, cy, or another program's YAML or JSON; else the recording's own
    depth_scale: Positive | None = None  # depth values per metre; else the camera file's or the format's
    format: str | None = None  # tum, icl_nuim, 7scenes, redwood, replica, scannet, ros, record3d, stray_scanner, folder
    max_frames: Count | None = None  # stop after so many
    every: Count = 1  # take every n-th frame
    start: Index = 0  # frames left out at the beginning
    associations: Path | None = None  # list `timestamp colour timestamp depth`; else images are paired by time
    association_limit: NonNegative = 0.02  # s, between the two images of a pair
    color_topic: str | None = None  # of a ROS recording; else the likeliest
    depth_topic: str | None = None  # the same; choose one that is registered to colour


def open_input(path: Path, options: Input) -> RgbdSequence:
    """The recording at a path, read as the options say."""
    from ..datasets import open_sequence

    return open_sequence(
        path,
        format=options.format,
        camera=options.camera,
        associations=options.associations,
        depth_scale=options.depth_scale,
        association_limit_s=options.association_limit,
        color_topic=options.color_topic,
        depth_topic=options.depth_topic,
        start=options.start,
        every=options.every,
        max_frames=options.max_frames,
    )


def reference_of(path: Path) -> Trajectory:
    """The poses of a TUM text, or the reference of a recording of any format. Raises IdRgbdoError for one without."""
    from ..datasets import open_sequence
    from ..trajectory import read_tum

    if (path.suffix != ".r3d" and not path.is_dir()) or (path / "groundtruth.txt").exists():
        return read_tum(file_in(path, "groundtruth.txt"))
    reference = open_sequence(path).groundtruth
    if reference is None:
        raise IdRgbdoError(
            f"groundtruth: the recording '{path}' holds no reference poses; pass a file of them, TUM text"
        )
    return reference


def file_in(path: Path, name: str) -> Path:
    """The file itself, or the one of that name in a folder."""
    return path / name if path.is_dir() else path


def input_of_run(run: Path, options: Input) -> tuple[Path, Input]:
    """What a run tracked and how it was read, up to the last frame that it tracked."""
    from ..runs.source import recall
    from ..trajectory import read_tum

    if replace(options, max_frames=None) != Input():
        raise IdRgbdoError("source: a run is filmed as it was read; only --max-frames may be given")
    sequence, values = recall(run)
    tracked = len(read_tum(run / "trajectory.txt"))
    try:
        for name in ("camera", "associations"):
            values[name] = Path(values[name]) if values.get(name) else None
        frames = {"max_frames": min(tracked, options.max_frames or tracked)}
        return sequence, replace(options, **values | frames)
    except TypeError as error:
        raise IdRgbdoError(
            f"source: what '{run}' tracked is of another version ({error}); name the recording"
        ) from error
