"""Trajectory files as people have them: their text, its dialects, and what to say about their timestamps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from ..errors import IdRgbdoError
from .clock import in_seconds, unit_of
from .files import read_text
from .plain import shown

EXPECTED = "`timestamp tx ty tz qx qy qz qw`"
FEWEST = 3  # poses that two runs have in common
FARTHEST_M = 1e9  # from the origin; a number beyond is no position
LATEST = 1e20  # seconds, or ticks of any clock


@dataclass(frozen=True)
class PoseRows:
    """The poses of a file by time, and what a user should know about how they were read."""

    times: list[float]  # (N,) s, increasing
    poses: list[list[float]]  # (N, 7) tx ty tz qx qy qz qw
    notes: tuple[str, ...]  # sentences


def read_rows(path: Path) -> PoseRows:
    """Read the lines `timestamp tx ty tz qx qy qz qw`; see trajectory.read_tum.

    Raises IdRgbdoError with file and line for what is no such line, and for two runs in one file.
    """
    lines = _lines(path)
    found = [
        (number, row)
        for number, line in lines
        if (row := _row(line, f"{path}, line {number}")) is not None
    ]  # fmt: skip
    if not found:
        raise IdRgbdoError(f"trajectory: '{path}' holds no pose; expected lines {EXPECTED}")
    stamps = [stamp for _, (stamp, _) in found]
    unit = unit_of(stamps)
    if unit is None:
        raise IdRgbdoError(
            f"trajectory: expected timestamps in '{path}' (seconds, or milli-, micro- or nanoseconds), got "
            f"{stamps[0]} and so on, one by one, which are numbers of poses; write their times instead"
        )
    rows = [(in_seconds(stamp, unit), pose) for _, (stamp, pose) in found]
    notes = [] if unit == "seconds" else [f"the timestamps of '{path.name}' are {unit} and are read as such"]
    if invalid := len(lines) - len(found):
        notes.append(f"{invalid} of the {len(lines)} poses of '{path.name}' are marked invalid and are left out")
    notes += _order([number for number, _ in found], rows, path)
    by_time = dict(rows)  # the last of equal times, as the TUM tools have it
    return PoseRows(sorted(by_time), [by_time[time] for time in sorted(by_time)], tuple(notes))


def _lines(path: Path) -> list[tuple[int, str]]:
    """The numbered lines without comments and without a heading."""
    text = read_text(path, "trajectory", "pass a text file in TUM format")
    lines = [(n, line) for n, line in enumerate(text.splitlines(), start=1) if line.strip(" \t,;")]
    lines = [(n, line) for n, line in lines if not line.lstrip().startswith("#")]
    return lines[1:] if lines and not any(_is_number(field) for field in _fields(lines[0][1])) else lines


def _fields(line: str) -> list[str]:
    """The fields of a line, parted by blanks, commas or semicolons; where there is no point a comma may be one."""
    parts = line.split(";") if ";" in line else line.split()
    if "." not in line and len(parts) == 8:
        return [part.strip().replace(",", ".") for part in parts]
    return line.replace(",", " ").replace(";", " ").split()


def _is_number(field: str) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return True


def _row(line: str, where: str) -> tuple[float, list[float]] | None:
    """Timestamp and pose of a line; None for a pose marked invalid. Whole timestamps keep all their digits."""
    fields = _fields(line)
    try:
        row = [float(field) for field in fields]
    except ValueError as error:
        raise IdRgbdoError(
            f"{where}: expected eight numbers, got '{shown(line.strip(), quoted=False)}'; correct the line"
        ) from error
    if len(row) != 8:
        raise IdRgbdoError(f"{where}: expected {EXPECTED}, got {len(row)} numbers; correct the line")
    if not abs(row[0]) < LATEST:
        raise IdRgbdoError(f"{where}: expected a timestamp, got {shown(fields[0], quoted=False)}; correct the line")
    length = math.hypot(*row[4:])
    if length == 0 or any(math.isnan(value) for value in row):
        return None
    if not all(abs(value) < FARTHEST_M for value in row[1:]) or abs(length - 1) > 0.05:
        raise IdRgbdoError(
            f"{where}: expected finite numbers and a unit quaternion, got length {length:.3g}; correct it"
        )
    return (int(fields[0]) if fields[0].isdecimal() else row[0]), row[1:]


def _order(numbers: list[int], rows: list[tuple[float, list[float]]], path: Path) -> list[str]:
    """Notes on times that repeat or run back. Raises IdRgbdoError for two different runs, one after the other."""
    times = [time for time, _ in rows]
    seen: dict[float, list[float]] = {}
    repeated, different = 0, 0
    for time, pose in rows:
        repeated += time in seen
        different += time in seen and seen[time] != pose
        seen[time] = pose
    starts = [k for k in range(1, len(times)) if times[k] < times[k - 1]]
    parts = [times[a:b] for a, b in zip([0, *starts], [*starts, len(times)], strict=True)]
    merely_repeated = repeated > 0 and different == 0
    if not merely_repeated and len(parts) <= max(3, len(times) // 10):  # else it is shuffled
        for before, after, start in zip(parts, parts[1:], starts, strict=False):
            common = sum(before[0] <= time <= before[-1] for time in after)
            if common >= FEWEST and len(before) >= FEWEST:
                raise IdRgbdoError(
                    f"trajectory: expected one run in '{path}', but at line {numbers[start]} the time goes back from "
                    f"{before[-1]:.3f} to {after[0]:.3f} s and {common} poses lie in times that were there before: "
                    "two runs in one file; split it there"
                )
    notes = []
    if repeated:
        which = "with the same pose" if merely_repeated else "with other poses; the last of each counts"
        notes.append(f"{repeated} of the timestamps of '{path.name}' repeat an earlier one, {which}")
    if starts:
        notes.append(f"the times of '{path.name}' go back {len(starts)} times; its poses are sorted by time")
    return notes
