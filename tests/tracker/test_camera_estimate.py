"""A run tells what is wrong with the camera's numbers, how surely, and what it cannot see."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from rendered import Film, later

from idrgbdo_torch import IdRgbdo
from idrgbdo_torch.config import Config, KeyframeConfig
from idrgbdo_torch.definitions.camera import Pinhole
from idrgbdo_torch.definitions.records import Records
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.odometry import ConstantVelocity, Odometry, Record, run
from idrgbdo_torch.report.terminal import camera_rows
from idrgbdo_torch.runs.checkpoint import Checkpoints, Identity, State, load
from idrgbdo_torch.runs.folder import RunFolder
from idrgbdo_torch.tracker.camera_equations import (
    CENTER_U,
    CENTER_V,
    DEPTH,
    FOCAL,
    READOUT,
    UNKNOWNS,
    Hosted,
    flow,
    jacobians,
    lateness,
    placed_in_target,
)
from idrgbdo_torch.tracker.camera_estimate import (
    FEWEST_PAIRS,
    LINEAR,
    MODEL,
    PRIOR,
    WIDTH,
    WORDS,
    CameraEstimate,
    CameraEstimator,
    Estimated,
    estimated,
    in_ms,
    together,
)

CAMERA = Pinhole(width=320, height=240, fx=262.5, fy=260.0, cx=159.5, cy=119.5)
CENTER_OFF = 6.0  # px


def watched(frames: Iterable[RgbdFrame], odometry: Odometry, sparing: bool = False) -> CameraEstimator:
    estimator = CameraEstimator(sparing)
    for frame in frames:
        estimator.look(Record(frame.timestamp, odometry.track(frame), 0.0, 0.0), odometry)
    return estimator


def estimate(frames: Sequence[RgbdFrame], bits: float = 0.42) -> CameraEstimate:
    """bits: how much less certain a frame is that becomes a keyframe; a short film may have few of them."""
    often = IdRgbdo(replace(Config(), keyframe=KeyframeConfig(threshold_bits=bits)))
    found = watched(frames, often).estimate(frames[0].camera)
    assert found is not None
    return found


def other_camera(frames: Sequence[RgbdFrame]) -> list[RgbdFrame]:
    c = frames[0].camera
    wrong = replace(c, fx=1.05 * c.fx, fy=1.05 * c.fy, cx=c.cx + CENTER_OFF, cy=c.cy + CENTER_OFF)
    return [replace(frame, camera=wrong) for frame in frames]


def bent_depth(frames: Sequence[RgbdFrame]) -> list[RgbdFrame]:
    """Depth whose true value is depth * (1 + 0.02 depth)."""
    return [replace(f, depth=2 * f.depth / (1 + torch.sqrt(1 + 0.08 * f.depth))) for f in frames]


def late_depth(frames: Sequence[RgbdFrame]) -> list[RgbdFrame]:
    return [replace(f, depth=after.depth) for f, after in pairwise(frames)]


def moved_depth(frames: Sequence[RgbdFrame]) -> list[RgbdFrame]:
    return [replace(f, depth=f.depth.roll(2, dims=1)) for f in frames]


def numbers(found: CameraEstimate) -> dict[str, tuple[float, float]]:
    return {name: (x.value, x.sigma) for name, x in zip(UNKNOWNS, found.numbers(), strict=True)}


def test_a_faultless_film_shows_the_camera_that_took_it(desk: Film) -> None:
    found = estimate(desk.frames)
    for (value, sigma), true in zip(numbers(found).values(), (1.0, *8 * (0.0,)), strict=True):
        assert abs(value - true) < 3.0 * sigma
    assert found.focal_factor.is_seen and found.focal_factor.sigma < 0.01
    assert found.depth_delay_ms.is_seen and found.depth_delay_ms.sigma < 4.0
    assert found.departures(desk.frames[0].camera) == {}


def test_wrong_intrinsics_are_told_by_how_much(desk: Film) -> None:
    found = estimate(other_camera(desk.frames))
    for x, true in (
        (found.focal_factor, 1 / 1.05),
        (found.center_u_px, -CENTER_OFF),
        (found.center_v_px, -CENTER_OFF),
    ):
        assert abs(x.value - true) < 3.0 * x.sigma
    departures = found.departures(desk.frames[0].camera)
    assert {"focal", "cx", "cy"} <= set(departures)
    assert departures["focal"].startswith("focal length -")


@pytest.mark.parametrize(
    ("fault", "name", "true"),
    [(bent_depth, "growth", 0.02), (late_depth, "delay", 33.3), (moved_depth, "shift_u", 2.0)],
)
def test_what_is_wrong_with_depth_is_told_apart(
    desk: Film, fault: Callable[[Sequence[RgbdFrame]], list[RgbdFrame]], name: str, true: float
) -> None:
    value, sigma = numbers(estimate(fault(desk.frames), bits=0.2))[name]
    assert abs(value - true) < 3.0 * sigma < value


def test_the_scale_of_all_depths_cannot_be_seen(desk: Film) -> None:
    """The same world, larger, filmed along a larger path, gives the same images."""
    larger = estimate([replace(frame, depth=1.02 * frame.depth) for frame in desk.frames])
    for x, true in zip(larger.numbers(), (1.0, *8 * (0.0,)), strict=True):
        assert abs(x.value - true) < 3.0 * x.sigma


def test_what_the_camera_file_says_is_part_of_the_value(desk: Film) -> None:
    rest = Estimated(0.002, 0.001, is_seen=True)
    assert in_ms(rest, 33.0) == Estimated(35.0, 1.0, is_seen=True)
    late = estimate(late_depth(desk.frames))
    camera = replace(desk.frames[0].camera, depth_delay_ms=33.3)
    assert "depth_delay_ms" in late.departures(desk.frames[0].camera)
    assert "depth_delay_ms" not in late.departures(camera)


def test_poses_stay_the_same(desk: Film) -> None:
    alone, watching = IdRgbdo(), IdRgbdo()
    expected = [alone.track(frame).T_world_cam for frame in desk.frames]
    watched(desk.frames, watching)
    assert torch.equal(watching.trajectory().T_world_cam, alone.trajectory().T_world_cam)
    assert len(expected) == len(desk.frames)


def test_keyframes_are_in_one_pair_each_unless_all_is_asked_for(desk: Film) -> None:
    sparing, all_of_it = (watched(desk.frames, IdRgbdo(), sparing) for sparing in (True, False))
    assert 0 < len(sparing.vector) <= (len(all_of_it.vector) + 1) // 2


def test_who_says_nothing(desk: Film) -> None:
    slow = [later(frame, 0.5 * number) for number, frame in enumerate(desk.frames[:12])]
    for estimator in (watched(slow, IdRgbdo()), watched(desk.frames[:12], ConstantVelocity())):
        assert len(estimator.vector) == 0
        assert estimator.estimate(CAMERA) is None


def test_deviations_follow_from_how_much_the_pairs_disagree() -> None:
    rng = np.random.default_rng(0)
    n, size = 200, 1.0 / PRIOR
    information = np.tile(np.diag((100 * size) ** 2), (n, 1, 1))
    quiet, loud = (k * rng.standard_normal((n, len(PRIOR))) * 100 * size for k in (1.0, 5.0))
    a, b = (estimated(information, vectors, CAMERA) for vectors in (quiet, loud))
    assert a is not None and b is not None
    formal, left = PRIOR[0] / (100 * np.sqrt(n)), MODEL[0] * WIDTH / CAMERA.width
    assert np.hypot(formal, left) == pytest.approx(a.focal_factor.sigma, rel=0.1)
    assert np.hypot(5 * formal, left) == pytest.approx(b.focal_factor.sigma, rel=0.2)


def test_a_number_that_hardly_shows_is_not_seen() -> None:
    information = np.zeros((FEWEST_PAIRS, len(PRIOR), len(PRIOR)))
    found = estimated(information, np.zeros((FEWEST_PAIRS, len(PRIOR))), CAMERA)
    assert found is not None
    seen, hidden = found.in_words()
    assert seen == [] and hidden == [word.name for word in WORDS]
    assert found.as_dict()["readout_ms"] == {"value": 0.0, "sigma": pytest.approx(30.0, rel=0.1), "seen": False}
    assert estimated(information[1:], np.zeros((FEWEST_PAIRS - 1, len(PRIOR))), CAMERA) is None
    assert len(UNKNOWNS) == len(PRIOR) == len(MODEL) == len(LINEAR) == len(WORDS)


def test_a_run_writes_it_down_and_shows_what_departs(desk: Film, tmp_path: Path) -> None:
    frames = late_depth(desk.frames)
    odometry, estimator = IdRgbdo(), CameraEstimator(sparing=False)
    with RunFolder(tmp_path) as folder:
        done = run(odometry, frames, lambda record: estimator.look(record, odometry))
        found = estimator.estimate(frames[0].camera)
        folder.finish(done, odometry, None, False, found)
    written = json.loads((tmp_path / "summary.json").read_text())["camera"]
    assert found is not None and written["pairs"] == found.pairs
    assert written["depth_delay_ms"]["value"] == found.depth_delay_ms.value and written["depth_delay_ms"]["seen"]
    (row,) = camera_rows(found, frames[0].camera)
    assert row[0] == "camera" and "ms late" in row[1]
    assert camera_rows(None, frames[0].camera) == []


def test_a_continued_run_says_the_same(desk: Film, tmp_path: Path) -> None:
    whole = watched(desk.frames, IdRgbdo())
    odometry, identity = IdRgbdo(), Identity("1", "seed = 0\n", "desk", 40, 0.0, 1.3, "camera")
    half = watched(desk.frames[:21], odometry)
    Checkpoints(tmp_path, identity).write(State(odometry, Records(), [], half))
    state = load(tmp_path, identity)
    for frame in desk.frames[21:]:
        state.camera.look(Record(frame.timestamp, state.odometry.track(frame), 0.0, 0.0), state.odometry)
    assert 0 < len(half.vector) < len(whole.vector)
    assert np.array_equal(state.camera.vector.array(), whole.vector.array())


def test_runs_with_one_camera_are_added_up(desk: Film) -> None:
    first, second = (watched(frames, IdRgbdo()) for frames in (desk.frames[:20], desk.frames[20:]))
    found = together([first, second], desk.frames[0].camera)
    assert found is not None and found.pairs == len(first.vector) + len(second.vector)


def test_a_camera_that_does_not_turn_cannot_tell_its_intrinsics() -> None:
    """What they do to a point is what another translation does, whose inverse depths are the same."""
    rng = np.random.default_rng(2)
    uv, d, zero = rng.uniform(-100, 100, (20, 2)), rng.uniform(0.4, 1.2, 20), np.zeros((20, 2))
    patch, still = np.zeros((20, 8)), np.zeros(20)
    x, y = uv[:, 0] / CAMERA.fx, uv[:, 1] / CAMERA.fy
    points = Hosted(uv, x, y, d, d, zero, patch, np.zeros((20, 8, 2)), (still, still, still), still)
    T = np.eye(4)
    T[:3, 3] = tx, ty, tz = 0.2, -0.1, 0.3
    u_and_v = jacobians(points, placed_in_target(points, T, CAMERA), T, np.zeros(6), CAMERA)[:, :2]
    for column, shift in ((FOCAL, (tx, ty)), (CENTER_U, (tz / CAMERA.fx, 0.0)), (CENTER_V, (0.0, tz / CAMERA.fy))):
        np.testing.assert_allclose(u_and_v[:, :, column], u_and_v[:, :, :2] @ shift, atol=1e-9)


def test_jacobians_are_derivatives() -> None:
    """Of where points of the host are seen in the target, by a camera file that is wrong and rows that are late."""
    rng = np.random.default_rng(1)
    n = 20
    uv = rng.uniform([40, 40], [280, 200], (n, 2)) - [CAMERA.cx, CAMERA.cy]
    d, velocity = rng.uniform(0.4, 1.2, n), rng.standard_normal(6) * [0.3, 0.3, 0.3, 0.5, 0.5, 0.5]
    x, y = uv[:, 0] / CAMERA.fx, uv[:, 1] / CAMERA.fy
    a, b = 0.1, -0.07
    T = np.eye(4)
    T[:3, :3] = [[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]] @ np.array(
        [[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]]
    )
    T[:3, 3] = 0.1, -0.05, 0.08
    host_flow = flow(CAMERA, x, y, d, velocity)
    zero = np.zeros((n, 2))
    late = lateness(uv[:, 1] + CAMERA.cy, CAMERA)
    points = Hosted(uv, x, y, d, np.ones(n), zero, np.zeros((n, 8)), np.zeros((n, 8, 2)), host_flow, late)
    J = jacobians(points, placed_in_target(points, T, CAMERA), T, velocity, CAMERA)

    def seen(focal: float, cu: float, cv: float, readout: float, more_d: float) -> np.ndarray:
        f, c = np.exp(focal) * np.array([CAMERA.fx, CAMERA.fy]), np.array([CAMERA.cx + cu, CAMERA.cy + cv])
        pixel = uv + [CAMERA.cx, CAMERA.cy] - readout * late[:, None] * np.stack(host_flow[:2], 1)
        P = np.column_stack([(pixel - c) / f, np.ones(n)]) / (d + more_d)[:, None]
        P = P @ T[:3, :3].T + T[:3, 3]
        at = P[:, :2] / P[:, 2:]
        moves = np.stack(flow(CAMERA, at[:, 0], at[:, 1], 1 / P[:, 2], velocity)[:2], 1)
        where = f * at + c
        return where + readout * lateness(where[:, 1], CAMERA)[:, None] * moves

    for k, column in enumerate((FOCAL, CENTER_U, CENTER_V, READOUT, DEPTH)):
        step = np.zeros(5)
        step[k] = 1e-5
        numeric = (seen(*step) - seen(*-step)) / 2e-5
        scale = np.abs(numeric).max()
        np.testing.assert_allclose(J[:, :2, column], numeric, atol=2e-4 * scale)
