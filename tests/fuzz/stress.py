"""Statuses under stress: films of which something is spoiled, and how often `ok` is said of a pose that is off.

A seed decides the film, where it is rendered, and everything of what spoils it: where a thing stands, how far, from
which side it comes and when, how bright the exposure jumps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np
import torch
from numpy.random import Generator
from numpy.typing import NDArray

from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.kernels.se3 import inverse
from idrgbdo_torch.odometry import Status, TrackResult
from idrgbdo_torch.synthetic import KINDS as SCENES
from idrgbdo_torch.synthetic import RenderedSequence, SynthConfig
from idrgbdo_torch.synthetic.disturbance import Thing, exposed, flipped, thing, with_holes
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo

Array = NDArray[np.float64]
Shown = tuple[int, RgbdFrame]  # a frame's number in the film, and what the camera shows of it
Spoil = Callable[[Sequence[RgbdFrame], float, Generator], Iterator[Shown]]  # a film, a share, by chance

FRAMES = 120
OFF_M, OFF_DEG = 0.05, 3.0  # a pose that nobody should call ok,
GOOD_M, GOOD_DEG = 0.01, 1.0  # and one that everybody should
MOST_OFF, MOST_DOUBTED = 0.001, 0.05  # what is promised: of the ok frames, of the good ones
BEGIN = (20, 36)  # frame in which something comes
LASTS = 50  # frames
SMALL = {"width": 320, "height": 240, "fx": 262.5, "fy": 262.5, "cx": 159.5, "cy": 119.5}
FIRST_SCENES = SCENES[:2]  # those with structure and texture; what the others lack is no stress


@dataclass(frozen=True)
class Film:
    """Frames in memory, and their true poses."""

    name: str
    frames: Sequence[RgbdFrame]
    T_world_cam: Array  # (N, 4, 4)


@cache
def rendered(seed: int, frames: int = FRAMES) -> Film:
    """A small film of a seed: desks and structures by turns, along a path and with a sensor of its own."""
    config = SynthConfig(kind=FIRST_SCENES[seed % 2], seed=seed, frames=frames, **SMALL)  # type: ignore[arg-type]
    sequence = RenderedSequence(config)
    return Film(f"{config.kind} {seed}", tuple(sequence), sequence.T_world_cam)


def recorded(folder: Path) -> Film:
    """The first frames of a recording with poses."""
    sequence = open_sequence(folder)
    truth = sequence.groundtruth
    assert truth is not None, f"{folder} has no poses to compare with"
    frames = [sequence[k] for k in range(min(FRAMES, len(sequence)))]
    nearest = [int((truth.timestamps - frame.timestamp).abs().argmin()) for frame in frames]
    return Film(folder.name, frames, truth.T_world_cam.numpy()[nearest])


def plain(frames: Sequence[RgbdFrame], share: float, rng: Generator) -> Iterator[Shown]:
    """Nothing is wrong."""
    yield from enumerate(frames)


def exposure(frames: Sequence[RgbdFrame], share: float, rng: Generator) -> Iterator[Shown]:
    """Every ten frames the exposure jumps, up to twice or half of what it was, and back."""
    gains, offsets = 2.0 ** rng.uniform(-1, 1, len(frames) // 20 + 1), rng.uniform(-10, 10, len(frames) // 20 + 1)
    for n, frame in enumerate(frames):
        yield n, exposed(frame, gains[n // 20], offsets[n // 20]) if n % 20 >= 10 else frame


def dropped(frames: Sequence[RgbdFrame], share: float, rng: Generator) -> Iterator[Shown]:
    """A second is missing."""
    begin = int(rng.integers(30, 60))
    yield from ((n, frame) for n, frame in enumerate(frames) if not begin <= n < begin + 30)


def flip(frames: Sequence[RgbdFrame], share: float, rng: Generator) -> Iterator[Shown]:
    """Two of twenty frames are mirrored or upside down."""
    for n, frame in enumerate(frames):
        axes = ((0,), (1,), (0, 1))[int(rng.integers(3))]
        yield n, flipped(frame, axes) if n % 20 in (10, 11) else frame


def holes(frames: Sequence[RgbdFrame], share: float, rng: Generator) -> Iterator[Shown]:
    """Depth is missing, pixel by pixel."""
    yield from ((n, with_holes(frame, share, rng)) for n, frame in enumerate(frames))


def something(frame: RgbdFrame, width: float, height: float, rng: Generator) -> tuple[Thing, int, int]:
    """A thing of so many widths and heights of the image, 0.4 to 0.7 m away, and where it stands in the middle."""
    W, H = frame.camera.width, frame.camera.height
    what = thing(round(width * W), round(height * H), int(rng.integers(1000)))
    near = replace(what, depth=what.depth * np.float32(rng.uniform(0.65, 1.15)))
    return near, round((1 - width) * W / 2), round((1 - height) * H / 2)


def moving(frames: Sequence[RgbdFrame], share: float, rng: Generator) -> Iterator[Shown]:
    """Somebody walks through the view, over so much of its width."""
    what, _, top = something(frames[0], share, 1.2, rng)
    W, width, begin, sign = frames[0].camera.width, what.gray.shape[1], int(rng.integers(*BEGIN)), rng.choice((-1, 1))
    for n, frame in enumerate(frames):
        if begin <= n < begin + LASTS:
            along = round((W + width) * (n - begin) / LASTS) - width
            frame = what.before(frame, along if sign > 0 else W - width - along, top)
        yield n, frame


def fixed(frames: Sequence[RgbdFrame], share: float, rng: Generator) -> Iterator[Shown]:
    """Something comes to hang before the camera for a while, over so much of the image, and moves with it."""
    what, left, top = something(frames[0], share**0.5, share**0.5, rng)
    left, top = (round(place * rng.uniform(0, 2)) for place in (left, top))
    begin = int(rng.integers(*BEGIN))
    for n, frame in enumerate(frames):
        yield n, what.before(frame, left, top) if begin <= n < begin + LASTS else frame


def side(frames: Sequence[RgbdFrame], share: float, rng: Generator) -> Iterator[Shown]:
    """Likewise, from the left or the right border on."""
    what, left, top = something(frames[0], share, 1.3, rng)
    begin, left = int(rng.integers(*BEGIN)), int(rng.choice((0, 2 * left)))
    for n, frame in enumerate(frames):
        yield n, what.before(frame, left, top) if begin <= n < begin + LASTS else frame


def mounted(frames: Sequence[RgbdFrame], share: float, rng: Generator) -> Iterator[Shown]:
    """Something is there from the first frame on, as the robot that carries the camera."""
    what, left, top = something(frames[0], share**0.5, share**0.5, rng)
    left, top = (round(place * rng.uniform(0, 2)) for place in (left, top))
    yield from ((n, what.before(frame, left, top)) for n, frame in enumerate(frames))


SPOILS: dict[str, tuple[Spoil, float]] = {
    **{spoil.__name__: (spoil, 0.0) for spoil in (plain, exposure, dropped, flip)},
    **{f"{spoil.__name__} {s:.0%}": (spoil, s) for spoil in (moving, fixed, side, mounted) for s in (0.3, 0.6, 0.8)},
    **{f"holes {share:.0%}": (holes, share) for share in (0.1, 0.2, 0.3)},
}


def error(T: Array, truth: Array) -> tuple[float, float]:
    """Metres and degrees between two poses."""
    E = inverse(truth) @ T
    return float(np.linalg.norm(E[:3, 3])), float(np.degrees(np.arccos(np.clip((np.trace(E[:3, :3]) - 1) / 2, -1, 1))))


@dataclass
class Tally:
    """Frames of one scenario or of many."""

    ok: int = 0
    off: list[int] = field(default_factory=list)  # numbers of ok frames that are off in their segment
    good: int = 0
    doubted: int = 0  # good ones that are called weak or lost
    lost: int = 0
    segments: int = 0

    def add(self, other: Tally) -> None:
        """Those of another one too."""
        for name in ("ok", "off", "good", "doubted", "lost", "segments"):
            setattr(self, name, getattr(self, name) + getattr(other, name))

    def __str__(self) -> str:
        first = f" (first {self.off[0]})" if self.off else ""
        return (
            f"ok {self.ok:>5}, off {len(self.off):>4}{first}; good {self.good:>5}, doubted {self.doubted:>4}; "
            f"lost {self.lost:>4}, segments begun {self.segments}"
        )


def tally(shown: Sequence[tuple[int, TrackResult]], T_world_cam: Array) -> Tally:
    """Where poses are compared: within their segment, as one that begins anew lies anywhere, and says so."""
    out, begin, segment = Tally(), shown[0], 0
    for number, result in shown:
        if result.segment != segment:
            begin, segment = (number, result), result.segment
            out.segments += result.segment > 0
        T, truth = (
            (result.T_world_cam.numpy(), inverse(T_world_cam[shown[0][0]]) @ T_world_cam[number])
            if segment == 0
            else (
                inverse(begin[1].T_world_cam.numpy()) @ result.T_world_cam.numpy(),
                inverse(T_world_cam[begin[0]]) @ T_world_cam[number],
            )
        )
        metres, degrees = error(T, truth)
        ok, good = result.status is Status.OK, metres < GOOD_M and degrees < GOOD_DEG
        out.ok += ok
        out.lost += result.status is Status.LOST
        out.off += [number] * (ok and (metres > OFF_M or degrees > OFF_DEG))
        out.good += good
        out.doubted += good and not ok
    return out


def stressed(film: Film, name: str, seed: int) -> Tally:
    """One scenario of a film, by a seed."""
    spoil, share = SPOILS[name]
    rng = np.random.default_rng([seed, list(SPOILS).index(name)])
    odometry = IdRgbdo()
    return tally([(n, odometry.track(frame)) for n, frame in spoil(film.frames, share, rng)], film.T_world_cam)


def run(first: int, last: int, folders: Sequence[Path] = (), only: str = "") -> int:
    """Print every scenario of every seed and the sum; 1 where it is more than is promised.

    A seed has a film of its own, or all of the folders.
    """
    torch.set_num_threads(1)
    total = Tally()
    recordings = [recorded(folder) for folder in folders]
    for seed in range(first, last):
        for film in recordings or [rendered(seed)]:
            for name in SPOILS:
                if only and not any(name.startswith(part.strip()) for part in only.split(",")):
                    continue
                one = stressed(film, name, seed)
                print(f"{film.name:<22} seed {seed:<4} {name:<12} {one}", flush=True)
                total.add(one)
    print(f"{'all':<45} {total}")
    return int(len(total.off) > MOST_OFF * total.ok or total.doubted > MOST_DOUBTED * total.good)
