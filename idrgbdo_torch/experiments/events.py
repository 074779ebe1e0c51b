"""Loss is an event: what a covered lens, a second of blur, a jump, black frames and a passer-by leave of a track.

No figure of the paper. Each recording is played forwards and backwards, with ten events on the way; the camera goes on
while it sees nothing. Then follows a place never seen, from another recording, which must not be found.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from time import thread_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..datasets import RgbdSequence
from ..definitions.se3 import inverse
from ..errors import IdRgbdoError
from ..frame import BrokenFrame, RgbdFrame
from ..odometry import Status, TrackResult
from ..synthetic.disturbance import Thing, black, covered, smeared, thing
from ..tracker.id_rgbdo import IdRgbdo
from ..trajectory import Trajectory
from .lab import RESULTS, Lab, Report, Table
from .sweep import Result, sweep
from .task import Clip, code_digest, open_clip

FRAMES = {"covered": 15, "blur": 30, "jump": 0, "black": 8, "person": 30}  # that each kind of event takes
EVENTS = 10
BETWEEN = 24  # frames of good view after each
FAR = 30  # frames, by which a jump goes to another place of those seen before
SOON = 5  # frames after the view's return within which it counts as found
NEW_PLACE = 20  # frames of a place never seen
RATE = 30.0  # Hz
BLUR_PX = (25.0, 65.0)
PERSON = (1.6, 1.4)  # width and height over the image's
WRONG_M, OFF_M, OFF_DEG, RIGHT_M, DRIFTS = 0.1, 0.05, 3.0, 0.02, 1.5  # when a pose is off


@dataclass(frozen=True)
class Shown:
    """A frame of the play: which one of the recording, and what happens to it."""

    number: int
    event: str = ""  # its kind; empty in between
    share: float = 0.0  # of the event that has passed


@dataclass(frozen=True)
class EventTask:
    """One recording with events, and where the place never seen is from."""

    clip: Clip
    elsewhere: Clip | None

    @property
    def key(self) -> str:
        """A digest of everything that decides the result."""
        clips = [(c.digest, c.start, c.frames) for c in (self.clip, self.elsewhere) if c is not None]
        return hashlib.sha256(json.dumps(["events", clips, code_digest()]).encode()).hexdigest()[:20]


def run(lab: Lab) -> Report:
    """Events of every recording: how many were found again in time, and how right the pose was then."""
    tasks = [
        EventTask(clip, lab.clips[(k + 1) % len(lab.clips)] if len(lab.clips) > 1 else None)
        for k, clip in enumerate(lab.clips)
    ]
    with lab.progress("events") as on_progress:
        results = sweep(measure_events, {t.key: t for t in tasks}, lab.out / RESULTS, lab.workers, on_progress)
    found = [(task.clip.name, results[task.key]) for task in tasks]
    for name, result in found:
        if result.get("error"):
            raise IdRgbdoError(f"events: {name}: {result['error']}")
    rows = tuple(summary(name, result) for name, result in found)
    events = tuple((name, *event) for name, result in found for event in result["events"])
    columns = (
        "recording",
        "events",
        "found",
        "right",
        "wrong recoveries",
        "ok frames",
        "ok but off",
        "new place found",
    )
    each = ("recording", "event", "after frames", "error mm", "drift without events mm", "ms", "right")
    total, again = sum(row[1] for row in rows), sum(row[2] for row in rows)
    findings = (
        f"{again} of {total} events were found within {SOON} frames of the view's return ({100 * again / total:.0f} %)",
        f"{sum(row[3] for row in rows)} of these with an error of at most {100 * RIGHT_M:.0f} cm or {DRIFTS} drifts",
        f"wrong recoveries: {sum(row[4] for row in rows)}; a place never seen was found {sum(row[7] for row in rows)} "
        "times",
        f"{sum(row[6] for row in rows)} of {sum(row[5] for row in rows)} ok frames are off by more than "
        f"{100 * OFF_M:.0f} cm or {OFF_DEG:.0f} degrees in their segment",
    )
    return Report(
        f"Events, {lab.source}", {"events": Table(columns, rows), "events_each": Table(each, events)}, findings
    )


def summary(name: str, result: Result) -> tuple[Any, ...]:
    """The row of a recording."""
    events = result["events"]
    found = [event for event in events if event[1] is not None]
    right = sum(event[-1] for event in found)
    return (name, len(events), len(found), right, *(result[k] for k in ("wrong", "ok", "off", "new_place_found")))


def play(frames: int, seed: int = 0) -> tuple[list[Shown], list[tuple[int, str]]]:
    """The frames to show, and the places among them where the view returns, with the event that ends there."""
    rng = np.random.default_rng(seed)
    shown: list[Shown] = []
    returns: list[tuple[int, str]] = []
    walk = to_and_fro(frames)
    number = next(walk)
    for n in range(EVENTS):
        event = tuple(FRAMES)[n % len(FRAMES)]
        for _ in range(BETWEEN):
            shown.append(Shown(number))
            number = next(walk)
        if event == "jump":
            seen = sorted({s.number for s in shown if abs(s.number - number) >= FAR}) or [0]
            walk = to_and_fro(frames, int(rng.choice(seen)))
            number = next(walk)
        for k in range(FRAMES[event]):
            shown.append(Shown(number, event, k / FRAMES[event]))
            number = next(walk)
        returns.append((len(shown), event))
    return shown + [Shown(number)] * SOON, returns


def to_and_fro(frames: int, first: int = 0) -> Iterator[int]:
    """0 to the last and back, for ever, from one of them on."""
    cycle = [*range(frames), *range(frames - 2, 0, -1)]
    while True:
        yield from cycle[first:]
        first = 0


def disturbed(frame: RgbdFrame, shown: Shown, person: Thing, rng: np.random.Generator) -> RgbdFrame:
    """The frame as the event leaves it."""
    width, height = frame.camera.width, frame.camera.height
    match shown.event:
        case "covered":
            return covered(frame, rng)
        case "black":
            return black(frame)
        case "blur":
            return smeared(frame, float(rng.uniform(*BLUR_PX)) * width / 640, float(rng.uniform(0.0, np.pi)))
        case "person":
            left = (PERSON[0] + 1.0) * shown.share - PERSON[0]
            return person.before(frame, round(left * width), round(-(PERSON[1] - 1.0) / 2 * height))
    return frame


def measure_events(task: EventTask) -> Result:
    """Play the recording with its events: each event and how it ended, and counts over all frames."""
    frames, truth = good_frames(task.clip)
    odometry = IdRgbdo()
    drift = [off(odometry.track(frame).T_world_cam.numpy(), T)[0] for frame, T in zip(frames, truth, strict=True)]
    shown, returns = play(len(frames))
    camera, rng = frames[0].camera, np.random.default_rng(1)
    person = thing(round(PERSON[0] * camera.width), round(PERSON[1] * camera.height), 3)
    odometry.reset()
    results, errors, ms = [], [], []
    for n, each in enumerate(shown):
        frame = disturbed(replace(frames[each.number], timestamp=n / RATE), each, person, rng)
        begin = thread_time()
        results.append(odometry.track(frame))
        ms.append(1000.0 * (thread_time() - begin))
        errors.append(off(results[-1].T_world_cam.numpy(), truth[each.number]))
    events: list[tuple[Any, ...]] = []
    for at, event in returns:
        soon = range(at, at + SOON)
        found = next((n for n in soon if results[n].status is not Status.LOST and results[n].segment == 0), None)
        if found is None:
            events.append((event, None, None, None, None, False))
            continue
        error, usual = errors[found][0], drift[shown[found].number]
        right = error <= max(RIGHT_M, DRIFTS * usual)
        events.append((event, found - at, 1000 * error, 1000 * usual, max(ms[at : found + 1]), right))
    within = within_segments(results, [truth[each.number] for each in shown])
    ok = [within[n] for n, result in enumerate(results) if result.status is Status.OK]
    again = [within[n][0] for n, result in enumerate(results) if result.reason.startswith("found again")]
    return {
        "events": events,
        "wrong": sum(metres > WRONG_M for metres in again),
        "ok": len(ok),
        "off": sum(metres > OFF_M or degrees > OFF_DEG for metres, degrees in ok),
        "new_place_found": new_place_found(odometry, task.elsewhere, len(shown), camera) if task.elsewhere else 0,
    }


def within_segments(results: Sequence[TrackResult], truth: Sequence[NDArray[np.float64]]) -> list[tuple[float, float]]:
    """off() of each frame within its segment: one that begins anew lies anywhere, and says so. truth: (4, 4) each."""
    errors, begins = [], {0: -1}
    for n, (result, true) in enumerate(zip(results, truth, strict=True)):
        T, begin = result.T_world_cam.numpy(), begins.setdefault(result.segment, n)
        if begin >= 0:
            T, true = np.linalg.inv(results[begin].T_world_cam.numpy()) @ T, np.linalg.inv(truth[begin]) @ true
        errors.append(off(T, true))
    return errors


def new_place_found(odometry: IdRgbdo, elsewhere: Clip, first: int, camera: Any) -> int:
    """How many frames of another recording are said to be somewhere in this one."""
    frames, _ = good_frames(elsewhere, NEW_PLACE)
    if frames[0].camera != camera:
        return 0
    results = [odometry.track(replace(frame, timestamp=(first + n) / RATE)) for n, frame in enumerate(frames)]
    return sum("found" in result.reason for result in results)


def good_frames(clip: Clip, most: int | None = None) -> tuple[list[RgbdFrame], list[NDArray[np.float64]]]:
    """The frames of a clip that can be read and have a true pose T_first_frame (4, 4). Raises IdRgbdoError without."""
    sequence: RgbdSequence = open_clip(clip if most is None else replace(clip, frames=most))
    if sequence.groundtruth is None:
        raise IdRgbdoError(f"events: expected a groundtruth.txt in '{clip.folder}', found none; choose others")
    frames = [frame for frame in sequence if not isinstance(frame, BrokenFrame)]
    return frames, poses_of(sequence.groundtruth, frames)


def poses_of(truth: Trajectory, frames: Sequence[RgbdFrame]) -> list[NDArray[np.float64]]:
    """T_first_frame (4, 4) of each frame, by the nearest true pose."""
    numbers = [int((truth.timestamps - frame.timestamp).abs().argmin()) for frame in frames]
    first = inverse(truth.T_world_cam[numbers[0]])
    return [(first @ truth.T_world_cam[number]).numpy() for number in numbers]


def off(T: NDArray[np.float64], true: NDArray[np.float64]) -> tuple[float, float]:
    """How far a pose (4, 4) is from the true one: metres and degrees."""
    E = np.linalg.inv(true) @ T
    cosine = np.clip((np.trace(E[:3, :3]) - 1.0) / 2.0, -1.0, 1.0)
    return float(np.linalg.norm(E[:3, 3])), float(np.degrees(np.arccos(cosine)))
