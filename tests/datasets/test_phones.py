"""Recordings of phones: films written as Record3D and Stray Scanner do, and a real one converted back."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import format_writers
import numpy as np
import phone_writers
import pytest
import torch
from rendered import Film

from idrgbdo_torch import IdRgbdo
from idrgbdo_torch.commands import cli
from idrgbdo_torch.datasets import RgbdSequence, guess, open_sequence
from idrgbdo_torch.datasets.video import Video
from idrgbdo_torch.definitions.se3 import inverse
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.evaluation import evaluate
from idrgbdo_torch.frame import BrokenFrame, RgbdFrame
from idrgbdo_torch.odometry import Status, run
from idrgbdo_torch.trajectory import read_tum

LAYOUTS: dict[str, tuple[str, str, Callable[[Film, Path], object]]] = {
    "r3d": ("take.r3d", "record3d", phone_writers.r3d),
    "unpacked": ("take", "record3d", phone_writers.r3d_unpacked),
    "exr": ("EXR_RGBD", "record3d", phone_writers.record3d_exr),
    "stray": ("c26b6838a9", "stray_scanner", phone_writers.stray),
}


@pytest.fixture(scope="session")
def film(desk: Film) -> Film:
    """30 frames of the rendered desk."""
    return Film(desk.frames[:30], desk.groundtruth.at(torch.arange(30)))


@pytest.fixture(scope="session")
def short(desk: Film) -> Film:
    """8 frames of it."""
    return Film(desk.frames[:8], desk.groundtruth.at(torch.arange(8)))


def error_m(sequence: RgbdSequence) -> float:
    """ATE of a run against the recording's own reference."""
    done = run(IdRgbdo(), sequence)
    assert Status.LOST not in done.statuses
    assert sequence.groundtruth is not None
    return evaluate(done.trajectory(), sequence.groundtruth).ate.rmse_m


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_phones_film_is_tracked_as_it_is(layout: str, film: Film, tmp_path: Path) -> None:
    name, format, write = LAYOUTS[layout]
    write(film, tmp_path / name)
    assert guess(tmp_path / name) == format
    sequence = open_sequence(tmp_path / name)
    assert (len(sequence), sequence.warnings, sequence.name) == (30, [], Path(name).stem)
    assert (np.diff(sequence.timestamps) == pytest.approx(1 / 30)) and sequence.camera == film.frames[0].camera
    frame = sequence[9]
    assert isinstance(frame, RgbdFrame)
    known = (frame.depth > 0) & (film.frames[9].depth > 0)
    assert float(known.float().mean()) > 0.7
    assert float((frame.depth - film.frames[9].depth)[known].abs().median()) < 0.01
    assert float((frame.gray - film.frames[9].gray).abs().median()) < 3
    assert float(frame.depth.max()) < phone_writers.LOW / 2  # what is of low confidence is not there
    truth = sequence.groundtruth
    assert truth is not None
    found, expected = (inverse(T[0]) @ T for T in (truth.T_world_cam, film.groundtruth.T_world_cam))
    torch.testing.assert_close(found, expected, atol=1e-6, rtol=0)
    assert error_m(sequence) <= 0.003


def test_a_real_recording_put_back_into_record3ds_layout(data_dir: Path, tmp_path: Path) -> None:
    """Real images, depth and poses of an iPhone."""
    source, folder = data_dir / "iphone_door_40", tmp_path / "EXR_RGBD"
    truth = read_tum(source / "groundtruth.txt")
    values = dict(
        line.split(" = ") for line in (source / "camera.toml").read_text().split("[depth]")[0].splitlines() if line
    )
    fx, fy, cx, cy = (float(values[name]) for name in ("fx", "fy", "cx", "cy"))
    turned = torch.from_numpy(phone_writers.OPENGL[:3, :3])
    quaternions = phone_writers.quaternion_from_rotation(truth.T_world_cam[:, :3, :3] @ turned)
    rows = (truth.timestamps * 60).round().long()  # numbers of the frames, of which the text leaves one out
    nearest = (rows[None] - torch.arange(int(rows.max()) + 1)[:, None]).abs().argmin(1)
    poses = torch.cat([quaternions, truth.positions], 1)[nearest].tolist()
    colors, depths = (sorted((source / kind).iterdir()) for kind in ("color", "depth"))
    (folder / "rgb").mkdir(parents=True)
    (folder / "depth").mkdir()
    numbers = [int(color.stem) for color in colors]  # of a longer recording, whose poses are all there
    for number, color, depth in zip(numbers, colors, depths, strict=True):
        (folder / "rgb" / f"{number}.jpg").symlink_to(color)
        phone_writers.write_exr(folder / "depth" / f"{number}.exr", np.load(depth))
    said = {"K": [fx, 0, 0, 0, fy, 0, cx, cy, 1], "w": 1440, "h": 1920, "dw": 192, "dh": 256, "fps": 60, "poses": poses}
    (folder / "metadata.json").write_text(json.dumps(said))
    sequence = open_sequence(folder)
    assert sequence.recognised.startswith("Record3D: 40 frames of 1440x1920, depth in metres, with ground truth")
    assert sequence.groundtruth is not None
    expected = truth.at(torch.isin(rows, torch.tensor(numbers)))
    torch.testing.assert_close(sequence.groundtruth.T_world_cam, expected.T_world_cam, atol=1e-5, rtol=0)
    thinned = open_sequence(folder, every=4)
    assert error_m(thinned) < 0.005
    frame, as_it_was = sequence[3], open_sequence(source)[3]
    assert isinstance(frame, RgbdFrame) and isinstance(as_it_was, RgbdFrame)
    torch.testing.assert_close(frame.depth, as_it_was.depth, atol=1e-4, rtol=0)


