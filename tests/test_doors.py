"""The doors of the library: an odd input is one sentence before anything changes, and never spoils what follows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from rendered import Film
from torch import Tensor

from idrgbdo_torch import Config, FrameToFrame, IdRgbdo, IdRgbdoError, Pinhole, RgbdFrame, Trajectory, run, select_rows
from idrgbdo_torch.definitions.results import Record, TrackResult
from idrgbdo_torch.frame import BrokenFrame
from idrgbdo_torch.odometry import Alignment, Run, Status
from idrgbdo_torch.runs.folder import believable

FRAMES = 8


Good = tuple[list[RgbdFrame], Tensor]


def poses(odometry: IdRgbdo, frames: list[RgbdFrame]) -> Tensor:
    return torch.stack([odometry.track(frame).T_world_cam for frame in frames])


@pytest.fixture(scope="module")
def good(desk: Film) -> Good:
    """Frames, and their poses."""
    frames = list(desk.frames[:FRAMES])
    return frames, poses(IdRgbdo(), frames)


def behind(frame: RgbdFrame, **parts: Any) -> RgbdFrame:
    """A frame whose parts were changed behind the constructor's back."""
    out = replace(frame)
    for name, part in parts.items():
        object.__setattr__(out, name, part)
    return out


SIZE = (240, 320)
REFUSED: dict[str, Callable[[RgbdFrame], Any]] = {
    "no frame": lambda f: None,
    "a broken frame": lambda f: BrokenFrame(0.1, "gone"),
    "float colour": lambda f: replace(f, color=torch.full((*SIZE, 3), torch.nan)),
    "colour of another size": lambda f: replace(f, color=torch.zeros(10, 10, 3, dtype=torch.uint8)),
    "sparse colour": lambda f: replace(f, color=torch.zeros(*SIZE, 3, dtype=torch.uint8).to_sparse()),
    "colour without data": lambda f: replace(f, color=torch.zeros(*SIZE, 3, dtype=torch.uint8, device="meta")),
    "colour behind the back": lambda f: behind(f, color=torch.zeros(10, 10, 3, dtype=torch.uint8).to_sparse()),
    "gray as a list": lambda f: replace(f, gray=f.gray.tolist()),
    "gray as objects": lambda f: replace(f, gray=f.gray.numpy().astype(object)),
    "sparse depth": lambda f: replace(f, depth=f.depth.to_sparse()),
    "depth without data": lambda f: replace(f, depth=f.depth.to("meta")),
    "complex depth": lambda f: replace(f, depth=f.depth.to(torch.complex64)),
    "infinite gray among nan": lambda f: replace(f, gray=torch.where(f.gray > 100, torch.nan, 1e38)),
    "time None": lambda f: replace(f, timestamp=None),
    "time nan": lambda f: replace(f, timestamp=float("nan")),
    "time inf": lambda f: replace(f, timestamp=float("inf")),
    "time as text": lambda f: replace(f, timestamp="1.0"),
    "time of 400 digits": lambda f: replace(f, timestamp=10**400),
    "time nan behind the back": lambda f: behind(f, timestamp=float("nan")),
    "no camera": lambda f: replace(f, camera=None),
    "camera of nan": lambda f: replace(f, camera=replace(f.camera, fx=float("nan"))),
    "camera of 1e308": lambda f: replace(f, camera=replace(f.camera, fx=1e308)),
    "half a pixel": lambda f: replace(f, camera=replace(f.camera, width=160.5)),
}


@pytest.mark.parametrize("name", list(REFUSED))
def test_what_is_refused_leaves_no_trace(name: str, good: Good) -> None:
    frames, expected = good
    odometry = IdRgbdo()
    assert torch.equal(poses(odometry, frames[:4]), expected[:4])
    with pytest.raises(IdRgbdoError) as error:
        odometry.track(REFUSED[name](frames[4]))
    assert "\n" not in str(error.value) and len(str(error.value)) > 20
    assert torch.equal(poses(odometry, frames[4:]), expected[4:])
    assert len(odometry.trajectory()) == FRAMES
    assert len(odometry.map_points()[0]) > 100


TAKEN: dict[str, Callable[[RgbdFrame], RgbdFrame]] = {
    "a gradient": lambda f: replace(f, gray=f.gray.clone().requires_grad_()),
    "read-only arrays": lambda f: replace(f, gray=frozen(f.gray), depth=frozen(f.depth)),
    "big-endian arrays": lambda f: replace(f, depth=f.depth.numpy().astype(">f4")),
    "by columns": lambda f: replace(f, gray=f.gray.T.contiguous().T),
    "masked arrays": lambda f: replace(f, depth=np.ma.masked_equal(f.depth.numpy(), 0)),
    "a number of numpy": lambda f: replace(f, timestamp=np.float64(f.timestamp)),
}


def frozen(image: torch.Tensor) -> Any:
    array = image.numpy().copy()
    array.flags.writeable = False
    return array


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", list(TAKEN))
def test_images_in_other_forms_are_the_same(name: str, good: Good) -> None:
    frames, expected = good
    assert torch.equal(poses(IdRgbdo(), [TAKEN[name](frame) for frame in frames]), expected)


