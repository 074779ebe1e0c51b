"""Attacks on track(): hostile frames among good ones cost at most themselves.

What is refused leaves no trace: the good frames get the same bits as without it. What is tracked is lost or found, with
a finite pose and a sentence, and the track ends where it should.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any
from warnings import catch_warnings, simplefilter

import numpy as np
import torch
from numpy.random import Generator
from torch import Tensor

from idrgbdo_torch.definitions.camera import Pinhole
from idrgbdo_torch.frame import BrokenFrame, RgbdFrame
from idrgbdo_torch.odometry import Alignment, ConstantVelocity, FrameToFrame, Odometry, Status, TrackResult
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo
from idrgbdo_torch.tracker.warmup import tiny_film

from .promise import refused

HOSTILE = 6  # frames of one attack
AGAIN = 4  # times that the film is seen, there and back
NUMBERS = (np.nan, np.inf, -np.inf, 1e38, -1e38, 0.0, -1.0, 255.0, 65535.0, 1e-45)
TIMES: tuple[Any, ...] = (
    None, "1.0", b"1", float("nan"), float("inf"), -float("inf"), 1e308, -1e11, 1e11, 1e12, 10**400, -1, 0, True, 1j,
    np.float64("nan"), np.float32(0.3), np.datetime64("2026-01-01"), np.array([0.1, 0.2]), np.array(0.2), [], {},
    torch.tensor(0.2), torch.tensor(0.2, requires_grad=True), torch.tensor(1.0, device="meta"),
)  # fmt: skip


@cache
def film() -> tuple[RgbdFrame, ...]:
    """A few good frames with colours."""
    frames = tuple(tiny_film())
    return tuple(replace(f, color=f.gray.to(torch.uint8)[..., None].expand(-1, -1, 3).contiguous()) for f in frames)


def good_frames() -> list[RgbdFrame]:
    """There and back again, at 30 a second."""
    turn = [*film(), *film()[-2:0:-1]] * AGAIN
    return [replace(frame, timestamp=number / 30) for number, frame in enumerate(turn[: 2 * len(film())])]


def other_form(rng: Generator, image: Tensor) -> Any:
    """The image as something else: most of it no image."""
    forms: list[Callable[[], Any]] = [
        lambda: None, lambda: image.tolist(), lambda: image.numpy().astype(object), lambda: image.to_sparse(),
        lambda: image.to("meta"), lambda: image.float().clone().requires_grad_(), lambda: image.to(torch.complex64),
        lambda: torch.quantize_per_tensor(image.float(), 1.0, 0, torch.quint8), lambda: image.double(),
        lambda: image.half(), lambda: image.bool(), lambda: image[None], lambda: image[..., :-1], lambda: image[:0],
        lambda: image.flatten()[0], lambda: image.numpy().astype(">f4"), lambda: image.numpy()[::-1][::-1],
        lambda: np.ma.masked_less(image.numpy(), 50), lambda: np.matrix(np.zeros((3, 4))), lambda: "image",
        lambda: frozen(image.numpy()), lambda: image.mT.contiguous().mT, lambda: image.numpy().astype("U8"),
        lambda: np.zeros(image.shape, [("a", "f4")]), lambda: torch.nested.nested_tensor([image.float()]),
        lambda: image.as_subclass(Own), lambda: torch.nn.Parameter(image.float()), lambda: image.numpy().astype("f2"),
        lambda: np.broadcast_to(np.float32(7), image.shape), lambda: torch.tensor(7.0).expand(image.shape),
        lambda: image.numpy().astype(np.uint64), lambda: image.numpy().astype(np.longdouble), lambda: 1.0,
        lambda: torch.zeros(0), lambda: image.numpy().astype("M8[s]"), lambda: memoryview(image.numpy()),
    ]  # fmt: skip
    with catch_warnings():
        simplefilter("ignore")  # torch's, of making some
        return forms[int(rng.integers(len(forms)))]()


class Own(Tensor):
    """Somebody's own tensor."""


