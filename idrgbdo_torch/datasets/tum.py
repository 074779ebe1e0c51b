"""The layout of the TUM RGB-D benchmark, also of Bonn and ETH3D: rgb.txt, depth.txt, groundtruth.txt, image files."""

from __future__ import annotations

from pathlib import Path

from ..errors import IdRgbdoError
from ..trajectory import read_tum
from .calibration import find_calibration
from .pairing import pair_by_time, reader
from .recording import Options, Recording

DEPTH_SCALE = 5000.0  # depth values per metre, TUM's

Entry = tuple[float, Path]  # s, image file


def recognise(path: Path) -> bool:
    """Whether one of the lists is there."""
    return any((path / name).is_file() for name in ("rgb.txt", "depth.txt", "associations.txt"))


def read(folder: Path, options: Options) -> Recording:
    """Find the pairs, the camera and the reference. Raises IdRgbdoError for a folder that is not such a sequence."""
    listed = options.associations
    if listed is None and not (folder / "rgb.txt").exists() and (folder / "associations.txt").exists():
        listed = folder / "associations.txt"
    frames = read_associations(listed) if listed else _find_pairs(folder, options.association_limit_s)
    truth = folder / "groundtruth.txt"
    return Recording(
        name=folder.resolve().name,
        title="TUM RGB-D layout",
        timestamps=[time for time, _, _ in frames],
        read=reader([(color, depth) for _, color, depth in frames]),
        calibration=find_calibration(folder, options.camera),
        depth_scale=DEPTH_SCALE,
        groundtruth=read_tum(truth) if truth.exists() else None,
    )


def read_associations(path: Path) -> list[tuple[float, Path, Path]]:
    """The lines `timestamp file timestamp file` (files beside the list), colour first or, as some write it, depth."""
    pairs = [(_entry(path, n, fields[:2]), _entry(path, n, fields[2:])) for n, fields in _lines(path, 4)]
    if all(first.parent.name == "depth" and second.parent.name != "depth" for (_, first), (_, second) in pairs):
        pairs = [(color, depth) for depth, color in pairs]
    by_time = {time: (time, color, depth) for (time, color), (_, depth) in pairs}
    return [by_time[time] for time in sorted(by_time)]


def _find_pairs(folder: Path, limit_s: float) -> list[tuple[float, Path, Path]]:
    """Colour and depth of each frame, paired by time from rgb.txt and depth.txt."""
    color_list, depth_list = folder / "rgb.txt", folder / "depth.txt"
    for path in (color_list, depth_list):
        if not path.exists():
            raise IdRgbdoError(
                f"sequence: expected the TUM layout, but '{folder}' has no {path.name}; write it, lines "
                "`timestamp file`, or remove the other list to have the images paired by their names"
            )
    return pair_by_time(_read_list(color_list), _read_list(depth_list), limit_s, folder)


def _read_list(path: Path) -> list[Entry]:
    """The lines `timestamp file`, by time."""
    entries = [_entry(path, number, fields) for number, fields in _lines(path, 2)]
    return sorted(dict(entries).items())


def _lines(path: Path, columns: int) -> list[tuple[int, list[str]]]:
    """Line numbers and fields of a list file without comments. Raises IdRgbdoError for other columns, or no line."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise IdRgbdoError(f"sequence: cannot read '{path}': {error}; expected a text file") from error
    split = [(number, line.split()) for number, line in enumerate(text.splitlines(), start=1)]
    lines = [(number, fields) for number, fields in split if fields and not fields[0].startswith("#")]
    for number, fields in lines:
        if len(fields) != columns:
            expected = " ".join(["timestamp file"] * (columns // 2))
            raise IdRgbdoError(
                f"{path}, line {number}: expected `{expected}`, got {len(fields)} fields; correct the line"
            )
    if not lines:
        raise IdRgbdoError(f"sequence: '{path}' lists no image; expected lines `timestamp file`")
    return lines


def _entry(path: Path, number: int, fields: list[str]) -> Entry:
    try:
        time = float(fields[0])
    except ValueError as error:
        raise IdRgbdoError(
            f"{path}, line {number}: expected a timestamp, got '{fields[0]}'; correct the line"
        ) from error
    return time, path.parent / fields[1]
