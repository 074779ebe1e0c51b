"""All formats, and which of them a folder or file is in."""

from __future__ import annotations

import difflib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..errors import IdRgbdoError
from ..text.files import unreadable
from . import folder, icl_nuim, record3d, redwood, replica, ros, scannet, seven_scenes, stray_scanner, tum
from .calibration import EXAMPLE
from .recording import Options, Recording


@dataclass(frozen=True)
class Format:
    """How a kind of recording is told from others and read."""

    recognise: Callable[[Path], bool]
    read: Callable[[Path, Options], Recording]
    sign: str  # what it is recognised by
    files: bool = False  # a recording may be one file


# in the order in which they are tried: the peculiar ones first
FORMATS = {
    "ros": Format(ros.recognise, ros.read, "a .bag, .mcap or .db3 file, or a folder with metadata.yaml", files=True),
    "record3d": Format(record3d.recognise, record3d.read, "an .r3d file, or metadata beside rgbd/ or rgb/", files=True),
    "stray_scanner": Format(stray_scanner.recognise, stray_scanner.read, "rgb.mp4 and camera_matrix.csv"),
    "icl_nuim": Format(
        icl_nuim.recognise,
        icl_nuim.read,
        "scene_*.depth, or associations.txt with *.gt.freiburg or in a folder of its name",
    ),
    "tum": Format(tum.recognise, tum.read, "rgb.txt and depth.txt"),
    "7scenes": Format(seven_scenes.recognise, seven_scenes.read, "frame-*.color.png"),
    "scannet": Format(scannet.recognise, scannet.read, "intrinsic/intrinsic_color.txt"),
    "replica": Format(replica.recognise, replica.read, "results/frame*.jpg"),
    "redwood": Format(redwood.recognise, redwood.read, "color/, depth/ and an intrinsic matrix in JSON"),
    "folder": Format(folder.recognise, folder.read, "rgb/ and depth/"),
}


def read_recording(path: Path, options: Options, name: str | None = None) -> Recording:
    """The recording in a file or folder, of the named format or the one it looks like.

    Raises IdRgbdoError for an unknown name, a path where nothing is, or one that looks like no format.
    """
    if name is not None and name not in FORMATS:
        near = difflib.get_close_matches(name, FORMATS, n=1)
        hint = f"did you mean '{near[0]}'?" if near else f"the formats are {', '.join(FORMATS)}"
        raise IdRgbdoError(f"format: no format '{name}'; {hint}")
    if not os.path.exists(path):
        raise IdRgbdoError(f"sequence: expected a folder at '{path}', found nothing; check the path")
    if not (path.is_dir() or path.is_file()):
        raise IdRgbdoError(f"sequence: expected a folder at '{path}', found a pipe or a device; check the path")
    if name is None:
        name = "tum" if options.associations is not None else guess(path)
    if not FORMATS[name].files and not path.is_dir():
        raise IdRgbdoError(f"sequence: expected a folder at '{path}', found a file; check the path")
    try:
        return FORMATS[name].read(path, options)
    except OSError as error:  # of a folder that may not be listed, or is gone meanwhile
        raise unreadable(Path(error.filename or path), error, "sequence", "check its rights") from error


def guess(path: Path) -> str:
    """The name of the first format that recognises the path. Raises IdRgbdoError, saying what was looked for."""
    for name, known in FORMATS.items():
        if known.recognise(path):
            return name
    signs = "; ".join(f"{known.sign} ({name})" for name, known in FORMATS.items())
    raise IdRgbdoError(
        f"sequence: no known format in '{path}'; looked for {signs}. For images of your own, put colour into "
        f"'{path / 'rgb'}', 16-bit depth of the same names into '{path / 'depth'}', and write '{path / 'camera.toml'}' "
        f"with the lines {EXAMPLE}"
    )
