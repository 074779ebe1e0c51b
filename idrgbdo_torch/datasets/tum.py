"""Sequences in the layout of the TUM RGB-D benchmark: rgb.txt, depth.txt, an optional groundtruth.txt, image files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from ..camera import Pinhole
from ..errors import IdRgbdoError
from ..frame import BrokenFrame, RgbdFrame
from ..trajectory import Trajectory, associate, nearest, read_tum
from .calibration import Undistortion, find_calibration
from .images import read_color, read_depth

DEPTH_SCALE = 5000.0  # depth values per metre, TUM's
USUAL_DEPTH_SCALES = (5000.0, 1000.0)
PLAUSIBLE_MEDIAN_M = (0.5, 4.5)  # of what a hand-held depth camera looks at
SATURATED = 65535  # some cameras write it for "no depth"

Entry = tuple[float, Path]  # s, image file


class TumSequence:
    """A recorded sequence. Images are read when their turn comes, so memory does not grow with its length."""

    def __init__(
        self,
        folder: Path,
        *,
        camera: Path | None = None,
        associations: Path | None = None,
        depth_scale: float | None = None,
        association_limit_s: float = 0.02,
        start: int = 0,
        every: int = 1,
        max_frames: int | None = None,
    ) -> None:
        """Find the pairs, the camera and the reference, and read the first pair, which tells the image size.

        camera: TOML with the intrinsics, see find_calibration. depth_scale: depth values per metre, by default what
        that file says, else 5000. associations: a list `timestamp colour timestamp depth` instead of pairing by time.
        start, every, max_frames: leave out the first frames, take each n-th of the others, stop after so many.
        Raises IdRgbdoError for a folder that is not such a sequence.
        """
        if not folder.is_dir():
            what = "a file" if folder.exists() else "nothing"
            raise IdRgbdoError(f"sequence: expected a folder at '{folder}', found {what}; check the path")
        for name, value, least in (("start", start, 0), ("every", every, 1), ("max_frames", max_frames, 1)):
            if value is not None and value < least:
                raise IdRgbdoError(f"{name}: expected at least {least}, got {value}; change it")
        calibration = find_calibration(folder, camera)
        self.name = folder.resolve().name
        self.depth_scale = depth_scale or calibration.depth_scale or DEPTH_SCALE
        if depth_scale is not None and not depth_scale > 0:
            raise IdRgbdoError(f"depth_scale: expected depth values per metre, above 0, got {depth_scale}; change it")
        pairs = _read_associations(associations) if associations else _find_pairs(folder, association_limit_s)
        self._pairs = pairs[start::every][:max_frames]
        if not self._pairs:
            raise IdRgbdoError(f"start: expected less than the sequence's {len(pairs)} frames, got {start}; lower it")
        self.timestamps = [time for (time, _), _ in self._pairs]  # s, of the colour images
        color, depth = _read_pair(*self._pairs[0])
        self.camera: Pinhole = calibration.pinhole(color.shape[1], color.shape[0])
        self._undistortion = Undistortion(calibration, self.camera) if any(calibration.distortion) else None
        reference = folder / "groundtruth.txt"
        self.groundtruth: Trajectory | None = read_tum(reference) if reference.exists() else None
        self.warnings = _depth_warnings(depth, self.depth_scale)

    def __len__(self) -> int:
        return len(self._pairs)

    def __iter__(self) -> Iterator[RgbdFrame | BrokenFrame]:
        return (self.read(index) for index in range(len(self)))

    def read(self, index: int) -> RgbdFrame | BrokenFrame:
        """Frame number `index`; a BrokenFrame with the reason where a file is missing, damaged or of another size."""
        timestamp = self.timestamps[index]
        try:
            color, depth = _read_pair(*self._pairs[index])
        except IdRgbdoError as error:
            return BrokenFrame(timestamp, str(error))
        size = (self.camera.height, self.camera.width)
        if depth.shape != size:
            return BrokenFrame(timestamp, f"image of shape {depth.shape}, where the first has {size}")
        if self._undistortion is not None:
            color, depth = self._undistortion.color(color), self._undistortion.depth(depth)
        gray = cv2.cvtColor(color.astype(np.float32), cv2.COLOR_BGR2GRAY)  # ITU-R BT.601
        depth_m = np.where(depth == SATURATED, np.float32(0), depth / np.float32(self.depth_scale))
        return RgbdFrame(
            timestamp=timestamp,
            gray=torch.from_numpy(gray),  # (H, W)
            depth=torch.from_numpy(depth_m),  # (H, W) m
            camera=self.camera,
            color=torch.from_numpy(cv2.cvtColor(color, cv2.COLOR_BGR2RGB)),  # (H, W, 3)
        )


def _read_pair(color: Entry, depth: Entry) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
    """(H, W, 3) colour and (H, W) raw depth of one frame. Raises IdRgbdoError where they differ in size."""
    color_image, depth_image = read_color(color[1]), read_depth(depth[1])
    if color_image.shape[:2] != depth_image.shape:
        (height, width), (depth_height, depth_width) = color_image.shape[:2], depth_image.shape
        raise IdRgbdoError(
            f"{depth[1]}: expected depth of the colour image's size {width}x{height}, got {depth_width}x{depth_height}"
            "; register the depth to the colour camera"
        )
    return color_image, depth_image


def _find_pairs(folder: Path, limit_s: float) -> list[tuple[Entry, Entry]]:
    """Colour and depth of each frame, paired by time from rgb.txt and depth.txt."""
    color_list, depth_list = folder / "rgb.txt", folder / "depth.txt"
    for path in (color_list, depth_list):
        if not path.exists():
            ready = folder / "associations.txt"
            advice = f"pass --associations '{ready}'" if ready.exists() else "write it, lines `timestamp file`"
            raise IdRgbdoError(f"sequence: expected the TUM layout, but '{folder}' has no {path.name}; {advice}")
    color, depth = _read_list(color_list), _read_list(depth_list)
    color_times, depth_times = (torch.tensor([time for time, _ in x], dtype=torch.float64) for x in (color, depth))
    of_color, of_depth = associate(color_times, depth_times, limit_s)
    if len(of_color) == 0:
        gaps = (depth_times[nearest(depth_times, color_times)] - color_times).abs()
        raise IdRgbdoError(
            f"sequence: no colour and depth image of '{folder}' are within {limit_s:g} s of each other, the closest "
            f"two are {float(gaps.min()):.3f} s apart; check the two clocks or raise --association-limit"
        )
    return [(color[i], depth[j]) for i, j in zip(of_color.tolist(), of_depth.tolist(), strict=True)]


def _read_list(path: Path) -> list[Entry]:
    """The lines `timestamp file`, by time."""
    entries = [_entry(path, number, fields) for number, fields in _lines(path, 2)]
    return sorted(dict(entries).items())


def _read_associations(path: Path) -> list[tuple[Entry, Entry]]:
    """The lines `timestamp file timestamp file` (files beside the list), colour first or, as some write it, depth."""
    pairs = [(_entry(path, n, fields[:2]), _entry(path, n, fields[2:])) for n, fields in _lines(path, 4)]
    if all(first.parent.name == "depth" and second.parent.name != "depth" for (_, first), (_, second) in pairs):
        pairs = [(color, depth) for depth, color in pairs]
    by_time = {color[0]: (color, depth) for color, depth in pairs}
    return [by_time[time] for time in sorted(by_time)]


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


def _depth_warnings(depth: NDArray[np.uint16], depth_scale: float) -> list[str]:
    """A sentence for the user where the first frame's depth cannot be right."""
    valid = depth[(depth > 0) & (depth < SATURATED)]
    if len(valid) == 0:
        return ["the first frame has no valid depth at all; check that the depth images are the right ones"]
    median = float(np.median(valid))
    low, high = PLAUSIBLE_MEDIAN_M
    if low <= median / depth_scale <= high:
        return []
    likely = [f"{scale:g}" for scale in USUAL_DEPTH_SCALES if low <= median / scale <= high]
    hint = f"--depth-scale {likely[0]} is likely right" if likely else "pass the right --depth-scale"
    return [f"depth scale {depth_scale:g} makes the first frame's median depth {median / depth_scale:.3g} m; {hint}"]
