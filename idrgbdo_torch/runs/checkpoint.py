"""The state of a run on disk, so that a run that was killed goes on where it was.

The whole odometry is written with the records so far, and the continuation then is the same to the last bit: window,
prior, random numbers and velocity are all there. Starting anew at the last written pose would need no such file, but
loses the window and the motion, and the poses differ from there on. 60 MB at 640x480, most of it the images of the
window, take some 0.2 s to write, however long the run: what only grows is in a file beside it (see rows.py). One is
written only when 30 times that has passed since the last: at most 3 % of the time is spent, and some seconds of work
are done twice. The file is replaced in one step, so there is always a whole one. It ends with a checksum over
everything before, which is compared before anything is believed, and holds data of known types alone (see tree.py):
reading a stranger's checkpoint runs none of his code.
"""

from __future__ import annotations

import hashlib
import json
import mmap
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any

from ..config import Config, KeyframeConfig, NoiseConfig, SelectionConfig, TrackingConfig, WindowConfig
from ..definitions.camera import Pinhole
from ..definitions.growing import Column
from ..definitions.marginalization import LinearPrior
from ..definitions.records import Records
from ..errors import IdRgbdoError
from ..frame import Frame, Keyframe, RgbdFrame
from ..measurement import Noise, Points, WindowPairs, WindowPoints, WindowSystem
from ..odometry import ConstantVelocity, Odometry, Record, Status, TrackResult
from ..text import configfile
from ..tracker.backends import BACKENDS
from ..tracker.camera_equations import Moving
from ..tracker.camera_estimate import CameraEstimator, Waiting
from ..tracker.carried import Carried
from ..tracker.features import Features
from ..tracker.glances import Glance, Glances
from ..tracker.history import History
from ..tracker.id_rgbdo import IdRgbdo
from ..tracker.mapping import Cloud, Kept
from ..tracker.members import Members
from ..tracker.motion import Motion
from ..tracker.places import Place, Places
from ..tracker.reference import Reference
from ..tracker.repeated import Seen
from ..tracker.smoothing import Departure, Departures
from ..tracker.tracking import Tracked
from ..tracker.window import Solved, Window
from .rows import PATTERN, RowsFile, read_chunk
from .source import Source, difference
from .tree import Codec

NAME = "checkpoint.bin"
MAGIC = b"idrgbdo checkpoint 7\n"  # the number is the format's
SHARE = 30.0  # times what writing one takes, between two
LEAST_S = 1.0  # between two
DIGEST_BYTES = 32
COUNT_BYTES = 8  # of the length of the text
TYPES = (  # what a state may be made of; a new type in the tracker's state has to be named here
    Config, NoiseConfig, SelectionConfig, TrackingConfig, KeyframeConfig, WindowConfig,
    Pinhole, LinearPrior, RgbdFrame, Frame, Keyframe, Noise, Points, WindowPoints,
    WindowPairs, WindowSystem, Solved, Features, Place, Places, Departure, Motion, Carried, Reference, History,
    Members, Status, TrackResult, Record, Records, Column, Departures, ConstantVelocity, IdRgbdo, Cloud, Kept,
    Tracked, Window, Seen, CameraEstimator, Waiting, Moving, Glance, Glances,
)  # fmt: skip
CONSTANTS = {f"backend {name}": backend for name, backend in BACKENDS.items()}


@dataclass(frozen=True)
class Identity:
    """What a run is of. One that differs in any of it is not continued."""

    version: str
    settings: str  # TOML
    sequence: str
    frames: int
    first_s: float
    last_s: float
    camera: str
    source: Source | None = None  # how the recording is read, and what is in it

    @staticmethod
    def of(
        version: str, config: Config, name: str, times: Sequence[float], camera: Pinhole, source: Source | None = None
    ) -> Identity:
        """Of a run over a sequence with frames at the given times (s)."""
        first, last = (times[0], times[-1]) if times else (0.0, 0.0)
        return Identity(version, configfile.dump(config), name, len(times), first, last, str(camera), source)

    def difference(self, saved: dict[str, Any]) -> str:
        """The first part in which a saved one differs, as a phrase; empty where none does."""
        for name, mine in asdict(self).items():
            theirs = saved.get(name)
            if theirs == mine:
                continue
            if name == "settings":
                lines = set(str(mine).splitlines()) ^ set(str(theirs).splitlines())
                return f"settings ({', '.join(sorted(lines)[:2])})"
            if name == "source":
                return difference(mine, theirs)
            return f"{name} ({theirs}, now {mine})"
        return ""


@dataclass
class State:
    """What a run needs to go on."""

    odometry: Odometry
    records: Sequence[Record]
    extras: list[Any]  # whatever else was collected on the way
    camera: CameraEstimator = field(default_factory=CameraEstimator)  # what was seen of the camera

    def __post_init__(self) -> None:
        self.records = Records.of(self.records)  # a run goes on in these; of a list it would keep a copy of its own


def can_keep(odometry: Odometry) -> bool:
    """Whether the state of an odometry can be written: one of this package, not one that somebody made of it."""
    return type(odometry) in TYPES


