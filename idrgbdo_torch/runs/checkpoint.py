"""The state of a run on disk, so that a run that was killed goes on where it was.

The whole odometry is pickled with the records so far, and the continuation then is the same to rounding: window, prior,
random numbers and velocity are all there. Starting anew at the last written pose would need no such file, but loses the
window and the motion, and the poses differ from there on. 60 MB at 640x480, most of it the images of the window, take
0.2 s to write; so one is written only when 30 times that has passed since the last: at most 3 % of the time is spent,
and some seconds of work are done twice. The file is replaced in one step, so there is always a whole one.
"""

from __future__ import annotations

import json
import pickle
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import monotonic
from typing import Any

from .. import configfile
from ..config import Config
from ..definitions.camera import Pinhole
from ..errors import IdRgbdoError
from ..odometry import Odometry, Record

NAME = "checkpoint.bin"
SHARE = 30.0  # times what writing one takes, between two
LEAST_S = 1.0  # between two


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

    @staticmethod
    def of(version: str, config: Config, name: str, timestamps: Sequence[float], camera: Pinhole) -> Identity:
        """Of a run over a sequence."""
        first, last = (timestamps[0], timestamps[-1]) if timestamps else (0.0, 0.0)
        return Identity(version, configfile.dump(config), name, len(timestamps), first, last, str(camera))

    def difference(self, saved: dict[str, Any]) -> str:
        """The first part in which a saved one differs, as a phrase; empty where none does."""
        for name, mine in asdict(self).items():
            theirs = saved.get(name)
            if theirs != mine and name == "settings":
                lines = set(str(mine).splitlines()) ^ set(str(theirs).splitlines())
                return f"settings ({', '.join(sorted(lines)[:2])})"
            if theirs != mine:
                return f"{name} ({theirs}, now {mine})"
        return ""


@dataclass
class State:
    """What a run needs to go on."""

    odometry: Odometry
    records: list[Record]
    extras: list[Any]  # whatever else was collected on the way


class Checkpoints:
    """Writes the state into a run's folder, now and then."""

    def __init__(self, folder: Path, identity: Identity) -> None:
        self._path = folder / NAME
        self._identity = identity
        self._due = monotonic() + LEAST_S

    def offer(self, state: State) -> None:
        """Write the state if it is time to."""
        if monotonic() >= self._due:
            self.write(state)

    def write(self, state: State) -> None:
        """Write the state. Raises IdRgbdoError where the folder cannot take it."""
        begin = monotonic()
        part = self._path.with_suffix(".part")
        try:
            with part.open("wb") as file:
                file.write(json.dumps(asdict(self._identity)).encode() + b"\n")
                pickle.dump(state, file, protocol=pickle.HIGHEST_PROTOCOL)
            part.replace(self._path)
        except OSError as error:
            raise IdRgbdoError(
                f"out: cannot write '{part}': {error.strerror}; make room or pass another --out"
            ) from error
        end = monotonic()
        self._due = end + max(LEAST_S, SHARE * (end - begin))

    def remove(self) -> None:
        """A finished run needs none."""
        self._path.unlink(missing_ok=True)


def load(folder: Path, identity: Identity) -> State:
    """The state of the run in a folder. Unpickling runs code, so only open folders that you trust.

    Raises IdRgbdoError where there is none, or it is of another version, sequence or settings.
    """
    path = folder / NAME
    if not path.is_file():
        done = (folder / "summary.json").exists()
        why = "that run is finished" if done else "there is no interrupted run"
        raise IdRgbdoError(f"resume: expected '{path}', but {why}; leave out --resume or name its folder with --out")
    with path.open("rb") as file:
        try:
            saved = json.loads(file.readline())
        except ValueError as error:
            raise IdRgbdoError(f"resume: '{path}' is no checkpoint ({error}); run without --resume") from error
        difference = identity.difference(saved)
        if difference:
            raise IdRgbdoError(
                f"resume: the run in '{folder}' has another {difference}; repeat its flags or start anew"
            )
        try:
            state = pickle.load(file)
        except (pickle.UnpicklingError, EOFError, AttributeError, ImportError) as error:
            raise IdRgbdoError(f"resume: '{path}' cannot be read ({error}); run without --resume") from error
    if not isinstance(state, State):
        raise IdRgbdoError(f"resume: '{path}' holds a {type(state).__name__}, no state; run without --resume")
    return state
