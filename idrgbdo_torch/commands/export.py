"""`idrgbdo export`: a run handed on to other tools."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from ..errors import IdRgbdoError
from ..text.configfile import Count
from .input import Input, input_of_run, open_input
from .output import Output, answer

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..datasets import RgbdSequence
    from ..export.tracked import Chosen, TrackedRun
    from ..report.terminal import Rows
    from ..trajectory import Trajectory

Kind = Literal["nerfstudio", "colmap", "gsplat", "ply", "evo", "kitti", "ros1", "ros2"]
WITH_IMAGES = ("nerfstudio", "colmap", "gsplat")
ROS = {"ros1": "odometry.bag", "ros2": "odometry.mcap"}


@dataclass(frozen=True)
class ExportCommand:
    """Hand a run on: to splat and NeRF trainers, COLMAP, trajectory tools, robots. See docs/export.md."""

    run: Positional[Path]  # the folder of a run
    to: Kind  # for whom
    out: Path | None = None  # folder, or .bag and .mcap file; else RUN/export/<to>
    every: Count = 1  # one of so many frames in a row
    sharpest: bool = False  # of these the sharpest, else the first
    weak: bool = False  # frames with status weak too
    axes: Literal["optical", "body"] = "optical"  # of a robot's poses: z forward and y down, or x forward and z up
    output: Annotated[Output, arg(name="")] = field(default_factory=Output)


def export(command: ExportCommand) -> int:
    """Write what another tool reads, and say what was left out."""
    from ..export.own import make_folder
    from ..export.tracked import load_run, thinned, trusted
    from ..report.terminal import show_table

    run = load_run(command.run)
    chosen = trusted(run, command.weak)
    recording = None
    if command.to in WITH_IMAGES or command.sharpest:
        recording = _recording_of(run)
    read = recording.read if recording and command.sharpest else None
    frames: Sequence[int] = thinned(chosen.frames, command.every, read)
    out = command.out or command.run / "export" / command.to
    if command.to in ROS:
        out = command.out or command.run / "export" / ROS[command.to]
        if (out.suffix == ".bag") != (command.to == "ros1"):
            raise IdRgbdoError(f"out: '{out}' does not fit {command.to}; end it with .bag for ROS 1, .mcap for ROS 2")
        rows = [("results in", str(write_odometry(run, chosen, frames, out, command.axes)))]
    else:
        make_folder(out, command.to, ours=out.resolve() == (command.run / "export" / command.to).resolve())
        if recording and command.to in WITH_IMAGES:
            frames, rows = _with_images(run, chosen, frames, recording, command.to, out)
        else:
            rows = _poses(run, chosen, frames, command.to, out)
        rows.append(("results in", str(out)))
    left = ", ".join(f"{count} {reason}" for reason, count in chosen.left_out.items())
    counts = [("frames", f"{len(frames)} of {len(run.times)}"), ("left out", left or "none for its pose")]
    show_table(f"{command.to} of {command.run.name}", [*counts, *rows])
    answer(frames=len(frames), of=len(run.times), left_out=dict(chosen.left_out), out=out)
    return 0


def write_odometry(
    run: TrackedRun, chosen: Chosen, frames: Sequence[int], out: Path, axes: Literal["optical", "body"]
) -> Path:
    """Poses, path and transforms as a recording: of ROS 1 where its name ends in .bag, else of ROS 2; where it lies."""
    from ..export.bag import Names, write_bag

    write_bag(out, 1 if out.suffix == ".bag" else 2, run, frames, set(chosen.frames), Names(axes))
    return out


def _recording_of(run: TrackedRun) -> RgbdSequence:
    """What a run tracked, with the same frames."""
    sequence, options = input_of_run(run.folder, Input())
    recording = open_input(sequence, options)
    run.check_times(recording.timestamps)
    return recording


def _with_images(
    run: TrackedRun, chosen: Chosen, frames: Sequence[int], recording: RgbdSequence, to: str, out: Path
) -> tuple[Sequence[int], Rows]:
    """Images and what says where they were taken; the frames that are there, and rows to show."""
    import numpy as np

    from ..export import colmap, images, nerfstudio, points
    from ..report.terminal import progress_bar
    from ..tracker.mapping import write_ply

    cloud, host = points.of_frames(run, points.read_map(run.folder, chosen.segment), chosen.frames)
    if to != "nerfstudio":  # the keyframes have the points
        frames = sorted({*frames, *np.unique(host[host >= 0]).tolist()})
    with progress_bar(to, len(frames)) as advance:
        written = images.write_images(out, frames, recording.read, to != "gsplat", advance)
    rows = [("unreadable", str(written.broken))] if written.broken else []
    if to == "nerfstudio":
        nerfstudio.write_transforms(out, run, written.frames, recording.camera)
        write_ply(out / nerfstudio.POINTS, cloud)
        return written.frames, [*rows, ("points", str(len(cloud)))]
    seen = points.observe(run, cloud, host, recording.camera, recording.read)
    model = colmap.make_model(run, written.frames, recording.camera, seen, cloud.xyz.astype(np.float64), cloud.rgb)
    colmap.write_binary(out / "sparse" / "0", model)
    if to == "colmap":
        colmap.write_text(out / "sparse" / "text", model)
    count = f"{len(model.point)} of {len(cloud)}, seen {model.observations} times"
    error = f"{np.median(model.error):.2f} px" if len(model.error) else "no point was found twice"
    return written.frames, [*rows, ("points", count), ("median error", error)]


def _poses(run: TrackedRun, chosen: Chosen, frames: Sequence[int], to: str, out: Path) -> Rows:
    """The poses alone, or with the points; rows to show."""
    from ..export import points, trajectories

    if to == "kitti":
        names = trajectories.write_kitti(out, run, frames)
    elif to == "evo":
        names = trajectories.write_evo(out, run, frames, _reference(run))
    else:
        cloud, _ = points.of_frames(run, points.read_map(run.folder, chosen.segment), chosen.frames)
        names = trajectories.write_clouds(out, run, frames, cloud)
    return [("files", ", ".join(names))]


def _reference(run: TrackedRun) -> Trajectory | None:
    """The reference poses of what a run tracked, where it is still there and has any."""
    try:
        return _recording_of(run).groundtruth
    except IdRgbdoError:
        return None
