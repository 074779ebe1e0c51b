"""OAK cameras through depthai itself: its RGBD node, fed with a rendered film by a node on the host."""

from __future__ import annotations

import time
from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path
from typing import Any

import format_writers
import numpy as np
import pytest
from numpy.typing import NDArray
from rendered import Film

dai = pytest.importorskip("depthai")

import idrgbdo_torch  # noqa: E402
from idrgbdo_torch import IdRgbdo, open_sequence, run  # noqa: E402
from idrgbdo_torch.config import CameraSettings  # noqa: E402
from idrgbdo_torch.datasets.live import oak, open_camera  # noqa: E402
from idrgbdo_torch.errors import IdRgbdoError  # noqa: E402

START_S = 100.0
KEPT: list[Any] = []  # depthai does not hold the nodes that Python made
K = [[262.5, 0, 159.5], [0, 262.5, 119.5], [0, 0, 1]]


class Shown(dai.node.ThreadedHostNode):  # type: ignore[misc]
    """Gives colour and depth images at 30 a second; None for one that is lost."""

    def __init__(self) -> None:
        super().__init__()
        self.color, self.depth = self.createOutput(), self.createOutput()
        self.shots: Sequence[tuple[NDArray[np.uint8], NDArray[np.uint16]] | None] = ()
        self.lens: list[float] = []

    def run(self) -> None:
        begin = time.monotonic()
        for number, shot in enumerate(self.shots):
            time.sleep(max(0.0, begin + number / 30 - time.monotonic()))
            if shot is None or not self.isRunning():
                continue
            for out, image, kind in (
                (self.color, shot[0], dai.ImgFrame.Type.BGR888i),
                (self.depth, shot[1], dai.ImgFrame.Type.RAW16),
            ):
                frame = dai.ImgFrame()
                frame.setData(np.ascontiguousarray(image).view(np.uint8).ravel())
                frame.setType(kind)
                frame.setWidth(image.shape[1])
                frame.setHeight(image.shape[0])
                frame.setSequenceNum(number)
                at = timedelta(microseconds=round((START_S + number / 30) * 1e6))
                frame.setTimestamp(at)
                frame.setTimestampDevice(at)
                about = dai.ImgTransformation(image.shape[1], image.shape[0], K)
                if self.lens:
                    about.setDistortionCoefficients(self.lens)
                frame.setTransformation(about)
                out.send(frame)


def camera(shots: Sequence[Any], lens: Sequence[float] = ()) -> Any:
    """An RGBD node that is fed with the images. lens: OpenCV's 14 coefficients."""
    pipeline = dai.Pipeline(createImplicitDevice=False)
    shown, node = pipeline.create(Shown), pipeline.create(dai.node.RGBD)
    shown.shots, shown.lens = shots, list(lens)
    shown.color.link(node.inColor)
    shown.depth.link(node.inDepth)
    for one in pipeline.getAllNodes():
        if one.getName() == "Sync":
            one.setRunOnHost(True)
    KEPT[:] = [pipeline, shown]
    return node


def images(film: Film, frames: int) -> list[tuple[NDArray[np.uint8], NDArray[np.uint16]]]:
    return [(format_writers.color(film, k), format_writers.depth(film, k, 1000)) for k in range(frames)]


def test_a_film_through_the_camera_is_the_film_from_its_folder(
    desk: Film, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(oak, "WAIT_S", 0.5)
    shots = images(desk, 20)
    found = []
    with pytest.raises(IdRgbdoError, match="no image comes from the oak camera any more after 20 frames"):
        for result in idrgbdo_torch.live.oak(width=320, height=240, device=camera(shots)):
            found.append(result)
    format_writers.camera_toml(desk, tmp_path)
    for index, (color, depth) in enumerate(shots):
        name = f"{START_S + index / 30:.6f}.png"
        format_writers.save(tmp_path / "rgb" / name, color)
        format_writers.save(tmp_path / "depth" / name, depth)
    expected = run(IdRgbdo(), open_sequence(tmp_path))
    assert (len(found), found[-1].dropped) == (20, 0)
    for result, record in zip(found, expected.records, strict=True):
        assert result.timestamp == pytest.approx(record.timestamp, abs=1e-9)
        assert float((result.T_world_cam - record.result.T_world_cam).abs().max()) < 1e-6


def test_images_that_never_come_are_counted(desk: Film, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(oak, "WAIT_S", 0.3)
    shots = images(desk, 8)
    lost = [None if k in (2, 3, 6) else shots[k] for k in range(8)]
    sequence = open_camera("oak", device=camera(lost), max_frames=None)
    assert len(list(sequence)) == 5
    assert sequence.dropped == 3 and "no image comes" in sequence.ended


def test_the_lens_is_the_images_own(desk: Film) -> None:
    lens = [0.1, -0.02, 1e-3, -2e-3, 0.01, 0.0, 0.0, 0.0, *[0.0] * 6]
    sequence = open_camera("oak", device=camera(images(desk, 2), lens), max_frames=1)
    frame = next(iter(sequence))
    assert frame.color is not None  # type: ignore[union-attr]
    assert not np.array_equal(frame.color.numpy(), desk.frames[0].color)  # type: ignore[union-attr]
    with pytest.raises(IdRgbdoError, match="expected a lens with radial and tangential distortion"):
        open_camera("oak", device=camera(images(desk, 2), [0.1] * 14), max_frames=1)


def test_no_camera_and_settings_that_it_does_not_take(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(IdRgbdoError, match="expected size and rate alone for an OAK"):
        open_camera("oak", settings=CameraSettings(emitter=True), max_frames=1)
    monkeypatch.setenv("DEPTHAI_SEARCH_TIMEOUT", "300")  # ms
    if not dai.Device.getAllAvailableDevices():
        with pytest.raises(IdRgbdoError, match=r"expected an OAK camera \(No available devices\)"):
            open_camera("oak", max_frames=1)