def frozen(image: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """A copy that cannot be written to."""
    copy = image.copy()
    copy.flags.writeable = False
    return copy


def other_values(rng: Generator, image: Tensor) -> Tensor:
    """The image with other numbers in places."""
    out = image.float().clone()
    height, width = out.shape[:2]
    for _ in range(int(rng.integers(1, 4))):
        kind = int(rng.integers(6))
        a, b = sorted(rng.integers(0, height + 1, 2).tolist())
        number = float(rng.choice(NUMBERS))
        if kind == 0:
            out[a:b] = number
        elif kind == 1:
            out[torch.from_numpy(rng.random((height, width)) < rng.random())] = number
        elif kind == 2:
            out = out.flip(int(rng.integers(2)))
        elif kind == 3:
            out = out.roll(int(rng.integers(width)), 1)
        elif kind == 4:
            out = out * float(rng.choice((0.0, 1 / 255, 1e-3, 0.5, 2.0, 1000.0)))
        else:
            out = torch.from_numpy(rng.uniform(0, 255, out.shape).astype(np.float32))
    return out


def hostile_frame(rng: Generator, frame: RgbdFrame) -> Any:
    """Something that is handed to track() instead of a frame; IdRgbdoError where it cannot even be made."""
    kind = int(rng.integers(9))
    part = ("gray", "depth", "color")[int(rng.integers(3))]
    image = getattr(frame, part)
    if kind == 0:
        return replace(frame, **{part: other_form(rng, image)})
    if kind == 1:
        values = other_values(rng, image)
        return replace(
            frame, **{part: values.nan_to_num().clamp(0, 255).to(image.dtype) if part == "color" else values}
        )
    if kind == 2:
        return replace(frame, timestamp=TIMES[int(rng.integers(len(TIMES)))])
    if kind == 3:  # a good frame again, or at a time that is gone
        return replace(frame, timestamp=frame.timestamp - float(rng.choice((0.0, 1 / 30, 0.5, -1e9, 1e9))))
    if kind == 4:
        width, height = (int(rng.choice((1, 2, 31, 80, 160, 4000))) for _ in range(2))
        camera = Pinhole(width=width, height=height, fx=100.0, fy=100.0, cx=width / 2, cy=height / 2)
        shape = (min(height, 200), min(width, 200))
        return RgbdFrame(frame.timestamp, torch.full(shape, 100.0), torch.ones(shape), camera)
    if kind == 5:
        numbers = (0, -1, 160.5, 1e-300, 1e308, float("nan"), None, "140", 10**400, True)
        return replace(frame, camera=replace(frame.camera, **{
            ("width", "height", "fx", "fy", "cx", "cy")[int(rng.integers(6))]: numbers[int(rng.integers(len(numbers)))]
        }))  # fmt: skip
    if kind == 6:
        return (None, 7, "frame", BrokenFrame(0.1, "gone"), (frame.gray, frame.depth), vars(frame))[rng.integers(6)]
    if kind == 7:  # changed behind the constructor's back
        spoiled = replace(frame)
        object.__setattr__(spoiled, part, other_form(rng, image))
        return spoiled
    rgb = other_form(rng, frame.color) if rng.random() < 0.5 else frame.color
    depth = other_form(rng, frame.depth) if rng.random() < 0.5 else frame.depth
    scale = (None, 1000, 0, -1, float("nan"), "1000", 1e-300, 10**400)[int(rng.integers(8))]
    return RgbdFrame.from_images(frame.timestamp, rgb, depth, frame.camera, depth_scale=scale)  # type: ignore[arg-type]


def sound(result: TrackResult) -> None:
    """A pose that is one, a status, a sentence where it is not sure."""
    T = result.T_world_cam
    assert tuple(T.shape) == (4, 4) and bool(T.isfinite().all()), "no finite pose"
    skew = float((T[:3, :3].T @ T[:3, :3] - torch.eye(3, dtype=torch.float64)).abs().max())
    assert skew < 1e-6, f"no rotation, by {skew}"
    assert result.status is Status.OK or (result.reason and "\n" not in result.reason), "no reason"


def looks_inside(odometry: IdRgbdo, frames: int) -> None:
    """Whatever else may be asked."""
    trajectory = odometry.trajectory()
    assert len(trajectory) <= frames and bool(trajectory.T_world_cam.isfinite().all())
    points, colours = odometry.map_points()
    assert len(points) == len(colours)
    odometry.last_points()
    odometry.last_candidates()
    odometry.window_keyframes()


@cache
def undisturbed() -> tuple[Tensor, ...]:
    """The poses of the good frames alone."""
    odometry = IdRgbdo()
    return tuple(odometry.track(frame).T_world_cam for frame in good_frames())


def hostile_frames(rng: Generator, folder: Path) -> None:
    """Some among good ones, the buffers of which are filled again after each."""
    odometry, frames = IdRgbdo(), good_frames()
    places = set(rng.integers(0, len(frames), HOSTILE).tolist())
    tracked = 0
    for number, (frame, T) in enumerate(zip(frames, undisturbed(), strict=True)):
        if number in places:
            error = refused(lambda frame=frame: sound(odometry.track(hostile_frame(rng, frame))))  # type: ignore[misc]
            tracked += error is None
        buffered = frame.copied()
        result = odometry.track(buffered)
        for buffer in (buffered.gray, buffered.depth, buffered.color):
            if buffer is not None:
                buffer.fill_(3)
        sound(result)
        if not tracked:
            assert torch.equal(result.T_world_cam, T), f"frame {number} lies elsewhere after a refusal"
    looks_inside(odometry, len(frames) + tracked)
    odometry.reset()
    assert torch.equal(odometry.track(frames[0]).T_world_cam, undisturbed()[0]), "reset() left something"


def hostile_poses(rng: Generator, folder: Path) -> None:
    """reset() with what is no pose leaves everything as it was; a method's own nonsense costs its frame."""
    frames = good_frames()
    T = np.eye(4) + rng.normal(0, 10.0 ** float(rng.integers(-12, 3)), (4, 4)) * (rng.random((4, 4)) < 0.3)
    given = (T, torch.from_numpy(T), other_form(rng, torch.from_numpy(T)), T.tolist(), T[:3])[int(rng.integers(5))]
    makers: list[Callable[[], Odometry]] = [
        IdRgbdo, ConstantVelocity, lambda: FrameToFrame(lambda a, b, guess: nonsense(rng, given))
    ]  # fmt: skip
    odometry = makers[int(rng.integers(3))]()
    first = odometry.track(frames[0])
    if refused(lambda: odometry.reset(given)) is not None:  # type: ignore[arg-type]
        assert len(odometry.trajectory()) == 1, "a refused reset() forgot something"
    sound(odometry.track(frames[1]))
    sound(first)


def nonsense(rng: Generator, T: Any) -> Any:
    """What a pairwise method may say."""
    status = (Status.OK, Status.WEAK, Status.LOST)[int(rng.integers(3))]
    return Alignment(T, status, "" if status is Status.OK else "it says so")