def breathing(film: Film) -> tuple[Film, list[list[float]]]:
    """The film through a lens whose focal length swings by 2 %, and fx, fy, cx, cy of each frame."""
    frames, lenses = [], []
    for index, frame in enumerate(film.frames):
        c, zoom = frame.camera, 1 + 0.02 * np.sin(index / 4)
        A = np.array([[zoom, 0, c.cx * (1 - zoom)], [0, zoom, c.cy * (1 - zoom)]])
        assert frame.color is not None
        images = [
            cv2.warpAffine(image, A, (c.width, c.height), flags=flags)
            for image, flags in ((frame.color.numpy(), cv2.INTER_CUBIC), (frame.depth.numpy(), cv2.INTER_NEAREST))
        ]
        frames.append(replace(frame, color=torch.from_numpy(images[0]), depth=torch.from_numpy(images[1])))
        lenses.append([c.fx * zoom, c.fy * zoom, c.cx, c.cy])
    return Film(tuple(frames), film.groundtruth), lenses


def test_a_lens_that_breathes_is_held_still(film: Film, tmp_path: Path) -> None:
    wide, lenses = breathing(film)
    phone_writers.stray(wide, tmp_path / "known", lenses=lenses)
    phone_writers.stray(wide, tmp_path / "unknown")
    phone_writers.r3d(wide, tmp_path / "known.r3d", perFrameIntrinsicCoeffs=lenses)
    unknown = error_m(open_sequence(tmp_path / "unknown"))
    for name in ("known", "known.r3d"):
        known = error_m(open_sequence(tmp_path / name))
        assert known < 0.003 and known < unknown / 3


def test_a_video_is_read_as_its_sensor_saw_it(short: Film, tmp_path: Path) -> None:
    """Not as it is to be shown; and any frame of it, in any order."""
    phone_writers.stray(short, tmp_path / "upright", turned=True)
    path = tmp_path / "upright" / "rgb.mp4"
    shown = cv2.VideoCapture(str(path))
    assert shown.read()[1].shape == (320, 240, 3)  # OpenCV's own choice
    video = Video(path)
    for index in (3, 4, 4, 1, 7, 0):
        image = video.read(index)
        assert image.shape == (240, 320, 3)
        away = [float(np.abs(image.astype(int) - format_writers.color(short, k)).mean()) for k in range(8)]
        assert int(np.argmin(away)) == index
    with pytest.raises(IdRgbdoError, match=r"frame 8 cannot be decoded, the video ends after 8; copy or download it"):
        video.read(8)
    assert video.read(2).shape == (240, 320, 3)
    assert len(open_sequence(tmp_path / "upright")) == 8


def test_a_video_that_was_turned_or_cut_is_refused(short: Film, tmp_path: Path) -> None:
    phone_writers.stray(short, tmp_path / "take")
    upright = [np.ascontiguousarray(np.rot90(format_writers.color(short, k))) for k in range(8)]
    phone_writers.write_video(tmp_path / "take" / "rgb.mp4", upright, codec="libx264")
    with pytest.raises(
        IdRgbdoError, match="expected colour and depth of one shape, got 240x320 and 256x192: one of them"
    ):
        open_sequence(tmp_path / "take")


