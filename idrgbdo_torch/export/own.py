"""The folder of an export: made, or one that an export of the same kind made before, so that no other's files go."""

from __future__ import annotations

from pathlib import Path

from ..errors import IdRgbdoError
from ..runs.own import refuse_any

MARK = ".idrgbdo_export"  # a file with the kinds of the exports in its folder, a line each
MODEL = ("images/*", "sparse/*")
WRITTEN = {
    "nerfstudio": ("transforms.json", "sparse_pc.ply", "images/*", "depth/*"),
    "colmap": (*MODEL, "depth/*"),
    "gsplat": MODEL,
    "ply": ("points.ply", "cameras.ply"),
    "evo": ("estimate.tum", "reference.tum"),
    "kitti": ("poses.txt", "times.txt"),
}


def make_folder(folder: Path, kind: str, ours: bool = False) -> None:
    """Make the folder of an export, and mark it as such.

    ours: it has a place of its own in a run's folder. Raises IdRgbdoError where it cannot be made, or has files that
    an export of this kind would replace and none wrote.
    """
    mark = folder / MARK
    try:
        folder.mkdir(parents=True, exist_ok=True)
        kinds = mark.read_text(encoding="utf-8").splitlines() if mark.is_file() else []
        if any(set(WRITTEN[kind]) <= set(WRITTEN.get(earlier, ())) for earlier in kinds):
            return
        if not ours:
            refuse_any(folder, [path for pattern in WRITTEN[kind] for path in folder.glob(pattern)], "export")
        mark.write_text("\n".join([*kinds, kind]) + "\n", encoding="utf-8")
    except OSError as error:
        raise IdRgbdoError(f"out: cannot make '{folder}': {error.strerror}; pass another --out") from error
