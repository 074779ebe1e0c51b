"""Live cameras and RealSense recordings, with stand-ins that have the interface of Open3D's sensors and readers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import bag_writer
import numpy as np
import pytest
import torch
from rendered import Film

from idrgbdo_torch import IdRgbdo
from idrgbdo_torch.commands import cli
from idrgbdo_torch.datasets import live, open_sequence
from idrgbdo_torch.datasets.live import AzureKinect, LiveSequence, Open3dRealSense, open3d_sensors, open_camera
from idrgbdo_torch.datasets.realsense import RealSenseRecording, is_realsense
from idrgbdo_torch.datasets.recording import Options
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.evaluation import evaluate
from idrgbdo_torch.frame import BrokenFrame, RgbdFrame
from idrgbdo_torch.odometry import Run, Status, run
from idrgbdo_torch.tracker.open3d_loader import load_open3d

START = 1_700_000_000


@pytest.fixture(scope="module")
def o3d() -> ModuleType:
    return load_open3d()


@pytest.fixture(scope="module")
def film(desk: Film) -> Film:
    """20 frames of the rendered desk."""
    return Film(desk.frames[:20], desk.groundtruth.at(torch.arange(20)))


def tensor_images(o3d: ModuleType, film: Film) -> list[Any]:
    """The frames as a RealSense sensor gives them: RGB of 8 bits, depth in millimetres."""
    images = []
    for frame in film.frames:
        assert frame.color is not None
        millimetres = np.round(1000 * frame.depth.numpy()).astype(np.uint16)
        pair = (o3d.t.geometry.Image(o3d.core.Tensor(np.ascontiguousarray(a))) for a in (frame.color, millimetres))
        images.append(o3d.t.geometry.RGBDImage(*pair))
    return images


def metadata(o3d: ModuleType, film: Film, frames: int) -> SimpleNamespace:
    c = film.frames[0].camera
    intrinsics = o3d.camera.PinholeCameraIntrinsic(c.width, c.height, c.fx, c.fy, c.cx, c.cy)
    return SimpleNamespace(intrinsics=intrinsics, depth_scale=1000.0, fps=30.0, stream_length_usec=frames * 1e6 / 30)


class StandInRealSense:
    """Open3D's RealSenseSensor, playing a list of images; None is an image that did not come."""

    def __init__(self, o3d: ModuleType, film: Film, images: Sequence[Any], devices: int = 1) -> None:
        self.calls: list[Any] = []
        self._o3d, self._film, self._devices = o3d, film, devices
        self._images = iter(images)
        self._time = START * 1_000_000

    def enumerate_devices(self) -> list[str]:
        return ["D435i"] * self._devices

    def init_sensor(self, sensor_config: Any = None, sensor_index: int = 0, filename: str = "") -> bool:
        self.calls.append(("init", filename))
        return True

    def start_capture(self, start_record: bool = False) -> bool:
        self.calls.append(("start", start_record))
        return True

    def get_metadata(self) -> SimpleNamespace:
        return metadata(self._o3d, self._film, 0)

    def capture_frame(self, wait: bool = True, align_depth_to_color: bool = True) -> Any:
        assert wait and align_depth_to_color
        image = next(self._images, None)
        self._time += 33_333 if image is not None else 0
        return image if image is not None else self._o3d.t.geometry.RGBDImage()

    def get_timestamp(self) -> int:
        return self._time

    def stop_capture(self) -> None:
        self.calls.append("stop")


class StandInKinect:
    """Open3D's AzureKinectSensor."""

    def __init__(self, images: Sequence[Any], there: bool = True) -> None:
        self._images, self._there = iter(images), there
        self.connected = False

    def connect(self, sensor_index: int) -> bool:
        self.connected = self._there
        return self._there

    def capture_frame(self, enable_align_depth_to_color: bool) -> Any:
        assert enable_align_depth_to_color
        return next(self._images, None)

    def disconnect(self) -> None:
        self.connected = False


