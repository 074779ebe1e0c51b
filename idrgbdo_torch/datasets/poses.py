"""Reference poses as the formats write them: matrices in text."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray

from ..errors import IdRgbdoError
from ..text.files import damage_named, read_text
from ..trajectory import Trajectory

Matrix = NDArray[np.float64]
T = TypeVar("T")
NO_POSES: Matrix = np.zeros((0, 4, 4))
FARTHEST_M = 1e9  # from the origin; a number beyond is no position


def matrices(path: Path, columns: int = 4) -> Matrix:
    """(N, 4, 4) of a text file of numbers, 16 (or 12) a pose however they are broken into lines.

    columns: 4 for whole matrices, 3 for their upper three rows. Raises IdRgbdoError for anything else.
    """
    count = 4 * columns
    numbers = _numbers(path, f"{count} numbers a pose")
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
    numbers = _numbers(path, expected.removeprefix("expected "))
    if len(numbers) == 0 or len(numbers) % 19:
        raise IdRgbdoError(f"{path}: {expected}, got {len(numbers)} numbers; correct the file")
    rows = numbers.reshape(-1, 19)
    if not (np.abs(rows[:, :3]) < 1e15).all():
        raise IdRgbdoError(f"{path}: {expected}, got other numbers for i; correct the file")
    frames = rows[:, 2].astype(int) - 1
    if len(set(frames.tolist())) < len(rows):
        frames = np.arange(len(rows))
    return dict(zip(frames.tolist(), rows[:, 3:].reshape(-1, 4, 4), strict=True))


def _numbers(path: Path, expected: str) -> Matrix:
    """(N,) all numbers of a text file. Raises IdRgbdoError, naming the line, for a word that is none."""
    lines = read_text(path, "poses", f"expected {expected}").splitlines()
    with damage_named(str(path), expected, "correct the file"):
        try:
            return np.array([field for line in lines for field in line.split()], dtype=np.float64)
        except ValueError:
            for number, line in enumerate(lines, start=1):
                with damage_named(f"{path}, line {number}", expected, "correct the line"):
                    np.array(line.split(), dtype=np.float64)
            raise


def usable(read: Callable[[Path], T], path: Path, nothing: T) -> tuple[T, tuple[str, ...]]:
    """What `read` makes of a file with reference poses, and a sentence where it cannot: that costs the reference only.

    nothing: what is given then, and where there is no such file.
    """
    if not os.path.lexists(path):
        return nothing, ()
    try:
        return read(path), ()
    except IdRgbdoError as error:
        return nothing, (f"no ground truth: {error}",)


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

    Poses that are marked as unknown (not finite), and what is no rigid motion at all, are left out.
    """
    known = [number for number in sorted(times) if number in poses and is_pose(poses[number])]
    if not known:
        return None
    stamps = torch.tensor([times[number] for number in known], dtype=torch.float64)
    return Trajectory(stamps, torch.from_numpy(np.stack([poses[number] for number in known])))


def is_pose(T_world_cam: Matrix) -> bool:
    """Whether a (4, 4) matrix is finite and near a rigid motion."""
    return bool((np.abs(T_world_cam) < FARTHEST_M).all()) and bool(np.abs(T_world_cam[:3, :3]).max() < 2)


def pose_files(
    files: Sequence[tuple[int, Path]], read: Callable[[Path], Matrix] = lambda path: matrices(path)[0]
) -> tuple[dict[int, Matrix], tuple[str, ...]]:
    """T_world_cam by frame number of files with one pose each, and a sentence where some cannot be read.

    Missing files are left out.
    """
    poses, unread = {}, []
    for number, path in files:
        if os.path.lexists(path):
            try:
                poses[number] = read(path)
            except IdRgbdoError as error:
                unread.append(str(error))
    if not unread:
        return poses, ()
    return poses, (f"{len(unread)} poses cannot be read, so that their frames have no reference; {unread[0]}",)
