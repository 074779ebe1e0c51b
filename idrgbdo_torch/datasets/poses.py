"""Reference poses as the formats write them: matrices in text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from ..errors import IdRgbdoError
from ..text.files import read_text
from ..trajectory import Trajectory

Matrix = NDArray[np.float64]


def matrices(path: Path, columns: int = 4) -> Matrix:
    """(N, 4, 4) of a text file of numbers, 16 (or 12) a pose however they are broken into lines.

    columns: 4 for whole matrices, 3 for their upper three rows. Raises IdRgbdoError for anything else.
    """
    count = 4 * columns
    try:
        numbers = np.array(read_text(path).split(), dtype=np.float64)
    except (OSError, ValueError) as error:
        raise IdRgbdoError(f"{path}: cannot read the poses ({error}); expected {count} numbers a pose") from error
    if len(numbers) == 0 or len(numbers) % count:
        raise IdRgbdoError(f"{path}: expected {count} numbers a pose, got {len(numbers)} numbers; correct the file")
    poses = np.tile(np.eye(4), (len(numbers) // count, 1, 1))
    poses[:, :columns] = numbers.reshape(-1, columns, 4)
    return poses


def log_poses(path: Path) -> dict[int, Matrix]:
    """Poses by frame number of a trajectory.log as Open3D writes it: a line of three numbers, then the matrix.

    The third of the three is the frame's number plus one, or 0 where nobody counted; then frames are counted here.
    Raises IdRgbdoError for another format.
    """
    expected = "expected five lines a pose: `i i i+1`, then the 4x4 matrix"
    try:
        numbers = np.array(read_text(path).split(), dtype=np.float64)
    except (OSError, ValueError) as error:
        raise IdRgbdoError(f"{path}: cannot read the poses ({error}); {expected}") from error
    if len(numbers) == 0 or len(numbers) % 19:
        raise IdRgbdoError(f"{path}: {expected}, got {len(numbers)} numbers; correct the file")
    rows = numbers.reshape(-1, 19)
    frames = rows[:, 2].astype(int) - 1
    if len(set(frames.tolist())) < len(rows):
        frames = np.arange(len(rows))
    return dict(zip(frames.tolist(), rows[:, 3:].reshape(-1, 4, 4), strict=True))


def by_frame(
    poses: Mapping[int, Matrix], frames: Sequence[int], images: Sequence[int]
) -> tuple[dict[int, Matrix], tuple[str, ...]]:
    """The poses of a log by the numbers in the files' names, and a sentence where that had to be guessed.

    poses: by the log's own numbers. frames: numbers of the frames, images: those of all images, also of those without
    partner; both increasing. Logs count from 0, files from anywhere, and files may be missing: the poses belong to
    the numbers, shifted so that all images have a pose and the last one the log's last. A log that is too short for
    the numbers has a pose for each image, or for each frame, in their order.
    """
    if not poses or not images:
        return {}, ()
    first, last = min(poses), max(poses)
    shifts = [0, 1, *(shift for shift in (images[0] - first, images[-1] - last) if shift > 1)]
    fit = [shift for shift in shifts if images[0] - shift >= first and images[-1] - shift <= last]
    counts = f"the trajectory has {len(poses)} poses, numbers {first} to {last}; the images' go from {images[0]} to "
    if fit:
        ends = [shift for shift in fit if images[-1] - shift == last]
        from_one = [1] if images[0] - first == 1 and 1 in fit else []
        shift = (ends or from_one or fit)[0]
        unsure = bool(ends and from_one and ends != from_one)
        said = (f"{counts}{images[-1]}, and pose {first} is taken for number {first}, not for 1",) if unsure else ()
        return {number: poses[number - shift] for number in frames if number - shift in poses}, said
    ordered = [poses[number] for number in sorted(poses)]
    for numbers, kind in ((images, "image"), (frames, "frame")):
        if len(numbers) == len(ordered):
            said = (f"{counts}{images[-1]}, and the poses are taken for those of each {kind}, in their order",)
            of_number = dict(zip(numbers, ordered, strict=True))
            return {number: of_number[number] for number in frames}, said
    shift = images[0] - first
    said = (f"{counts}{images[-1]}, and the first pose is taken for the first image; later ones have no reference",)
    return {number: poses[number - shift] for number in frames if number - shift in poses}, said


def reference(times: Mapping[int, float], poses: Mapping[int, Matrix]) -> Trajectory | None:
    """The poses (T_world_cam by frame number) of the frames that have a time (s); None where there is none.

    Poses that are marked as unknown (not finite) are left out.
    """
    known = [number for number in sorted(times) if number in poses and bool(np.isfinite(poses[number]).all())]
    if not known:
        return None
    stamps = torch.tensor([times[number] for number in known], dtype=torch.float64)
    return Trajectory(stamps, torch.from_numpy(np.stack([poses[number] for number in known])))


def pose_files(files: Sequence[tuple[int, Path]]) -> dict[int, Matrix]:
    """T_world_cam by frame number of files with one matrix each; missing files are left out."""
    return {number: matrices(path)[0] for number, path in files if path.exists()}