def test_what_is_missing_in_a_stray_folder(short: Film, tmp_path: Path) -> None:
    folder = tmp_path / "take"
    phone_writers.stray(short, folder)
    (folder / "depth" / "000002.png").unlink()
    (folder / "confidence" / "000003.png").unlink()
    (folder / "odometry.csv").write_text("timestamp, frame, x\n1.0, 000000\n")
    with pytest.raises(IdRgbdoError, match=r"odometry\.csv: expected the columns timestamp, frame, x, y, z, qx"):
        open_sequence(folder)
    (folder / "odometry.csv").unlink()
    sequence = open_sequence(folder)
    assert sequence.warnings == ["the video has 8 frames and depth/ 7 images; 7 have both, the others are left out"]
    assert sequence.groundtruth is None and sequence.timestamps == pytest.approx(
        [k / 30 for k in (0, 1, 3, 4, 5, 6, 7)]
    )
    assert all(isinstance(frame, RgbdFrame) for frame in sequence)
    (folder / "rgb.mp4").write_bytes((folder / "rgb.mp4").read_bytes()[:500])
    with pytest.raises(IdRgbdoError, match="expected a video that OpenCV can decode"):
        open_sequence(folder)
    (folder / "rgb.mp4").unlink()
    with pytest.raises(IdRgbdoError, match=r"expected rgb\.mp4 in"):
        open_sequence(folder, format="stray_scanner")


def test_the_first_app_wrote_no_names_and_no_times(short: Film, tmp_path: Path) -> None:
    phone_writers.stray(short, tmp_path / "old")
    lines = (tmp_path / "old" / "odometry.csv").read_text().splitlines()[1:]
    (tmp_path / "old" / "odometry.csv").write_text("\n".join(line.split(", ", 2)[2] for line in lines))
    sequence = open_sequence(tmp_path / "old")
    assert sequence.timestamps == pytest.approx([k / 30 for k in range(8)])
    assert error_m(sequence) < 0.002


def test_damage_in_an_r3d_costs_a_frame(short: Film, tmp_path: Path) -> None:
    files = phone_writers.r3d_unpacked(short, tmp_path / "take")
    for index, which in ((2, 0), (5, 1)):
        path = files(index)[which]
        path.write_bytes(path.read_bytes()[:300])
    broken = {
        index: frame.reason
        for index, frame in enumerate(open_sequence(tmp_path / "take"))
        if isinstance(frame, BrokenFrame)
    }
    assert list(broken) == [2, 5] and all("download it again" in reason for reason in broken.values())
    archive = phone_writers.r3d(short, tmp_path / "take.r3d")
    archive.write_bytes(archive.read_bytes()[:5000])
    with pytest.raises(IdRgbdoError, match="cannot open the recording"):
        open_sequence(archive)
    (tmp_path / "take" / "metadata").write_text('{"K": [1, 2]}')
    with pytest.raises(IdRgbdoError, match="expected the camera's matrix K in the metadata"):
        open_sequence(tmp_path / "take")


def test_times_of_the_metadata_and_images_that_are_gone(short: Film, tmp_path: Path) -> None:
    """Poses and times stay with the numbers of the images."""
    stamps = [0.1 + k / 60 + 0.001 * (k % 2) for k in range(8)]
    files = phone_writers.record3d_exr(short, tmp_path / "take", frameTimestamps=stamps)
    files(3)[1].unlink()
    sequence = open_sequence(tmp_path / "take")
    assert sequence.timestamps == pytest.approx([*stamps[:3], *stamps[4:]])
    assert sequence.warnings == ["1 image has no partner of the same number and is left out: rgb/3.jpg"]
    assert sequence.groundtruth is not None
    expected = inverse(short.groundtruth.T_world_cam[0]) @ short.groundtruth.T_world_cam[4]
    found = inverse(sequence.groundtruth.T_world_cam[0]) @ sequence.groundtruth.T_world_cam[3]
    torch.testing.assert_close(found, expected, atol=1e-6, rtol=0)


def test_without_lzfse_the_error_names_the_package(
    short: Film, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive = phone_writers.r3d(short, tmp_path / "take.r3d")
    for name in ("lzfse", "liblzfse"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(IdRgbdoError, match=r'needs lzfse .* run `pip install "idrgbdo_torch\[phone\]"`'):
        open_sequence(archive)


def test_an_archive_runs_and_is_its_own_reference(
    short: Film, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    phone_writers.r3d(short, tmp_path / "take.r3d")
    assert cli.main(["run", "take.r3d", "--out", "out"]) == 0
    assert "reading Record3D, .r3d file: 8 frames of 320x240" in capsys.readouterr().out
    assert cli.main(["evaluate", "out", "take.r3d"]) == 0
    assert "ATE" in capsys.readouterr().out
