"""The faults of a real camera in rendered films: each is as its name says, and a camera.toml that has it mends it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from rendered import FAULTLESS, with_faults

from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.synthetic import FaultConfig, RenderedSequence, SensorConfig, write_tum
from idrgbdo_torch.synthetic.depth_sensors import measured_depth
from idrgbdo_torch.synthetic.faults import jump_gain
from idrgbdo_torch.synthetic.render import Depth


def read_back(sequence: RenderedSequence, folder: Path) -> RgbdFrame:
    """The first frame of the film as a reader of its folder has it."""
    write_tum(sequence, folder)
    frame = open_sequence(folder).read(0)
    assert isinstance(frame, RgbdFrame)
    return frame


def test_every_row_of_a_rolling_shutter_has_its_own_time(faultless: RenderedSequence) -> None:
    t, readout = faultless.timestamps[1], 0.03
    rolled = faultless.renderer.radiance(faultless._pose, t, 0.0, readout)
    for row in (0, 59, 119):
        then = faultless.renderer.radiance(faultless._pose, t + readout * ((row + 0.5) / 120 - 0.5), 0.0)
        assert np.abs(rolled[row] - then[row]).mean() < 1e-4
    still = faultless.renderer.radiance(faultless._pose, t, 0.0)
    assert np.abs(rolled[0] - still[0]).mean() > 1e-3
    shot = with_faults(faultless, FaultConfig(readout_ms=30.0)).shot(1)
    assert np.abs(shot.color[0].astype(float) - faultless.shot(1).color[0]).mean() > 0.5
    assert (shot.depth == faultless.shot(1).depth).all()


def test_late_depth_is_the_depth_of_later(faultless: RenderedSequence) -> None:
    late = with_faults(faultless, FaultConfig(depth_delay_ms=1000.0 / 15.0)).shot(0)
    assert np.mean(np.abs(late.depth.astype(int) - faultless.shot(1).depth) <= 1) > 0.99
    assert np.mean(np.abs(late.depth.astype(int) - faultless.shot(0).depth) <= 1) < 0.9
    assert (late.color == faultless.shot(0).color).all()


@pytest.mark.parametrize(
    "fault",
    [
        {"focal": 0.01},
        {"center_px": 5.0},
        {"depth_scale": 0.02},
        {"depth_growth": 0.01},
        {"depth_growth": -0.01},
        {"misregistration_px": 3},
    ],
    ids=str,
)
def test_a_fault_spoils_a_recording_and_its_name_in_the_camera_file_mends_it(
    faultless: RenderedSequence, fault: dict[str, Any], tmp_path: Path
) -> None:
    right = faultless.read(0)
    blind = read_back(with_faults(faultless, FaultConfig(**fault), frames=2), tmp_path / "blind")
    told = read_back(with_faults(faultless, FaultConfig(**fault, named=True), frames=2), tmp_path / "told")
    inside = (slice(None), slice(4, -4))
    assert told.camera == right.camera
    assert torch.allclose(told.depth[inside], right.depth[inside], atol=3e-4)
    same_depth = torch.allclose(blind.depth[inside], right.depth[inside], atol=3e-3)
    assert (blind.camera == right.camera) != same_depth  # one of the two is wrong
    in_memory = with_faults(faultless, FaultConfig(**fault, named=True))
    assert in_memory.camera == told.camera
    assert torch.allclose(in_memory.read(0).depth[inside], told.depth[inside], atol=1e-6)


def test_sizes_are_those_that_are_asked_for(faultless: RenderedSequence) -> None:
    camera = with_faults(faultless, FaultConfig(focal=0.01, center_px=5.0)).camera
    assert camera.fx == pytest.approx(1.01 * FAULTLESS.fx)
    assert np.hypot(camera.cx - FAULTLESS.cx, camera.cy - FAULTLESS.cy) == pytest.approx(5.0)
    depth = faultless.read(0).depth
    ratio = with_faults(faultless, FaultConfig(depth_scale=0.02)).read(0).depth / depth
    assert ratio.mean() == pytest.approx(1.02, abs=1e-4)
    measured = with_faults(faultless, FaultConfig(depth_growth=0.01)).read(0).depth
    assert torch.allclose(measured * (1 + 0.01 * measured), depth, atol=3e-4)
    moved = with_faults(faultless, FaultConfig(misregistration_px=3)).read(0).depth
    assert torch.equal(moved[:, 3:], depth[:, :-3]) and not moved[:, :3].any()


def test_times_are_named_and_reach_the_frames(faultless: RenderedSequence, tmp_path: Path) -> None:
    faults = FaultConfig(readout_ms=20.0, depth_delay_ms=15.0, named=True)
    camera = read_back(with_faults(faultless, faults, frames=2), tmp_path / "told").camera
    assert (camera.readout_ms, camera.depth_delay_ms) == (20.0, 15.0)
    assert (camera.at_level(2).readout_ms, camera.at_level(2).depth_delay_ms) == (20.0, 15.0)
    blind = read_back(with_faults(faultless, replace(faults, named=False), frames=2), tmp_path / "blind").camera
    assert (blind.readout_ms, blind.depth_delay_ms) == (0.0, 0.0)


def test_exposure_jumps_and_stays() -> None:
    gains = np.array([jump_gain(t, 0.3, 0) for t in np.arange(0, 6, 1 / 30)])
    assert set(np.round(gains, 6)) == {0.7, 1.0, 1.3}
    assert (np.diff(gains) != 0).sum() == 11
    assert jump_gain(1.0, 0.0, 0) == 1.0


def wall(step: bool = False) -> Depth:
    depth = np.full((240, 320), 2.0, np.float32)
    if step:
        depth[:, 160:] = 1.0
    return Depth(depth, np.ones_like(depth))


def test_a_stereo_sensor_has_holes_and_speckle() -> None:
    def shares(size: float) -> tuple[float, float]:
        depth = measured_depth(wall(), SensorConfig(), FaultConfig(stereo=size), np.random.default_rng(0)) / 5000.0
        valid = depth > 0
        return 1 - valid.mean(), float((np.abs(depth - 2.0) > 0.15)[valid].mean())

    holes, speckle = shares(1.0)
    assert holes == pytest.approx(0.04, abs=0.01)
    assert 0.001 < speckle < 0.01
    half = shares(0.5)
    assert half[0] == pytest.approx(0.02, abs=0.01) and half[1] < speckle


def test_a_time_of_flight_sensor_mixes_depths_at_edges_and_errs_with_distance() -> None:
    depth = measured_depth(wall(step=True), SensorConfig(), FaultConfig(tof=1.0), np.random.default_rng(0)) / 5000.0
    between = (depth > 1.1) & (depth < 1.9)
    assert between[:, 155:165].any(axis=1).mean() > 0.5
    assert not between[:, :150].any() and not between[:, 170:].any()
    far, near = depth[:, :150], depth[:, 170:]
    assert far.std() > 1.5 * near.std()
    assert 0.0005 < abs(float(far.mean()) - 2.0) < 0.004  # the wiggle


def test_two_kinds_of_sensor_and_nonsense_are_refused() -> None:
    with pytest.raises(IdRgbdoError, match="faults: expected a stereo or a time-of-flight"):
        replace(FAULTLESS, faults=FaultConfig(stereo=1.0, tof=1.0))
    with pytest.raises(IdRgbdoError, match="readout_ms"):
        replace(FAULTLESS, faults=FaultConfig(readout_ms=-1.0))
