"""RealSense cameras through pyrealsense2 itself: a rendered film in its software device."""

from __future__ import annotations

from pathlib import Path

import cv2
import format_writers
import numpy as np
import pytest
import torch
from rendered import Film

from idrgbdo_torch.tracker.open3d_loader import load_libusb

load_libusb()
rs = pytest.importorskip("pyrealsense2")

from recordings import ROOT  # noqa: E402
from software_camera import SoftwareCamera, images, intrinsics  # noqa: E402
from test_readme import blocks  # noqa: E402

import idrgbdo_torch  # noqa: E402
from idrgbdo_torch import IdRgbdo, open_sequence, run  # noqa: E402
from idrgbdo_torch.commands import cli  # noqa: E402
from idrgbdo_torch.config import CameraSettings  # noqa: E402
from idrgbdo_torch.datasets import live  # noqa: E402
from idrgbdo_torch.datasets.live import RealSense, open_camera, realsense  # noqa: E402
from idrgbdo_torch.datasets.live.lens import calibration_of_profile  # noqa: E402
from idrgbdo_torch.errors import IdRgbdoError  # noqa: E402
from idrgbdo_torch.odometry import Status  # noqa: E402
from idrgbdo_torch.runs.live import LiveResult  # noqa: E402

SIZE = (320, 240)
PINHOLE = (262.5, 262.5, 159.5, 119.5)
SMALL = CameraSettings(*SIZE)
START_S = 100.0


@pytest.fixture(scope="module")
def film(desk: Film) -> Film:
    """All 40 frames of the rendered desk."""
    return desk