@pytest.mark.parametrize("raw", [False, True])
def test_buffers_may_be_filled_again(desk: Film, raw: bool) -> None:
    """As a camera's driver does: gray, depth and colour, for poses and map."""

    def frame(time: float, gray: Any, depth: Any, color: Any) -> RgbdFrame:
        if raw:
            return RgbdFrame.from_images(time, color, depth, desk.frames[0].camera)
        return RgbdFrame(time, gray, depth, desk.frames[0].camera, color)

    fresh, reused = IdRgbdo(), IdRgbdo()
    buffers = np.zeros(SIZE, np.float32), np.zeros(SIZE, np.float32), np.zeros((*SIZE, 3), np.uint8)
    for each in desk.frames[:20]:
        assert each.color is not None
        images = (each.gray, each.depth, each.color)
        fresh.track(frame(each.timestamp, *(image.clone() for image in images)))
        for buffer, image in zip(buffers, images, strict=True):
            buffer[:] = image
        reused.track(frame(each.timestamp, *buffers))
    cloud, again = fresh.maps()[0], reused.maps()[0]
    for part in ("xyz", "rgb", "normal"):
        assert np.array_equal(getattr(again, part), getattr(cloud, part)), part
    assert torch.equal(fresh.trajectory().T_world_cam, reused.trajectory().T_world_cam)


@pytest.mark.parametrize("time", [5 / 30, -10.0, 1e9])  # again, back, and far ahead
def test_one_odd_time_costs_at_most_one_pose(desk: Film, time: float) -> None:
    frames = [replace(frame, timestamp=n / 30) for n, frame in enumerate(desk.frames[:12])]
    frames[6] = replace(frames[6], timestamp=time)
    odometry = IdRgbdo()
    done = run(odometry, frames)
    assert set(done.statuses) <= {Status.OK, Status.WEAK}
    for trajectory in (odometry.trajectory(), done.trajectory()):
        assert len(trajectory) >= len(frames) - 1
        rest = [n for n in range(len(frames)) if n not in (5, 6)]
        at = torch.searchsorted(trajectory.timestamps, torch.tensor([n / 30 for n in rest], dtype=torch.float64))
        for n, pose in zip(rest, trajectory.T_world_cam[at], strict=True):
            assert (pose @ desk.T(n, 0))[:3, 3].norm() < 0.01
    repeated = time == 5 / 30
    assert (len(odometry.trajectory()) < len(frames)) == bool(odometry.trajectory().notes) == repeated


def test_lost_frames_are_left_out_whatever_the_order_of_times() -> None:
    eye = torch.eye(4, dtype=torch.float64)
    statuses = {0.0: Status.OK, 2.0: Status.LOST, 1.0: Status.WEAK, 3.0: Status.OK}
    done = Run("x", [Record(t, TrackResult(eye, status, "so"), 0.0, 0.0) for t, status in statuses.items()])
    assert believable(done.trajectory(), done).timestamps.tolist() == [0.0, 1.0, 3.0]


def test_a_pose_that_is_none_resets_nothing(good: Good) -> None:
    frames, expected = good
    odometry = IdRgbdo()
    poses(odometry, frames[:4])
    for T in (2 * np.eye(4), np.eye(3), torch.full((4, 4), torch.nan), "here", -torch.eye(4)):
        with pytest.raises(IdRgbdoError, match="T_world_cam"):
            odometry.reset(T)  # type: ignore[arg-type]
    assert torch.equal(poses(odometry, frames[4:]), expected[4:])
    odometry.reset(torch.eye(4, requires_grad=True))
    assert len(odometry.trajectory()) == 0


def test_a_methods_nonsense_costs_its_frame(desk: Film) -> None:
    answers = iter([torch.full((4, 4), torch.nan), torch.eye(4, dtype=torch.float64)])
    odometry = FrameToFrame(lambda source, target, guess: Alignment(next(answers), Status.OK))
    results = [odometry.track(frame) for frame in desk.frames[:3]]
    assert [result.status for result in results] == [Status.OK, Status.LOST, Status.OK]
    assert "T_target_source" in results[1].reason
    results[2].T_world_cam.fill_(7)  # the result is the caller's
    assert torch.equal(odometry.trajectory().T_world_cam[2], torch.eye(4, dtype=torch.float64))


@pytest.mark.parametrize(
    ("call", "complaint"),
    [
        (lambda: IdRgbdo({"points": 3}), "config: expected a Config, got dict"),  # type: ignore[arg-type]
        (lambda: IdRgbdo(replace(Config(), seed="x")), "seed: expected a whole number"),  # type: ignore[arg-type]
        (lambda: run(None, []), "odometry: expected an Odometry"),  # type: ignore[arg-type]
        (lambda: run(IdRgbdo(), 7), "frames: expected RgbdFrames"),  # type: ignore[arg-type]
        (lambda: select_rows("rows", 3), "select_rows: expected .* got J str, .*"),  # type: ignore[arg-type]
        (lambda: select_rows(torch.zeros(5), 3), "J: expected finite"),
        (lambda: Trajectory([0.0], None), "timestamps: expected a dense float64 tensor, got list"),  # type: ignore[arg-type]
        (lambda: Pinhole(width="x", height=1, fx=1, fy=1, cx=0, cy=0), "camera: width: expected"),  # type: ignore[arg-type]
    ],
)
def test_every_door_says_one_sentence(call: Callable[[], object], complaint: str) -> None:
    with pytest.raises(IdRgbdoError, match=complaint) as error:
        call()
    assert "\n" not in str(error.value)
