"""`idrgbdo mesh`: a recording's depth fused along the poses of a run."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from ..text.configfile import Count, Positive
from ..text.plain import plain
from .input import Input, open_input
from .output import Output, answer

if TYPE_CHECKING:
    from ..datasets import RgbdSequence
    from ..runs.mesh import MeshConfig
    from ..trajectory import Trajectory


@dataclass(frozen=True)
class MeshCommand:
    """Fuse a recording's depth into a coloured mesh, along the poses of a run."""

    sequence: Positional[Path]  # as for `idrgbdo run`
    poses: Positional[Path]  # the folder of a run, or a trajectory, TUM text
    input: Annotated[Input, arg(name="")] = field(default_factory=Input)
    out: Path | None = None  # PLY; else mesh.ply beside the poses
    voxel: Positive = 0.01  # m
    depth_max: Positive = 3.0  # m, farther depth is left out
    blocks: Count = 40_000  # of 8^3 voxels, 6 kB each; where they run out the voxels become larger
    fuse_every: Count = 1  # fuse every n-th frame
    output: Annotated[Output, arg(name="")] = field(default_factory=Output)


def mesh(command: MeshCommand) -> int:
    """Fuse a recording's depth along the poses of a run, or of any trajectory."""
    from ..evaluation import hints
    from ..report.terminal import show_table
    from ..runs.folder import run_trajectory
    from ..runs.mesh import MeshConfig
    from ..trajectory import read_tum

    sequence = open_input(command.sequence, command.input)
    config = MeshConfig(command.voxel, command.depth_max, command.blocks, every=command.fuse_every)
    out = command.out or (command.poses if command.poses.is_dir() else command.poses.parent) / "mesh.ply"
    trajectory = run_trajectory(command.poses) if command.poses.is_dir() else read_tum(command.poses)
    noticed = trajectory.notes if sequence.groundtruth is None else hints(trajectory, sequence.groundtruth)
    for note in noticed:
        print("warning:", plain(note), file=sys.stderr)
    show_table("mesh", [("mesh", fuse_mesh(sequence, trajectory, out, config)), ("results in", str(out))])
    answer(mesh=out, notes=noticed)
    return 0


def fuse_mesh(
    sequence: RgbdSequence, trajectory: Trajectory, out: Path, config: MeshConfig | None = None, terminal: bool = True
) -> str:
    """Fuse and write a mesh, with a bar on a terminal unless told otherwise; what it is, in words."""
    from ..report.terminal import progress_bar
    from ..runs.mesh import fuse

    with progress_bar("mesh", len(sequence) if terminal else None) as advance:
        fused = fuse(sequence, trajectory, config, advance)
    fused.write(out)
    return f"{fused.vertices} vertices from {fused.frames} frames, voxels of {1000 * fused.voxel_m:.3g} mm"
