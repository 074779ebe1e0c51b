"""`idrgbdo video`: frames in, a film out that reads back; a run is filmed as it was tracked."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from rendered import Film

from idrgbdo_torch import BrokenFrame, IdRgbdo, RgbdFrame
from idrgbdo_torch.commands import cli
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.report.pictures import Picture
from idrgbdo_torch.report.video import GIF_FRAMES, pictures, write_video
from idrgbdo_torch.synthetic import SynthConfig, synth


def read(path: Path) -> list[Picture]:
    """All frames of a film, RGB."""
    film, frames = cv2.VideoCapture(str(path)), []
    while True:
        there, frame = film.read()
        if not there:
            return frames
        frames.append(np.asarray(frame[..., ::-1], dtype=np.uint8))


def plain(count: int, height: int = 61, width: int = 90) -> list[Picture]:
    """Pictures that turn from black to red."""
    return [np.full((height, width, 3), (round(200 * k / count), 0, 0), np.uint8) for k in range(count)]


def colorful(picture: Picture) -> np.ndarray:
    """Where a picture is far from gray."""
    return (picture.max(axis=-1).astype(int) - picture.min(axis=-1)) > 60


def test_a_frame_shows_its_points_in_the_colours_of_their_bits(desk: Film) -> None:
    gray = [RgbdFrame(f.timestamp, f.gray, f.depth, f.camera) for f in desk.frames[:6]]  # so that only points are not
    odometry = IdRgbdo()
    seen = []
    for picture in pictures(gray, odometry):
        uv, bits = odometry.last_points()
        seen.append((picture, uv.numpy(), bits.numpy()))
    assert len(seen) == 6
    picture, uv, bits = seen[-1]
    height, width = picture.shape[0] - 26, picture.shape[1] - 86
    zoom = width / 320
    assert zoom == 2 and height == 2 * 240
    at = (2 * uv + 0.5).round().astype(int)
    inside = colorful(picture)[26:, :width]
    best, worst = bits.argmax(), bits.argmin()
    assert all(inside[v, u] for u, v in at[[best, worst]])
    yellow, blue = (picture[26 + at[k, 1], at[k, 0]].astype(int) for k in (best, worst))
    assert yellow[:2].min() > yellow[2] and blue[2] > blue[0]
    away = np.ones(inside.shape, dtype=bool)
    for u, v in at:
        away[max(v - 9, 0) : v + 10, max(u - 9, 0) : u + 10] = False
    assert not (inside & away).any()


def test_doubtful_frames_are_framed_and_unreadable_ones_left_out(desk: Film) -> None:
    black = RgbdFrame(desk.frames[4].timestamp, torch.zeros(240, 320), torch.zeros(240, 320), desk.frames[4].camera)
    frames = [*desk.frames[:3], BrokenFrame(0.1, "half a file"), black, desk.frames[5]]
    shots = list(pictures(frames, IdRgbdo()))
    assert len(shots) == 5
    assert shots[1][-1, 0].tolist() != [205, 48, 48] and shots[3][-1, 0].tolist() == [205, 48, 48]


@pytest.mark.parametrize("name", ["film.mp4", "film.gif", "FILM.MP4"])
def test_what_is_written_reads_back(tmp_path: Path, name: str) -> None:
    path = tmp_path / "new" / name
    assert write_video(path, plain(12), 10.0, width=80) == 12
    frames = read(path)
    assert len(frames) == 12 and frames[0].shape == (54, 80, 3)
    reds = [float(frame[..., 0].mean()) for frame in frames]
    assert reds == sorted(reds) and reds[-1] > 170 and max(frame[..., 1:].max() for frame in frames) < 30
    assert cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FPS) == pytest.approx(10.0)
    assert [file.name for file in path.parent.iterdir()] == [name]  # no draft left


def test_a_long_gif_leaves_frames_out_and_keeps_its_speed(tmp_path: Path) -> None:
    path = tmp_path / "long.gif"
    count = 2 * GIF_FRAMES + 10
    assert write_video(path, (picture for picture in plain(count, 8, 12)), 30.0, width=12) == count
    frames = len(read(path))
    assert GIF_FRAMES / 2 <= frames <= GIF_FRAMES
    fps = cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FPS)
    assert frames / fps == pytest.approx(count / 30, rel=0.05)


def test_a_film_that_fails_leaves_nothing(tmp_path: Path) -> None:
    def broken() -> list[Picture]:
        raise IdRgbdoError("no more")

    for suffix in ("mp4", "gif"):
        with pytest.raises(IdRgbdoError, match="no more"):
            write_video(
                tmp_path / f"x.{suffix}", (picture for part in (lambda: plain(2), broken) for picture in part()), 5.0
            )
        assert write_video(tmp_path / f"x.{suffix}", [], 5.0) == 0
    assert not list(tmp_path.iterdir())
    with pytest.raises(IdRgbdoError, match=r"ending in .mp4 or .gif, got '.*x.avi'"):
        write_video(tmp_path / "x.avi", plain(2), 5.0)
    (tmp_path / "file").write_text("")
    with pytest.raises(IdRgbdoError, match="cannot make"):
        write_video(tmp_path / "file" / "x.mp4", plain(2), 5.0)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    folder = tmp_path / "desk"
    synth(SynthConfig(frames=6, width=160, height=120, fx=131.25, fy=131.25, cx=79.5, cy=59.5, samples=1), folder)
    return folder


def test_the_command_films_a_recording_and_a_run(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["video", "desk", "--max-frames", "3", "--selection.points", "12"]) == 0
    assert len(read(Path("runs/desk/video.mp4"))) == 3
    assert cli.main(["run", "desk", "--every", "2", "--out", "run", "--selection.points", "12"]) == 0
    assert json.loads(Path("run/input.json").read_text())["every"] == 2
    capsys.readouterr()
    monkeypatch.chdir("run")  # the run knows its recording from anywhere
    assert cli.main(["video", ".", "--out", "film.gif", "--fps", "5"]) == 0
    assert "film.gif" in capsys.readouterr().out
    assert len(read(Path("film.gif"))) == 3
    monkeypatch.chdir(tmp_path)
    assert cli.main(["video", "run"]) == 0 and len(read(Path("run/video.mp4"))) == 3


def test_a_run_that_cannot_be_filmed_says_why(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    assert cli.main(["run", str(recording), "--out", str(run)]) == 0

    def complaint(*more: str) -> str:
        capsys.readouterr()
        assert cli.main(["video", str(run), *more]) == 1
        (line,) = capsys.readouterr().err.splitlines()
        return line

    assert "filmed with its own" in complaint("--selection.points", "100")
    kept = (run / "input.json").read_text()
    (run / "input.json").write_text(kept.replace('"every"', '"evry"'))
    assert "another version" in complaint()
    (run / "input.json").write_text(kept[:20])
    assert "is damaged" in complaint()
    (run / "input.json").unlink()
    assert "does not say what it tracked" in complaint()
    (run / "input.json").write_text(kept)
    recording.rename(recording.with_name("gone"))
    assert "which is gone" in complaint()


def test_paths_in_what_was_tracked_are_absolute(
    make_recording: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = make_recording()
    monkeypatch.chdir(folder.parent)
    Path("camera.toml").write_text("fx = 60\nfy = 60\ncx = 31.5\ncy = 23.5\n")
    assert cli.main(["run", folder.name, "--camera", "camera.toml", "--out", "run"]) == 0
    written = json.loads(Path("run/input.json").read_text())
    assert written["sequence"] == str(folder.resolve()) and Path(written["camera"]).is_absolute()
    assert written["depth_scale"] is None
