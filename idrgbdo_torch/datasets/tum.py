"""The layout of the TUM RGB-D benchmark, also of Bonn and ETH3D: rgb.txt, depth.txt, groundtruth.txt, image files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..errors import IdRgbdoError
from ..text.files import is_named
from ..trajectory import read_tum
from .calibration import find_calibration
from .lists import read_list, read_pairs
from .pairing import missing_files, pair_by_time, reader, unpaired_warning
from .poses import usable
from .published import camera_by_name
from .recording import Options, Recording

DEPTH_SCALE = 5000.0  # depth values per metre, TUM's
ALIGNED_DEPTH_SCALE = 1000.0  # OpenLORIS's, which is a RealSense's
COLOR_LISTS = ("rgb.txt", "color.txt")
DEPTH_LISTS = ("aligned_depth.txt", "depth.txt")  # depth that is registered to colour first


@dataclass(frozen=True)
class Listed:
    """The frames that lists tell."""

    frames: list[tuple[float, Path, Path]]  # s, colour, depth
    unit: str  # of the times as they are written
    warnings: tuple[str, ...]

    @property
    def said(self) -> str:
        """The unit, where it is not the usual one, as the end of a title."""
        return "" if self.unit == "seconds" else f", times in {self.unit}"


def recognise(path: Path) -> bool:
    """Whether one of the lists is there."""
    return any(is_named(path / name) for name in (*COLOR_LISTS, *DEPTH_LISTS, "associations.txt"))


def read(folder: Path, options: Options) -> Recording:
    """Find the pairs, the camera and the reference. Raises IdRgbdoError for a folder that is not such a sequence."""
    associations = options.associations
    if associations is None and _list(folder, COLOR_LISTS) is None and is_named(folder / "associations.txt"):
        associations = folder / "associations.txt"
    listed = read_associations(associations) if associations else _find_pairs(folder, options.association_limit_s)
    truth, unread = usable(read_tum, folder / "groundtruth.txt", None)
    aligned = associations is None and is_named(folder / DEPTH_LISTS[0])
    return Recording(
        name=folder.resolve().name,
        title=f"TUM RGB-D layout{listed.said}{', aligned_depth.txt' if aligned else ''}",
        timestamps=[time for time, _, _ in listed.frames],
        read=reader([(color, depth) for _, color, depth in listed.frames]),
        calibration=find_calibration(folder, options.camera, camera_by_name(folder)),
        depth_scale=ALIGNED_DEPTH_SCALE if aligned else DEPTH_SCALE,
        groundtruth=truth,
        warnings=(*listed.warnings, *missing_files([(color, depth) for _, color, depth in listed.frames]), *unread),
    )


def read_associations(path: Path) -> Listed:
    """The lines `timestamp file timestamp file` (files beside the list), colour first or, as some write it, depth."""
    color, depth = read_pairs(path)
    folders = [(a.parent.name, b.parent.name) for (_, a), (_, b) in zip(color.entries, depth.entries, strict=True)]
    if all(a == "depth" and b != "depth" for a, b in folders):
        color, depth = depth, color
    partner: dict[float, Path] = {}
    for (time, _), (_, file) in zip(color.entries, depth.entries, strict=True):
        partner.setdefault(time, file)
    entries, warnings = color.by_time()
    return Listed([(time, file, partner[time]) for time, file in entries], color.unit, warnings)


def _find_pairs(folder: Path, limit_s: float) -> Listed:
    """Colour and depth of each frame, paired by time from the two lists."""
    color_list, depth_list = _list(folder, COLOR_LISTS), _list(folder, DEPTH_LISTS)
    if color_list is None or depth_list is None:
        missing, there = ("rgb.txt", depth_list) if color_list is None else ("depth.txt", color_list)
        raise IdRgbdoError(
            f"sequence: expected the TUM layout, but '{folder}' has no {missing}; write it, lines `timestamp file`, or "
            f"remove {there.name if there else 'the other list'} to have the images paired by their names"
        )
    lists = read_list(color_list), read_list(depth_list)
    (color, of_color), (depth, of_depth) = (listed.by_time() for listed in lists)
    frames = pair_by_time(color, depth, limit_s, folder)
    unpaired = unpaired_warning(color, depth, len(frames), limit_s)
    return Listed(frames, lists[0].unit, (*of_color, *of_depth, *unpaired))


def _list(folder: Path, names: tuple[str, ...]) -> Path | None:
    return next((folder / name for name in names if is_named(folder / name)), None)
