"""Rendered relatives of the 18 TUM sequences of Table 1: which scene, and along which path."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..synthetic.config import Kind

if TYPE_CHECKING:
    from ..synthetic.paths import CameraPath

SAMPLES_HZ = 100.0  # of a written path, as motion capture has


@dataclass(frozen=True)
class Relative:
    """What a sequence has in common with its namesake."""

    name: str
    kind: Kind
    similar: str = ""  # another recorded trajectory to film along, where the namesake's own is not there
    start: float = 2.0  # s into it
    further: float = 0.0  # m by which the scene keeps further off
    sway: float = 1.0  # size of the built-in path's translation, where no recorded one is there
    turn: float = 1.0  # of its rotation
    pace: float = 1.0  # and its speed


FAST = 1.5  # the freiburg1 set was recorded in haste
RELATIVES = (
    Relative("fr1_desk", "desk", pace=FAST),
    Relative("fr1_floor", "nostructure_texture", "freiburg1_desk2", pace=FAST),
    Relative("fr1_plant", "desk", "7scenes_pumpkin", pace=FAST),
    Relative("fr1_rpy", "desk", sway=0.15, turn=1.3, pace=FAST),
    Relative("fr1_xyz", "desk", turn=0.2, pace=FAST),
    Relative("fr2_desk", "desk", start=10.0),
    Relative("fr2_dishes", "desk", "7scenes_redkitchen", start=5.0),
    Relative("fr2_rpy", "desk", sway=0.08, turn=0.5, pace=0.7),
    Relative("fr2_xyz", "desk", start=5.0, turn=0.1, pace=0.7),
    Relative("fr3_cabinet", "poor", "7scenes_chess"),
    Relative("fr3_large_cabinet", "poor", "7scenes_fire", further=0.4),
    Relative("fr3_long_office_household", "desk"),
    Relative("fr3_nostructure_texture_far", "nostructure_texture", "7scenes_office", further=0.8),
    Relative("fr3_nostructure_texture_near", "nostructure_texture", "freiburg2_desk", 40.0),
    Relative("fr3_structure_notexture_far", "structure_notexture", "freiburg3_long_office_household", 40.0, 0.5),
    Relative("fr3_structure_notexture_near", "structure_notexture", "freiburg2_xyz", 40.0),
    Relative("fr3_structure_texture_far", "structure_texture", "freiburg3_long_office_household", 20.0, 0.5),
    Relative("fr3_structure_texture_near", "structure_texture", "freiburg1_xyz", 12.0),
)


def recorded_for(relative: Relative, folder: Path | None) -> Path | None:
    """The trajectory in `folder` to film along: the namesake's own, else the similar one; None without either.

    NAME.txt, or NAME/groundtruth.txt as the benchmark's folders have it, NAME being for example freiburg1_desk.
    """
    if folder is None:
        return None
    for name in (relative.name.replace("fr", "freiburg", 1), relative.similar):
        if name:
            for path in (f"{name}.txt", f"{name}/groundtruth.txt", f"rgbd_dataset_{name}/groundtruth.txt"):
                if (folder / path).is_file():
                    return folder / path
    return None


def write_builtin_path(file: Path, relative: Relative, seconds: float, seed: int) -> None:
    """A hand-held path of the relative's sway, turn and pace, as TUM text that begins at 0 s."""
    from scipy.spatial.transform import Rotation

    from ..synthetic.paths import handheld_path

    times = np.arange(0.0, seconds + 1.0 / SAMPLES_HZ, 1.0 / SAMPLES_HZ)
    path: CameraPath = handheld_path(seconds * relative.pace + 0.1, seed)
    poses = np.stack([path.pose(t * relative.pace) for t in times])
    middle = poses[:, :3, 3].mean(axis=0)
    positions = middle + relative.sway * (poses[:, :3, 3] - middle)
    rotations = Rotation.from_matrix(poses[:, :3, :3])
    mean = rotations.mean()
    turned = mean * Rotation.from_rotvec(relative.turn * (mean.inv() * rotations).as_rotvec())
    rows = np.column_stack([times, positions, turned.as_quat()])
    np.savetxt(file, rows, fmt="%.9f", header=f"built-in hand-held path for {relative.name}, seed {seed}")