class StandInReader:
    """Open3D's RSBagReader."""

    def __init__(self, o3d: ModuleType, film: Film, images: Sequence[Any], opens: bool = True) -> None:
        self._o3d, self._images, self._opens = o3d, list(images), opens
        self._position = 0
        self.metadata = metadata(o3d, film, len(images))

    def open(self, filename: str) -> bool:
        return self._opens

    def next_frame(self) -> Any:
        if self._position == len(self._images):
            return self._o3d.t.geometry.RGBDImage()
        self._position += 1
        return self._images[self._position - 1]

    def get_timestamp(self) -> int:
        return self._position * 33_333


def error_m(done: Run, film: Film) -> float:
    estimate = done.trajectory()
    return evaluate(estimate, replace(film.groundtruth, timestamps=estimate.timestamps)).ate.rmse_m


def test_the_stand_ins_have_open3ds_interface(o3d: ModuleType) -> None:
    classes = {
        StandInRealSense: o3d.t.io.RealSenseSensor,
        StandInReader: o3d.t.io.RSBagReader,
        StandInKinect: o3d.io.AzureKinectSensor,
    }
    for stand_in, real in classes.items():
        for name in vars(stand_in):
            assert name.startswith("__") or name in vars(real), f"{real} has no {name}"
    for name in ("intrinsics", "depth_scale", "fps", "stream_length_usec"):
        assert name in vars(o3d.t.io.RGBDVideoMetadata)


def test_a_realsense_camera_is_tracked(o3d: ModuleType, film: Film, tmp_path: Path) -> None:
    sensor = StandInRealSense(o3d, film, tensor_images(o3d, film))
    sequence = LiveSequence(Open3dRealSense(record=tmp_path / "all.bag", sensor=sensor), max_frames=20)
    assert sequence.camera == film.frames[0].camera
    assert sequence.warnings == []
    done = run(IdRgbdo(), sequence)
    assert len(done.records) == len(sequence) == 20
    assert Status.LOST not in done.statuses
    assert error_m(done, film) <= 0.01
    assert sequence.timestamps == pytest.approx([START + (k + 1) * 0.033333 for k in range(20)], abs=1e-6)
    assert sensor.calls == [("init", str(tmp_path / "all.bag")), ("start", True), "stop"]
    with pytest.raises(IdRgbdoError, match="frame 3 of a live camera"):
        sequence.read(3)


def test_a_camera_that_pauses_goes_on_and_one_that_is_gone_ends(o3d: ModuleType, film: Film) -> None:
    images = tensor_images(o3d, film)
    sensor = StandInRealSense(o3d, film, [*images[:4], None, None, *images[4:8], None, None, None, *images[8:]])
    frames = list(LiveSequence(Open3dRealSense(sensor=sensor), max_frames=20))
    assert len(frames) == 8
    assert sensor.calls[-1] == "stop"


def test_an_error_of_the_camera_ends_the_frames_and_says_why(o3d: ModuleType, film: Film) -> None:
    sensor = StandInRealSense(o3d, film, tensor_images(o3d, film))
    sequence = LiveSequence(Open3dRealSense(sensor=sensor), max_frames=20)
    frames = iter(sequence)
    assert next(frames) and sequence.ended == ""

    def fail(wait: bool = True, align_depth_to_color: bool = True) -> None:
        raise RuntimeError("No device connected")

    sensor.capture_frame = fail  # type: ignore[method-assign]
    assert list(frames) == []
    assert "the RealSense camera failed: No device connected" in sequence.ended
    assert sensor.calls[-1] == "stop"


def test_max_frames_and_the_end_of_looking_stop_the_camera(o3d: ModuleType, film: Film) -> None:
    sensor = StandInRealSense(o3d, film, tensor_images(o3d, film))
    assert len(list(LiveSequence(Open3dRealSense(sensor=sensor), max_frames=5))) == 5
    assert sensor.calls[-1] == "stop"
    sensor = StandInRealSense(o3d, film, tensor_images(o3d, film))
    frames = iter(LiveSequence(Open3dRealSense(sensor=sensor), max_frames=5))
    next(frames)
    frames.close()  # type: ignore[attr-defined]
    assert sensor.calls[-1] == "stop"