class Checkpoints:
    """Writes the state into a run's folder, now and then."""

    def __init__(self, folder: Path, identity: Identity, types: Sequence[type] = ()) -> None:
        """types: of what the extras are made of, besides TYPES."""
        self._path = folder / NAME
        self._identity = identity
        self._codec = Codec([*TYPES, *types], CONSTANTS)
        self._rows = RowsFile(folder)
        self._due = monotonic() + LEAST_S
        self.problem = ""  # why the last one could not be written, a sentence

    def offer(self, state: State, now: bool = False) -> None:
        """Write the state if it is time to, or at once. Where that fails `problem` says why, and the run goes on."""
        if now or monotonic() >= self._due:
            try:
                self.write(state)
                self.problem = ""
            except IdRgbdoError as error:
                self.problem = str(error)
                self._due = monotonic() + SHARE * LEAST_S

    def write(self, state: State) -> None:
        """Write the state. Raises IdRgbdoError where the folder cannot take it; the file before it is left then."""
        begin = monotonic()
        part = self._path.with_suffix(".part")
        try:
            self._write(part, state)
            part.replace(self._path)
            self._rows.forget_others()
        except OSError as error:
            part.unlink(missing_ok=True)
            raise IdRgbdoError(
                f"out: cannot write '{part}': {error.strerror}; make room or pass another --out"
            ) from error
        end = monotonic()
        self._due = end + max(LEAST_S, SHARE * (end - begin))

    def _write(self, path: Path, state: State) -> None:
        tree, numbers = self._codec.write((state.odometry, state.records, state.extras, state.camera), self._rows.keep)
        text = json.dumps({"identity": asdict(self._identity), "rows": self._rows.path.name, **tree}).encode()
        digest = hashlib.sha256()
        path.unlink(missing_ok=True)  # what has that name may be a pipe
        with path.open("wb") as file:
            for piece in (MAGIC, len(text).to_bytes(COUNT_BYTES, "big"), text, *numbers):
                digest.update(piece)
                file.write(piece)
            file.write(digest.digest())

    def remove(self) -> None:
        """A finished run needs none."""
        self._path.unlink(missing_ok=True)
        for path in self._path.parent.glob(PATTERN):
            path.unlink(missing_ok=True)


def load(folder: Path, identity: Identity, types: Sequence[type] = ()) -> State:
    """The state of the run in a folder; types: as for Checkpoints.

    Raises IdRgbdoError where there is none, it is damaged, or it is of another version, recording or settings.
    """
    path = folder / NAME
    if not path.is_file():
        done = (folder / "summary.json").exists()
        why = "that run is finished" if done else "there is no interrupted run"
        raise IdRgbdoError(f"resume: expected '{path}', but {why}; leave out --resume or name its folder with --out")
    try:
        with path.open("rb") as file:  # mapped, so that a file of any size costs no memory before it is believed
            data = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
    except (OSError, ValueError) as error:  # an empty file cannot be mapped
        raise IdRgbdoError(f"resume: '{path}' cannot be read ({error}); run without --resume") from error
    return _read(data, path, identity, Codec([*TYPES, *types], CONSTANTS))


def _read(data: memoryview, path: Path, identity: Identity, codec: Codec) -> State:
    if data[: len(MAGIC)] != MAGIC:
        raise IdRgbdoError(f"resume: '{path}' is no checkpoint of this version; run without --resume")
    if hashlib.sha256(data[:-DIGEST_BYTES]).digest() != data[-DIGEST_BYTES:]:
        raise IdRgbdoError(f"resume: '{path}' is damaged (its checksum is wrong); run without --resume")
    begin = len(MAGIC) + COUNT_BYTES
    end = begin + int.from_bytes(data[len(MAGIC) : begin], "big")
    try:
        text = json.loads(bytes(data[begin:end]))
        saved = dict(text["identity"])
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise IdRgbdoError(f"resume: '{path}' cannot be read ({error}); run without --resume") from error
    if different := identity.difference(saved):
        raise IdRgbdoError(
            f"resume: the run in '{path.parent}' has another {different}; repeat its flags or start anew"
        )
    try:
        kept = partial(read_chunk, path.parent, str(text.get("rows")))
        state = State(*codec.read(text, data[end:-DIGEST_BYTES], kept))
    except (IdRgbdoError, TypeError) as error:
        raise IdRgbdoError(f"resume: '{path}' cannot be read ({error}); run without --resume") from error
    records, extras = state.records, state.extras
    if not isinstance(extras, list) or not callable(getattr(state.odometry, "track", None)):
        raise IdRgbdoError(f"resume: '{path}' holds no state of a run; run without --resume")
    if not isinstance(state.camera, CameraEstimator):
        raise IdRgbdoError(f"resume: '{path}' holds no state of a run; run without --resume")
    if not isinstance(records, Records | list) or not all(isinstance(record, Record) for record in records):
        raise IdRgbdoError(f"resume: '{path}' holds something else than frames; run without --resume")
    return State(state.odometry, Records.of(records), extras, state.camera)
