"""Camera paths: recorded ones follow their file smoothly, the built-in one moves like a hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.synthetic import SynthConfig
from idrgbdo_torch.synthetic.paths import handheld_path, quaternion, recorded_path, rotation_matrix


def trajectory_file(folder: Path, indexed: bool) -> Path:
    """A jittery circle, 100 Hz in seconds or 30 poses a second counted by frame."""
    rng = np.random.default_rng(0)
    n = 400
    t = np.arange(n) / (30.0 if indexed else 100.0)
    q = np.array([quaternion(rotation_matrix(np.array([0, np.sin(a / 2), 0, np.cos(a / 2)]))) for a in t * 0.5])
    q *= np.where(np.arange(n) % 2, 1, -1)[:, None]  # both signs mean the same rotation
    P = np.c_[np.sin(t), 0 * t, np.cos(t)] + rng.normal(0, 0.001, (n, 3))
    stamps = np.arange(n) if indexed else 1e9 + t
    file = folder / "path.txt"
    np.savetxt(file, np.c_[stamps, P, q], fmt="%.9f", header="timestamp tx ty tz qx qy qz qw")
    return file


@pytest.mark.parametrize("indexed", [False, True])
def test_recorded_path_is_smooth_and_follows_the_file(tmp_path: Path, indexed: bool) -> None:
    path = recorded_path(trajectory_file(tmp_path, indexed), 1.0, 2.0)
    start = path.first - (0.0 if indexed else 1e9)
    assert start == pytest.approx(1.0, abs=1e-6)
    for s in np.arange(0.0, 2.01, 0.25):
        T = path.pose(path.first + s)
        t = 1.0 + s
        assert np.linalg.norm(T[:3, 3] - [np.sin(t), 0, np.cos(t)]) < 0.004
        angle = np.arctan2(T[0, 2], T[0, 0])
        assert angle == pytest.approx(0.5 * t, abs=0.01)
    jitter = np.diff([path.pose(path.first + k / 30)[:3, 3] for k in range(60)], 3, axis=0)
    assert np.abs(jitter).max() < 0.001


def test_bad_trajectories_are_named(tmp_path: Path) -> None:
    file = trajectory_file(tmp_path, False)
    with pytest.raises(IdRgbdoError, match="start: expected"):
        recorded_path(file, 3.0, 10.0)
    with pytest.raises(IdRgbdoError, match="trajectory: cannot read"):
        recorded_path(tmp_path / "none.txt", 0.0, 1.0)
    (tmp_path / "short.txt").write_text("1 2 3\n2 3 4\n")
    with pytest.raises(IdRgbdoError, match="8 numbers"):
        recorded_path(tmp_path / "short.txt", 0.0, 1.0)
    with pytest.raises(IdRgbdoError, match="kind"):
        SynthConfig(kind="kitchen")  # type: ignore[arg-type]
    with pytest.raises(IdRgbdoError, match="frames"):
        SynthConfig(frames=0)


def test_built_in_path_moves_like_a_hand() -> None:
    path = handheld_path(8.0, 0)
    T = np.stack([path.pose(t) for t in np.arange(0, 8, 1 / 30)])
    speed = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1) * 30
    assert 0.05 < speed.mean() < 0.8
    assert speed.max() < 1.5
    assert np.allclose(T[:, :3, :3] @ T[:, :3, :3].transpose(0, 2, 1), np.eye(3), atol=1e-9)
    assert (-T[:, 2, 1] > 0.5).all()  # upright: the image's up is the world's z
