"""The rendered set: complete or not there, along recorded paths or built-in ones, near and far."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.experiments.relatives import RELATIVES, Relative, recorded_for, write_builtin_path
from idrgbdo_torch.experiments.rendering import FurtherSequence, is_rendered, plan_rendering, render, render_missing
from idrgbdo_torch.experiments.sweep import Workers
from idrgbdo_torch.synthetic.paths import handheld_path


def path_rows(relative: Relative, folder: Path, seconds: float = 8.0) -> np.ndarray:
    write_builtin_path(folder / "path.txt", relative, seconds, 3)
    return np.loadtxt(folder / "path.txt")


def test_a_folder_is_complete_or_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (task,) = plan_rendering(["fr2_rpy"], 3, tmp_path, shrink=8)
    assert task.config.trajectory is None and not is_rendered(task)
    import idrgbdo_torch.experiments.rendering as rendering

    def breaks(*_: object) -> None:
        raise OSError("no room")

    with monkeypatch.context() as patch:
        patch.setattr(rendering, "write_tum", breaks)
        with pytest.raises(IdRgbdoError, match="pass another --cache"):
            render(task)
    assert list(tmp_path.iterdir()) == []
    assert render(task) == {"folder": str(task.folder)}
    assert [path.name for path in tmp_path.iterdir()] == [task.folder.name]
    before = (task.folder / "rgb.txt").stat().st_mtime_ns
    render(task)
    render_missing([task], Workers())
    assert (task.folder / "rgb.txt").stat().st_mtime_ns == before
    sequence = open_sequence(task.folder)
    assert len(sequence) == 3 and (sequence.camera.width, sequence.camera.height) == (80, 60)
    assert "rendered" in (task.folder / "rgb.txt").read_text()


def test_a_recorded_trajectory_is_used_where_there_is_one(tmp_path: Path) -> None:
    folder = tmp_path / "trajectories"
    (folder / "rgbd_dataset_freiburg2_xyz").mkdir(parents=True)
    by_name = {relative.name: relative for relative in RELATIVES}
    path_rows(by_name["fr2_xyz"], folder)
    (folder / "path.txt").rename(folder / "rgbd_dataset_freiburg2_xyz" / "groundtruth.txt")
    xyz = folder / "rgbd_dataset_freiburg2_xyz" / "groundtruth.txt"
    assert recorded_for(by_name["fr2_xyz"], folder) == xyz
    assert recorded_for(by_name["fr3_structure_notexture_near"], folder) == xyz  # a similar one
    assert recorded_for(by_name["fr2_xyz"], None) is recorded_for(by_name["fr1_rpy"], folder) is None
    recorded, builtin = plan_rendering(["fr2_xyz", "fr1_rpy"], 5, tmp_path, folder)[::-1]
    assert recorded.config.trajectory == xyz and recorded.config.start == by_name["fr2_xyz"].start
    assert builtin.config.trajectory is None and builtin.config.start == 0.0
    (elsewhere,) = plan_rendering(["fr2_xyz"], 5, tmp_path)
    assert elsewhere.folder != recorded.folder
    with pytest.raises(IdRgbdoError, match="found none"):
        plan_rendering(["fr2_xyz"], 5, tmp_path, tmp_path)


def test_builtin_paths_sway_turn_and_pace_as_asked(tmp_path: Path) -> None:
    base = Relative("x", "desk")
    plain = path_rows(base, tmp_path)
    still = path_rows(replace(base, sway=0.1), tmp_path)
    calm = path_rows(replace(base, turn=0.2), tmp_path)
    assert np.ptp(still[:, 1:4], axis=0) == pytest.approx(0.1 * np.ptp(plain[:, 1:4], axis=0), rel=1e-6)
    assert spread(calm) == pytest.approx(0.2 * spread(plain), rel=0.02)
    path = handheld_path(8.1, 3)
    assert np.abs(plain[:, 1:4] - [path.pose(t)[:3, 3] for t in plain[:, 0]]).max() < 1e-8
    fast = path_rows(replace(base, pace=2.0), tmp_path, 4.0)
    assert fast[:, 0].max() < 4.1 and np.ptp(fast[:, 1]) == pytest.approx(np.ptp(plain[:, 1]), rel=0.1)


def spread(rows: np.ndarray) -> float:
    """RMS angle from the mean rotation."""
    rotations = Rotation.from_quat(rows[:, 4:8])
    return float(np.sqrt((((rotations.mean().inv() * rotations).magnitude()) ** 2).mean()))


@pytest.mark.parametrize("name", ["fr3_nostructure_texture_far", "fr3_structure_texture_far"])
def test_far_scenes_keep_further_off(name: str, tmp_path: Path) -> None:
    (task,) = plan_rendering([name], 3, tmp_path, shrink=8)
    config = replace(task.config, frames=3)
    near, far = (FurtherSequence(config, further).read(1).depth.numpy() for further in (0.0, task.relative.further))
    assert task.relative.further > 0.3
    assert np.median(far[far > 0]) > np.median(near[near > 0]) + 0.2
