"""Rolling shutter and late depth: images brought to the time of their frame, by a velocity or by what tracking says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from rendered import with_faults

from idrgbdo_torch.frame import RgbdFrame, prepare
from idrgbdo_torch.kernels.se3 import inverse, log_se3
from idrgbdo_torch.runs.checkpoint import CONSTANTS, TYPES
from idrgbdo_torch.runs.tree import Codec
from idrgbdo_torch.synthetic import FaultConfig, RenderedSequence
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo
from idrgbdo_torch.tracker.instant import at_one_instant, steady, takes_time

READOUT = FaultConfig(readout_ms=60.0, named=True)
LATE = FaultConfig(depth_delay_ms=60.0, named=True)


def velocity(sequence: RenderedSequence, index: int) -> np.ndarray:
    """(6,) the true one at a frame."""
    t, step = sequence.timestamps[index], 0.005
    after, before = (inverse(sequence.path.pose(t + s)) for s in (step, -step))
    return np.asarray(log_se3(after @ inverse(before)) / (2 * step))


def off(a: torch.Tensor, b: torch.Tensor) -> float:
    """Mean absolute difference away from the border."""
    return float((a - b)[10:-10, 10:-10].abs().mean())


def test_rows_of_a_rolling_shutter_come_to_one_time(faultless: RenderedSequence) -> None:
    right, rolled = faultless.read(5), with_faults(faultless, READOUT).read(5)
    mended = at_one_instant(rolled, velocity(faultless, 5))
    assert off(rolled.gray, right.gray) > 4.0
    assert off(mended.gray, right.gray) < 0.4 * off(rolled.gray, right.gray)
    assert mended.color is not None and right.color is not None and rolled.color is not None
    assert off(mended.color.float(), right.color.float()) < 0.5 * off(rolled.color.float(), right.color.float())
    assert torch.equal(mended.depth, rolled.depth)


def test_late_depth_comes_to_the_colour_images_time(faultless: RenderedSequence) -> None:
    right, late = faultless.read(5), with_faults(faultless, LATE).read(5)
    mended = at_one_instant(late, velocity(faultless, 5))

    def error(frame: RgbdFrame) -> float:
        return float((frame.depth - right.depth)[10:-10, 10:-10].abs().median())

    assert error(late) > 0.004
    assert error(mended) < 0.25 * error(late)
    assert torch.equal(mended.gray, late.gray)


def test_holes_stay_holes_and_mix_with_nothing(faultless: RenderedSequence) -> None:
    late = with_faults(faultless, LATE).read(5)
    depth = torch.full_like(late.depth, 2.0)
    depth[40:80, 50:100] = 0.0
    mended = at_one_instant(replace(late, depth=depth), np.array([0.0, 0.0, 0.0, 0.05, 0.3, 0.1])).depth
    mended = mended[10:-10, 10:-15]  # what was not seen then comes in at the border
    there = mended[mended > 0]
    assert 0.9 < float((mended == 0).sum()) / 2000 < 1.1
    assert float(there.min()) > 1.9 and float(there.max()) < 2.1


def test_nothing_known_changes_nothing(faultless: RenderedSequence) -> None:
    frame = faultless.read(5)
    assert not takes_time(frame.camera)
    as_it_came, plain = steady(frame, velocity(faultless, 5), 0.8), prepare(frame, 0.8)
    assert all(np.array_equal(a, b) for a, b in zip(as_it_came.images, plain.images, strict=True))
    assert as_it_came.depth is plain.depth or np.array_equal(as_it_came.depth, plain.depth)
    at_rest = steady(with_faults(faultless, READOUT).read(5), np.zeros(6), 0.0)
    assert np.array_equal(at_rest.images[0], with_faults(faultless, READOUT).read(5).gray.numpy())


@pytest.mark.parametrize("faults", [READOUT, LATE], ids=["rolling shutter", "late depth"])
def test_a_camera_file_that_names_it_brings_the_pose_back(faultless: RenderedSequence, faults: FaultConfig) -> None:
    spoilt = with_faults(faultless, faults)
    frames = tuple(spoilt)

    def error(camera_knows: bool) -> float:
        """Mean translation in m between frames, measured against true."""
        odometry = IdRgbdo(compile_ahead=False)
        camera = spoilt.camera if camera_knows else replace(spoilt.camera, readout_ms=0.0, depth_delay_ms=0.0)
        poses = [odometry.track(replace(frame, camera=camera)).T_world_cam.numpy() for frame in frames]
        true = faultless.T_world_cam
        steps = [
            np.linalg.inv(np.linalg.inv(true[k - 1]) @ true[k]) @ (np.linalg.inv(poses[k - 1]) @ poses[k])
            for k in range(4, len(poses))
        ]
        return float(np.mean([np.linalg.norm(step[:3, 3]) for step in steps]))

    assert error(True) < 0.6 * error(False)


def test_images_may_be_given_in_the_same_buffers(faultless: RenderedSequence) -> None:
    """The first one waits for its velocity, and by then the second is in its place."""
    frames = [with_faults(faultless, READOUT).read(index) for index in range(4)]
    own, reused = IdRgbdo(compile_ahead=False), IdRgbdo(compile_ahead=False)
    gray, depth = torch.empty_like(frames[0].gray), torch.empty_like(frames[0].depth)
    for frame in frames:
        gray.copy_(frame.gray)
        depth.copy_(frame.depth)
        again = reused.track(replace(frame, gray=gray, depth=depth))
        assert torch.equal(own.track(frame).T_world_cam, again.T_world_cam)


def test_a_run_can_be_kept_while_the_first_frame_waits_for_its_velocity(faultless: RenderedSequence) -> None:
    frames = tuple(with_faults(faultless, READOUT).read(index) for index in range(3))
    odometry = IdRgbdo(compile_ahead=False)
    odometry.track(frames[0])
    codec = Codec(TYPES, CONSTANTS)
    text, numbers = codec.write(odometry)
    kept = codec.read(text, memoryview(b"".join(bytes(part) for part in numbers)))
    for frame in frames[1:]:
        assert torch.equal(kept.track(frame).T_world_cam, odometry.track(frame).T_world_cam)
    assert kept.motion.first is None and len(kept.trajectory().timestamps) == 3
