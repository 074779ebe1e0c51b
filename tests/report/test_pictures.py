"""Pictures of a run: colours tell the bits, the view is from above, and the command writes them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from inspected import Inspected

from idrgbdo_torch.commands import track
from idrgbdo_torch.commands.cli import main
from idrgbdo_torch.definitions import se3
from idrgbdo_torch.definitions.camera import Pinhole
from idrgbdo_torch.frame import BrokenFrame, RgbdFrame
from idrgbdo_torch.odometry import ConstantVelocity, Record, Status, TrackResult, run
from idrgbdo_torch.report.pictures import (
    BAR,
    BLUE,
    CAPTION,
    RED,
    draw_frames,
    draw_points,
    draw_trajectory,
    from_above,
    save,
)

CAMERA = Pinhole(width=640, height=480, fx=500.0, fy=500.0, cx=320.0, cy=240.0)
UV = torch.tensor([[100.0, 200.0], [300.0, 50.0], [620.0, 470.0]], dtype=torch.float64)
BITS = torch.tensor([0.1, 0.4, 0.0], dtype=torch.float64)


def flat_frame(timestamp: float = 0.0, color: bool = True) -> RgbdFrame:
    gray = torch.full((480, 640), 100.0)
    rgb = torch.full((480, 640, 3), 100, dtype=torch.uint8) if color else None
    return RgbdFrame(timestamp, gray, torch.ones(480, 640), CAMERA, rgb)


class Pointing(Inspected):
    """Says that it used three points; every third frame is a keyframe."""

    def track(self, frame: RgbdFrame) -> TrackResult:
        result = super().track(frame)
        number = len(self.trajectory()) - 1
        return TrackResult(result.T_world_cam, Status.OK, keyframe=number % 3 == 0)

    def last_points(self) -> tuple[torch.Tensor, torch.Tensor]:
        return UV, BITS

    def last_candidates(self) -> torch.Tensor:
        return torch.tensor([[400.0, 400.0]], dtype=torch.float64)


def count(picture: np.ndarray, color: tuple[int, int, int]) -> int:
    return int((picture == np.array(color, np.uint8)).all(axis=-1).sum())


@pytest.mark.parametrize("color", [True, False])
def test_points_stand_where_they_are_in_the_colour_of_their_bits(color: bool) -> None:
    picture = draw_points(flat_frame(color=color), UV, BITS, torch.tensor([[400.0, 400.0]]), "some frame")
    assert picture.shape == (480 + CAPTION, 640 + BAR, 3)
    at = [tuple(picture[CAPTION + int(v), int(u)].tolist()) for u, v in UV]
    best, least = (253, 231, 36), (68, 1, 84)  # the ends of viridis
    assert np.abs(np.array(at[1]) - best).max() <= 2
    assert np.abs(np.array(at[2]) - least).max() <= 2
    assert at[0] not in (at[1], at[2])
    assert picture[CAPTION + 400, 400].min() > 230  # a candidate
    assert tuple(picture[CAPTION + 300, 500]) == (75, 75, 75)  # the image, darker


def test_without_points_or_on_a_small_image_there_is_a_picture_too() -> None:
    none = torch.zeros(0, 2, dtype=torch.float64)
    assert draw_points(flat_frame(), none, torch.zeros(0)).shape == (480 + CAPTION, 640 + BAR, 3)
    small = Pinhole(width=160, height=120, fx=100.0, fy=100.0, cx=80.0, cy=60.0)
    frame = RgbdFrame(0.0, torch.full((120, 160), 100.0), torch.ones(120, 160), small)
    picture = draw_points(frame, torch.tensor([[80.0, 60.0]]), torch.tensor([0.3]))
    assert picture.shape == (480 + CAPTION, 640 + BAR, 3)
    assert tuple(picture[CAPTION + 242, 322]) == tuple(picture[CAPTION + 241, 321]) != (75, 75, 75)


def test_from_above_undoes_the_tilt_of_a_camera_that_turns() -> None:
    nod = se3.exp(torch.tensor([0, 0, 0, -0.5, 0, 0], dtype=torch.float64))  # the camera looks down by 0.5 rad
    turns = torch.linspace(-0.8, 0.8, 30, dtype=torch.float64)
    level = se3.exp(torch.stack([torch.zeros(6, dtype=torch.float64) + torch.eye(6)[4] * turn for turn in turns]))
    poses = se3.inverse(nod) @ level @ nod  # the world is the first camera, tilted as it is
    up = nod[:3, :3].T @ torch.tensor([0.0, -1.0, 0.0], dtype=torch.float64)
    R = from_above(poses)
    torch.testing.assert_close(R @ R.T, torch.eye(3, dtype=torch.float64))
    assert torch.det(R) == pytest.approx(1.0)
    assert float(R[2] @ up) > np.cos(0.05)


def test_a_still_camera_looks_ahead() -> None:
    R = from_above(torch.eye(4, dtype=torch.float64).expand(5, 4, 4))
    torch.testing.assert_close(R, torch.tensor([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]], dtype=torch.float64))


def test_the_path_is_drawn_to_scale_with_lost_frames_in_red() -> None:
    poses = torch.eye(4, dtype=torch.float64).repeat(11, 1, 1)
    poses[:, 0, 3] = torch.linspace(0, 1, 11)  # 1 m to the right
    picture = draw_trajectory(poses, keyframes=[0, 5], size=460)
    rows, columns = np.nonzero((picture[2 * CAPTION :] == BLUE).all(axis=-1))  # below the legend
    assert columns.max() - columns.min() == pytest.approx(460 / 1.15, abs=9)  # the ring hides the first bit
    assert rows.max() - rows.min() < 12
    assert count(picture, RED) == 0
    with_lost = draw_trajectory(poses, lost=[3], reference=poses[:, :3, 3] + 0.1, size=460)
    assert count(with_lost, RED) > 20
    assert count(with_lost, (190, 190, 190)) > 400


def test_the_first_keyframes_and_every_50th_frame_are_drawn(tmp_path: Path) -> None:
    frames: list[RgbdFrame | BrokenFrame] = [flat_frame(index / 30) for index in range(53)]
    frames[50] = BrokenFrame(50 / 30, "torn")
    odometry, records = Pointing(), list[Record]()
    run(odometry, draw_frames(frames, odometry, records, tmp_path), records.append)
    drawn = sorted(path.name for path in tmp_path.iterdir())
    assert drawn == ["frame_000000.png", "frame_000003.png", "frame_000006.png"]
    assert cv2.imread(str(tmp_path / drawn[0])).shape == (480 + CAPTION, 640 + BAR, 3)


def test_an_odometry_without_points_gets_no_pictures(tmp_path: Path) -> None:
    odometry, records = ConstantVelocity(), list[Record]()
    run(odometry, draw_frames([flat_frame()], odometry, records, tmp_path / "none"), records.append)
    assert not (tmp_path / "none").exists()


def test_a_picture_is_written_in_its_colours(tmp_path: Path) -> None:
    picture = np.zeros((4, 5, 3), np.uint8)
    picture[..., 0] = 200  # red
    save(tmp_path / "new" / "red.png", picture)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "new" / "red.png"))[..., ::-1], picture)


def test_run_with_figures_writes_them(
    make_recording: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(track, "make_odometry", lambda config: Pointing())
    folder = make_recording(frames=5)
    assert main(["run", str(folder), "--out", str(tmp_path / "with"), "--figures"]) == 0
    names = sorted(path.name for path in (tmp_path / "with" / "figures").iterdir())
    assert names == ["frame_000000.png", "frame_000003.png", "trajectory.png"]
    assert main(["run", str(folder), "--out", str(tmp_path / "without")]) == 0
    assert not (tmp_path / "without" / "figures").exists()
