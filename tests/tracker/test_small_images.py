"""Small and narrow images: margins and grid cells scale with them, and what is too small is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from rendered import Film

from idrgbdo_torch import IdRgbdo
from idrgbdo_torch.definitions.camera import Pinhole
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.evaluation import evaluate
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.odometry import Status, run
from idrgbdo_torch.tracker.selection import view_margin


def pinhole(width: int, height: int, f: float, cx: float, cy: float) -> Pinhole:
    return Pinhole(width=width, height=height, fx=f, fy=f, cx=cx, cy=cy)


def reduced(frame: RgbdFrame, by: int) -> RgbdFrame:
    """The frame with so many times fewer pixels: mean of gray, nearest depth."""
    c = frame.camera
    width, height = c.width // by, c.height // by
    gray = frame.gray[: height * by, : width * by].reshape(height, by, width, by).mean(dim=(1, 3))
    camera = pinhole(width, height, c.fx / by, (c.cx + 0.5) / by - 0.5, (c.cy + 0.5) / by - 0.5)
    return RgbdFrame(frame.timestamp, gray, frame.depth[by // 2 :: by, by // 2 :: by].contiguous(), camera)


def strip(frame: RgbdFrame, rows: slice) -> RgbdFrame:
    """Some rows of the frame."""
    camera = replace(frame.camera, height=rows.stop - rows.start, cy=frame.camera.cy - rows.start)
    return RgbdFrame(frame.timestamp, frame.gray[rows].contiguous(), frame.depth[rows].contiguous(), camera)


@pytest.mark.parametrize(("name", "limit_m"), [("80x60", 0.008), ("320x40", 0.008), ("160x120", 0.004)])
def test_every_frame_of_a_small_film_is_tracked(desk: Film, name: str, limit_m: float) -> None:
    frames = [
        strip(frame, slice(100, 140)) if name == "320x40" else reduced(frame, 320 // int(name.split("x")[0]))
        for frame in desk.frames[:30]
    ]
    camera = frames[0].camera
    assert f"{camera.width}x{camera.height}" == name
    done = run(IdRgbdo(), frames)
    assert Status.LOST not in done.statuses
    truth = desk.groundtruth.at(torch.arange(30))
    assert evaluate(done.trajectory(), truth).ate.rmse_m < limit_m


def test_the_margin_is_at_most_an_eighth_of_the_image() -> None:
    for width, height, expected in ((640, 480, 20), (320, 240, 20), (240, 320, 20), (80, 60, 7.5), (320, 40, 5)):
        assert view_margin(20.0, pinhole(width, height, 200, width / 2, height / 2)) == expected
    assert view_margin(0.0, pinhole(80, 60, 60, 40, 30)) == 0


def test_images_that_are_too_small_are_said_to_be() -> None:
    gray = torch.from_numpy(np.random.default_rng(0).uniform(0, 255, (30, 40)).astype(np.float32))
    frame = RgbdFrame(0.0, gray, torch.ones(30, 40), pinhole(40, 30, 30, 20, 15))
    with pytest.raises(IdRgbdoError, match=r"at least 32x32 pixels, got 40x30; record larger ones"):
        IdRgbdo().track(frame)