def test_no_camera_is_one_line(o3d: ModuleType, film: Film, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(IdRgbdoError, match="expected a RealSense camera, found none"):
        Open3dRealSense(sensor=StandInRealSense(o3d, film, [], devices=0))
    silent = StandInRealSense(o3d, film, [])
    with pytest.raises(IdRgbdoError, match="no image came from the realsense camera"):
        LiveSequence(Open3dRealSense(sensor=silent), max_frames=5)
    assert silent.calls[-1] == "stop"
    if not o3d.t.io.RealSenseSensor.enumerate_devices():
        capsys.readouterr()
        assert cli.main(["live", "--camera", "open3d"]) == 1
        assert capsys.readouterr().err.startswith("error: sensor: expected a RealSense camera, found none; ")


def test_what_open3d_raises_is_one_plain_line(o3d: ModuleType, film: Film) -> None:
    sensor = StandInRealSense(o3d, film, [])

    def fail(start_record: bool = False) -> bool:
        raise RuntimeError("\x1b[1;31m[Open3D Error] StartCapture() failed:\nbusy\n\x1b[0;m")

    sensor.start_capture = fail  # type: ignore[method-assign]
    with pytest.raises(IdRgbdoError) as caught:
        Open3dRealSense(sensor=sensor)
    assert str(caught.value) == (
        "sensor: the RealSense camera failed: [Open3D Error] StartCapture() failed: busy; "
        "try it with its maker's viewer"
    )


def legacy_images(o3d: ModuleType, film: Film) -> list[Any]:
    return [image.to_legacy() for image in tensor_images(o3d, film)]


@pytest.fixture
def camera_file(film: Film, tmp_path: Path) -> Path:
    c = film.frames[0].camera
    path = tmp_path / "camera.toml"
    path.write_text(f"fx = {c.fx}\nfy = {c.fy}\ncx = {c.cx}\ncy = {c.cy}\n")
    return path


def test_an_azure_kinect_is_tracked(
    o3d: ModuleType, film: Film, camera_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ticks = count(START * 30)
    monkeypatch.setattr(open3d_sensors.time, "time", lambda: next(ticks) / 30)  # as slowly as a camera gives its images
    sensor = StandInKinect(legacy_images(o3d, film))
    sequence = LiveSequence(AzureKinect(camera_file, sensor), max_frames=50)
    assert sensor.connected
    done = run(IdRgbdo(), sequence)
    assert len(done.records) == 20
    assert not sensor.connected
    assert np.all(np.diff(sequence.timestamps) > 0)
    assert error_m(done, film) <= 0.01


def test_an_azure_kinect_that_is_not_there(camera_file: Path, tmp_path: Path) -> None:
    with pytest.raises(IdRgbdoError, match="expected an Azure Kinect, found none"):
        AzureKinect(camera_file, StandInKinect([], there=False))
    with pytest.raises(IdRgbdoError, match=r"pass --intrinsics F\.toml"):
        open_camera("azure", max_frames=5)
    with pytest.raises(IdRgbdoError, match="only a RealSense camera records"):
        open_camera("azure", camera=camera_file, record=tmp_path / "a.bag", max_frames=5)


def test_an_azure_kinect_without_its_library_is_one_line(camera_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(open3d_sensors, "K4A", {})
    with pytest.raises(IdRgbdoError, match=r"needs Microsoft's Sensor SDK 1\.4"):
        AzureKinect(camera_file)


def test_the_command_tracks_a_camera(
    o3d: ModuleType,
    film: Film,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    sensor = StandInRealSense(o3d, film, tensor_images(o3d, film))
    monkeypatch.setattr(live, "Open3dRealSense", lambda camera, record: Open3dRealSense(camera, record, sensor))
    command = ["live", "--camera", "open3d", "--out", str(tmp_path / "run"), "--max-frames", "6"]
    assert cli.main([*command, "--selection.points", "40"]) == 0
    shown = capsys.readouterr().out
    assert "reading realsense camera: 320x240, at most 6 frames" in shown
    assert (tmp_path / "run" / "trajectory.txt").read_text().count("\n") == 7
    assert (tmp_path / "run" / "report.html").exists()


def test_a_realsense_recording_is_played(o3d: ModuleType, film: Film) -> None:
    reader = StandInReader(o3d, film, tensor_images(o3d, film))
    sequence = RealSenseRecording(Path("desk.bag"), Options(), reader)
    assert (sequence.name, len(sequence), sequence.camera) == ("desk", 20, film.frames[0].camera)
    assert sequence.recognised == "RealSense recording, played once: about 20 frames of 320x240"
    done = run(IdRgbdo(), sequence)
    assert len(done.records) == 20
    assert sequence.timestamps == pytest.approx([(k + 1) * 0.033333 for k in range(20)])
    assert error_m(done, film) <= 0.01


def test_a_realsense_recording_is_thinned_and_ends_early(o3d: ModuleType, film: Film) -> None:
    images = tensor_images(o3d, film)
    reader = StandInReader(o3d, film, images)
    sequence = RealSenseRecording(Path("desk.bag"), Options(start=3, every=4, max_frames=3), reader)
    frames = [sequence.read(index) for index in range(3)]
    assert [round(frame.timestamp / 0.033333) for frame in frames] == [4, 8, 12]
    assert isinstance(frames[1], RgbdFrame)
    torch.testing.assert_close(frames[1].depth, film.frames[7].depth, rtol=0, atol=0.00051)
    with pytest.raises(IdRgbdoError, match="come in order, next is 3, not 0"):
        sequence.read(0)
    short = StandInReader(o3d, film, images[:6])
    short.metadata = metadata(o3d, film, 10)
    sequence = RealSenseRecording(Path("desk.bag"), Options(), short)
    assert isinstance([sequence.read(index) for index in range(7)][-1], BrokenFrame)


def test_a_realsense_frame_of_another_size_costs_that_frame(o3d: ModuleType, film: Film) -> None:
    images = tensor_images(o3d, film)
    c, d = (np.zeros((24, 32, 3), np.uint8), np.ones((24, 32), np.uint16))
    images[7] = o3d.t.geometry.RGBDImage(*(o3d.t.geometry.Image(o3d.core.Tensor(a)) for a in (c, d)))
    frames = list(RealSenseRecording(Path("desk.bag"), Options(), StandInReader(o3d, film, images)))
    assert [index for index, frame in enumerate(frames) if isinstance(frame, BrokenFrame)] == [7]


def test_a_realsense_recording_is_told_from_a_ros_bag(
    film: Film, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = ("/device_0/sensor_1/Color_0/image/data", "/device_0/sensor_0/Depth_0/image/data")
    short = Film(film.frames[:3], film.groundtruth)
    intel = bag_writer.write_bag(short, tmp_path / "intel.bag", topics=names)
    ros = bag_writer.write_bag(short, tmp_path / "ros.bag")
    (tmp_path / "empty.bag").write_bytes(b"")
    (tmp_path / "short.bag").write_bytes(b"#ROSBAG V2.0\nindex_pos=")
    assert [is_realsense(tmp_path / f"{name}.bag") for name in ("intel", "ros", "empty", "short", "none")] == [
        *(True, False, False, False, False)
    ]
    assert is_realsense(intel) and not is_realsense(ros)
    with pytest.raises(IdRgbdoError, match="RealSense"):
        open_sequence(intel)  # the topics alone do not make a recording that Open3D plays
    assert capsys.readouterr().out == ""
    assert len(open_sequence(intel, format="ros")) == 3