@pytest.fixture(scope="module")
def folder(film: Film, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The film as a folder of images, in the times of the camera's clock."""
    path = tmp_path_factory.mktemp("film") / "desk"
    format_writers.camera_toml(film, path)
    for index, (color, depth) in enumerate(images(film)):
        name = f"{START_S + index / 30:.9f}.png"
        format_writers.save(path / "rgb" / name, color)
        format_writers.save(path / "depth" / name, depth)
    return path


@pytest.fixture
def camera(monkeypatch: pytest.MonkeyPatch) -> SoftwareCamera:
    """Gone after 1.5 seconds instead of three, to save time."""
    monkeypatch.setattr(realsense, "WAIT_S", 0.5)
    return SoftwareCamera(intrinsics(SIZE, PINHOLE))


def results(camera: SoftwareCamera, **options: object) -> list[LiveResult]:
    """All results until the camera is gone, and the sentence that says so."""
    found: list[LiveResult] = []
    with pytest.raises(IdRgbdoError, match=r"no image comes from the realsense camera any more after \d+ frames"):
        for result in idrgbdo_torch.live.realsense(
            width=SIZE[0],
            height=SIZE[1],
            device=camera.device,
            **options,  # type: ignore[arg-type]
        ):
            found.append(result)
    return found


def test_a_film_through_the_camera_is_the_film_from_its_folder(
    film: Film, folder: Path, camera: SoftwareCamera
) -> None:
    """At 30 frames a second, none dropped, and unplugged at the end: the same poses, times, velocities."""
    thread = camera.play(images(film))
    tracked = results(camera)
    thread.join()
    expected = run(IdRgbdo(), open_sequence(folder))
    assert (len(tracked), tracked[-1].dropped) == (40, 0)
    assert [result.status for result in tracked] == list(expected.statuses)
    assert [result.timestamp for result in tracked] == pytest.approx([r.timestamp for r in expected.records], abs=1e-9)
    poses = torch.stack([result.T_world_cam for result in tracked])
    assert float((poses - expected.trajectory().T_world_cam).abs().max()) < 1e-6
    assert tracked[0].velocity.isnan().all() and float(tracked[0].covariance.abs().max()) == 0
    moved = (tracked[9].T_world_cam[:3, 3] - tracked[8].T_world_cam[:3, 3]).norm() * 30
    assert float(tracked[9].velocity[:3].norm()) == pytest.approx(float(moved), rel=0.05)
    assert bool((torch.linalg.eigvalsh(tracked[-1].covariance) > 0).all())


def test_images_that_never_come_are_counted(film: Film, camera: SoftwareCamera) -> None:
    shots = [*images(film)[:12]]
    lost = [shots[k] if k not in (4, 5, 9) else None for k in range(12)]
    thread = camera.play(lost, fps=60)
    found = results(camera)
    thread.join()
    assert (len(found), found[-1].dropped) == (9, 3)
    assert [result.dropped for result in found][:5] == [0, 0, 0, 0, 2]


def test_a_reader_that_is_too_slow_loses_the_oldest_and_says_how_many(film: Film, camera: SoftwareCamera) -> None:
    shots = images(film)
    thread = camera.play([shots[k % 40] for k in range(120)], fps=400)
    sequence = open_camera("realsense", settings=SMALL, device=camera.device, max_frames=None)
    thread.join()  # all have come before the second is asked for
    seen = len(list(sequence))
    assert sequence.dropped is not None and 60 < sequence.dropped < 120
    assert seen + sequence.dropped == 120
    assert "no image comes" in sequence.ended


def test_max_frames_ends_quietly_and_the_camera_can_be_opened_again(film: Film, camera: SoftwareCamera) -> None:
    for _ in range(2):
        thread = camera.play(images(film)[:8], fps=60)
        sequence = open_camera("realsense", settings=SMALL, device=camera.device, max_frames=3)
        assert len(list(sequence)) == 3 and sequence.ended == ""
        thread.join()


def test_leaving_the_loop_stops_the_camera(film: Film, camera: SoftwareCamera) -> None:
    thread = camera.play(images(film)[:4], fps=60)
    for result in idrgbdo_torch.live.realsense(width=SIZE[0], height=SIZE[1], device=camera.device):
        assert result.status is Status.OK
        assert camera.color.get_active_streams()
        break
    thread.join()
    assert not camera.color.get_active_streams()


def test_no_image_at_all_is_one_sentence(camera: SoftwareCamera) -> None:
    with pytest.raises(IdRgbdoError, match="no image came from the realsense camera"):
        open_camera("realsense", settings=SMALL, device=camera.device, max_frames=3)


def test_depth_of_another_size_beside_colour_is_registered_as_in_a_folder(
    film: Film, folder: Path, tmp_path: Path
) -> None:
    """And the recording, with the camera file written beside it, gives the same once more."""
    small = (160, 120)
    half = (131.25, 131.25, 79.5, 59.5)
    camera = SoftwareCamera(intrinsics(SIZE, PINHOLE), intrinsics(small, half), offset_m=(0.015, 0.0, 0.001))
    shots = [(color, np.ascontiguousarray(depth[::2, ::2])) for color, depth in images(film)[:10]]
    record = tmp_path / "take.db3"
    thread = camera.play(shots, fps=15)
    settings = CameraSettings(*SIZE, depth_width=small[0], depth_height=small[1])
    sequence = open_camera("realsense", settings=settings, device=camera.device, record=record, max_frames=10)
    live = run(IdRgbdo(), sequence)
    thread.join()
    for index, (color, depth) in enumerate(shots):
        name = f"{START_S + index / 30:.9f}.png"
        format_writers.save(tmp_path / "take" / "rgb" / name, color)
        format_writers.save(tmp_path / "take" / "depth" / name, depth)
    before = record.read_bytes()
    with pytest.raises(IdRgbdoError, match="record: expected a new file"):
        open_camera("realsense", settings=settings, device=camera.device, record=record, max_frames=10)
    assert record.read_bytes() == before
    for path, given in ((tmp_path / "take", record.with_suffix(".toml")), (record, None)):
        recorded = open_sequence(path, camera=given)
        again = run(IdRgbdo(), recorded)
        assert recorded.warnings == [] and len(again.records) == 10
        assert recorded.timestamps == pytest.approx(sequence.timestamps, abs=1e-9)
        assert float((again.trajectory().T_world_cam - live.trajectory().T_world_cam).abs().max()) < 1e-6
    assert Status.LOST not in live.statuses


def test_the_command_tracks_records_and_says_that_the_camera_is_gone(
    film: Film,
    camera: SoftwareCamera,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(
        live, "RealSense", lambda settings, file, record, _: RealSense(settings, file, record, camera.device)
    )
    record, out, again = (tmp_path / name for name in ("take.db3", "live", "again"))
    shots = images(film)[:9]
    thread = camera.play([*shots[:4], None, *shots[5:]], fps=30)
    size = ["--width", str(SIZE[0]), "--height", str(SIZE[1])]
    command = ["live", "--camera", "realsense", *size, "--record", str(record), "--out", str(out), "--max-frames", "50"]
    assert cli.main(command) == 0
    thread.join()
    shown = capsys.readouterr()
    assert "reading realsense camera: 320x240, at most 50 frames" in shown.out
    assert "1 of 9 images were dropped" in shown.out
    assert "warning: sensor: no image comes from the realsense camera any more after 8 frames" in shown.err
    assert cli.main(["run", str(record), "--out", str(again)]) == 0
    assert (again / "trajectory.txt").read_text() == (out / "trajectory.txt").read_text()


def test_the_loop_of_the_documentation_runs(
    film: Film, camera: SoftwareCamera, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (loop,) = blocks(ROOT / "docs" / "live.md", "python")
    assert len(loop.strip().splitlines()) <= 10
    monkeypatch.setattr(live, "RealSense", lambda asked, *_: RealSense(SMALL, device=camera.device))
    thread = camera.play(images(film)[:5])
    with pytest.raises(IdRgbdoError, match="no image comes from the realsense camera any more after 5 frames"):
        exec(loop, {})
    thread.join()
    shown = capsys.readouterr().out.splitlines()
    assert len(shown) == 5 and all(" ok " in line and line.endswith("m/s") for line in shown)


def ranged(least: float, most: float) -> object:
    made = rs.option_range()
    made.min, made.max, made.default, made.step = least, most, least, 1.0
    return made


def test_settings_reach_the_camera(film: Film, camera: SoftwareCamera) -> None:
    for sensor, option, least, most in (
        (camera.depth, rs.option.emitter_enabled, 0.0, 1.0),
        (camera.color, rs.option.enable_auto_exposure, 0.0, 1.0),
        (camera.color, rs.option.exposure, 1.0, 10000.0),
    ):
        sensor.add_option(option, ranged(least, most), True)
    camera.color.set_option(rs.option.enable_auto_exposure, 1.0)
    settings = CameraSettings(*SIZE, emitter=True, exposure=80)
    thread = camera.play(images(film)[:4], fps=60)
    list(open_camera("realsense", settings=settings, device=camera.device, max_frames=2))
    thread.join()
    assert camera.depth.get_option(rs.option.emitter_enabled) == 1.0
    assert camera.color.get_option(rs.option.exposure) == 80.0
    assert camera.color.get_option(rs.option.enable_auto_exposure) == 0.0
    for wrong, said in (
        (CameraSettings(*SIZE, exposure=20000), "exposure: expected 1 to 10000 for this camera, got 20000"),
        (CameraSettings(*SIZE, gain=16), "gain: expected a camera that has this setting"),
        (CameraSettings(1280, 720), "the RealSense camera failed: .*resolve"),
    ):
        with pytest.raises(IdRgbdoError, match=said):
            open_camera("realsense", settings=wrong, device=camera.device, max_frames=2)


def test_a_slow_port_is_a_warning(film: Film) -> None:
    camera = SoftwareCamera(intrinsics(SIZE, PINHOLE), usb="2.1")
    thread = camera.play(images(film)[:4], fps=60)
    sequence = open_camera("realsense", settings=SMALL, device=camera.device, max_frames=2)
    thread.join()
    assert sequence.warnings == [
        "the camera is connected by USB 2.1, which is too slow for many sizes and rates; use a USB 3 port"
    ]
    assert len(list(sequence)) == 2


@pytest.mark.parametrize("model", ["inverse_brown_conrady", "brown_conrady", "modified_brown_conrady"])
def test_the_makers_lens_models_become_opencvs(model: str) -> None:
    """By where the library itself says that a point is seen."""
    lens = intrinsics(
        (640, 480), (380.0, 379.0, 321.0, 242.0), getattr(rs.distortion, model), (-0.055, 0.066, 3e-4, 9e-4, -0.02)
    )
    found = calibration_of_profile(rs, lens)
    rays = np.array([[0.1, 0.2, 1.0], [-0.8, -0.6, 1.0], [0.5, -0.6, 1.0], [0.0, 0.0, 1.0]])
    pixels = np.array([rs.rs2_project_point_to_pixel(lens, ray.tolist()) for ray in rays])
    K = np.array([[found.fx, 0, found.cx], [0, found.fy, found.cy], [0, 0, 1]])
    projected, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), K, np.array(found.distortion))
    np.testing.assert_allclose(projected[:, 0], pixels, atol=0.2)
    assert abs(found.k1) > 0.02


def test_a_fisheye_is_refused() -> None:
    lens = intrinsics(
        (640, 480), (180.0, 180.0, 320.0, 240.0), rs.distortion.kannala_brandt4, (0.3, 0.2, -0.1, 0.05, 0.0)
    )
    with pytest.raises(IdRgbdoError, match=r"expected a lens with radial and tangential distortion"):
        calibration_of_profile(rs, lens)
