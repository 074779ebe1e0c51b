"""One method on one sequence with one seed: what is remembered, and when it counts as done."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from ..errors import IdRgbdoError
from ..runs.writing import write_whole
from ..text.files import MOST_TEXT, plain_bytes, plain_descriptor, read_json
from .methods import Kind, Method

EXTERNAL = "external"  # the kind of a trajectory that another program wrote
RESULTS = "results.jsonl"
STAMP = "outcome.json"  # in a run's folder: the key of its outcome


@dataclass(frozen=True)
class Outcome:
    """A line of results.jsonl. None stands for what could not be measured."""

    method: str
    sequence: str
    seed: int
    configuration: str  # digest of the method's settings and of the sequence's frames
    versions: Mapping[str, str]
    description: str = ""
    kind: Kind | str = "baseline"
    error: str = ""  # why there is nothing else: the method broke
    frames: int = 0
    tracked: int = 0
    weak: int = 0  # of the tracked ones
    lost: int = 0
    breaks: int = 0  # times that the track was lost and went on later,
    found_again: int = 0  # and of them, where it had been
    reasons: Mapping[str, int] = field(default_factory=dict)  # why frames were lost, and how many
    keyframes: int = 0
    ate_rmse_m: float | None = None
    rpe_rmse_m_per_s: float | None = None
    rpe_rmse_deg_per_s: float | None = None
    rpe_pairs: int = 0  # of poses a second apart that the RPE is made of
    matched_poses: int = 0  # with a reference pose: what the ATE is made of
    k2fe_mean_m: float | None = None  # where the method has keyframes
    track_ms_median: float | None = None
    track_ms_p95: float | None = None
    decode_ms_median: float | None = None
    peak_memory_mb: float | None = None  # of a process that does nothing else, libraries included
    date: str = ""
    machine: str = ""
    folder: str = ""  # of the run, relative to the comparison's

    @property
    def key(self) -> tuple[str, ...]:
        """What makes a second run of the same kind superfluous."""
        versions = json.dumps(dict(self.versions), sort_keys=True)
        return (self.method, self.sequence, str(self.seed), self.configuration, versions)


def read_outcomes(folder: Path) -> dict[tuple[str, ...], Outcome]:
    """All outcomes by key, the last of equal ones. A line that a killed process left half written is no outcome."""
    path = folder / RESULTS
    if not path.exists():
        return {}
    known = {item.name for item in fields(Outcome)}
    outcomes = {}
    try:
        lines = plain_bytes(path, MOST_TEXT).decode("utf-8", errors="replace").splitlines()
    except OSError as error:
        raise IdRgbdoError(f"out: cannot read '{path}': {error.strerror}; pass another --out") from error
    for line in lines:
        try:
            data = json.loads(line)
            outcome = Outcome(**{name: value for name, value in data.items() if name in known})
            outcomes[outcome.key] = outcome
        except (ValueError, TypeError, AttributeError, RecursionError):
            continue
    return outcomes


def stamp(folder: Path, outcome: Outcome) -> None:
    """Write into a run's folder whose it is: runs of other frames or settings have the same folder's name."""
    write_whole(folder / STAMP, json.dumps(outcome.key) + "\n", make_folder=True)


def stamped(folder: Path, outcome: Outcome) -> bool:
    """Whether the run in a folder is that of the outcome, and not a later one of other frames or settings."""
    try:
        return bool(read_json(folder / STAMP) == list(outcome.key))
    except IdRgbdoError:
        return False


def append_outcome(folder: Path, outcome: Outcome) -> None:
    """Add a line, on the disk when this returns. Raises IdRgbdoError where the folder cannot be written."""
    path = folder / RESULTS
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with os.fdopen(plain_descriptor(path, os.O_RDWR | os.O_CREAT | os.O_APPEND), "r+b") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - 1))
            torn = file.read(1) not in (b"", b"\n")
            file.write((("\n" if torn else "") + json.dumps(asdict(outcome)) + "\n").encode())
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise IdRgbdoError(f"out: cannot write '{path}': {error.strerror}; pass another --out") from error


def versions_of(libraries: tuple[str, ...]) -> dict[str, str]:
    """The installed versions of this package and of the named distributions; "none" where one is missing."""
    versions = {}
    for name in ("idrgbdo_torch", *libraries):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "none"
    return versions


def configuration_digest(method: Method, frames: str) -> str:
    """A short digest of the method's settings and of what tells the frames apart."""
    return hashlib.sha256(f"{method.settings()}\n{frames}".encode()).hexdigest()[:12]
