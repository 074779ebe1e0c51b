"""The map's points, and where the keyframes show them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..definitions.camera import Pinhole
from ..errors import IdRgbdoError
from ..frame import BrokenFrame
from ..runs.folder import map_name
from ..text.files import plain_bytes
from ..tracker.mapping import Cloud
from .images import gray8
from .tracked import Read, TrackedRun

Array = NDArray[np.float64]
Index = NDArray[np.int64]
View = tuple[NDArray[np.uint8], NDArray[np.float32]]  # gray and depth (m)

NEIGHBOURS = 8  # keyframes before and after the one that has a point, in which it is looked for
WINDOW = 15  # px, side of the patch that is found again
MARGIN = 8  # px inside the image
SAME_SURFACE = 0.03  # relative difference in depth up to which a point is not hidden
BACK = 0.25  # px by which finding it there and back again may miss
NEAR = 4.0  # px between where it is found and where the poses put it; farther is another place
CORNER = 1e-3  # least eigenvalue of a patch's gradients, in OpenCV's measure: along an edge a patch slides
DTYPES = {"float": "<f4", "uchar": "u1", "double": "<f8"}


MOST_MAP = 4 << 30  # bytes


@dataclass(frozen=True)
class Observations:
    """Where points were seen. Each array has one entry an observation, ordered by point."""

    point: Index  # (M,) among the points
    frame: Index  # (M,) number of the frame
    uv: Array  # (M, 2) px; (0, 0) is the centre of the top-left pixel


def read_map(folder: Path, segment: int) -> Cloud:
    """The points of a run's map with the keyframes that have them. Raises IdRgbdoError where there are none."""
    path = folder / map_name(segment)
    try:
        head, _, body = plain_bytes(path, MOST_MAP).partition(b"end_header\n")
        lines = [line.split() for line in head.decode("ascii").splitlines()]
        layout = [(line[2], DTYPES[line[1]]) for line in lines if line[0] == "property"]
        count = next(int(line[2]) for line in lines if line[:2] == ["element", "vertex"])
        values = np.frombuffer(body, np.dtype(layout), count)
        xyz, rgb, normal, origin = (
            np.column_stack([values[name] for name in names])
            for names in (("x", "y", "z"), ("red", "green", "blue"), ("nx", "ny", "nz"), ("time", "u", "v"))
        )
    except OSError as error:
        raise IdRgbdoError(f"run: cannot read '{path}': {error.strerror}; run again with --map points") from error
    except (ValueError, KeyError, IndexError, StopIteration) as error:
        raise IdRgbdoError(f"run: '{path}' does not say where its points were seen ({error}); run again") from error
    return Cloud(xyz, rgb, normal, origin.astype(np.float64))


def of_frames(run: TrackedRun, cloud: Cloud, frames: Sequence[int]) -> tuple[Cloud, Index]:
    """The points whose keyframes are among the frames, or that were merged of several; and numbers of those frames.

    The number is -1 for a merged point, which no single frame has.
    """
    origin = cloud.origins()
    frame = np.full(len(cloud), -1, np.int64)
    known = ~np.isnan(origin[:, 0])
    frame[known] = run.frames_at(origin[known, 0])
    keep = np.isin(frame, frames) | ~known
    return Cloud(cloud.xyz[keep], cloud.rgb[keep], cloud.normal[keep], origin[keep]), frame[keep]


def project(camera: Pinhole, xyz: Array, T_world_cam: Array) -> tuple[Array, Array]:
    """Where a camera shows points (N, 3) of the world: px (N, 2), and their depths (N,) m; nan px behind it."""
    P = (xyz - T_world_cam[:3, 3]) @ T_world_cam[:3, :3]
    z = np.where(P[:, 2] > 0, P[:, 2], np.nan)
    return np.column_stack([camera.fx * P[:, 0] / z + camera.cx, camera.fy * P[:, 1] / z + camera.cy]), P[:, 2]


def observe(run: TrackedRun, cloud: Cloud, host: Index, camera: Pinhole, read: Read) -> Observations:
    """Look for every point in the keyframes around the one that has it, by its patch.

    host: (N,) number of the frame that has a point, -1 where none has. What is found is measured in the images, so that
    its distance from where the poses put it means something. A point that is found nowhere else has no observation.
    """

    @lru_cache(maxsize=2 * NEIGHBOURS + 2)
    def view(number: int) -> View | None:
        frame = read(number)
        return None if isinstance(frame, BrokenFrame) else (gray8(frame), frame.depth.numpy())

    hosts = np.unique(host[host >= 0]).tolist()
    xyz, pixel = cloud.xyz.astype(np.float64), cloud.origins()[:, 1:].astype(np.float32)
    found: list[tuple[Index, int, Array]] = []
    for place, number in enumerate(hosts):
        mine, image = np.flatnonzero(host == number), view(number)
        seen = np.zeros(len(mine), np.bool_)
        for other in hosts[max(place - NEIGHBOURS, 0) : place + NEIGHBOURS + 1]:
            target = view(other)
            if other == number or image is None or target is None:
                continue
            expected = project(camera, xyz[mine], run.T_world_cam[other])
            where, uv = find_again(image[0], target, pixel[mine], *expected)
            found.append((mine[where], other, uv))
            seen[where] = True
        found.append((mine[seen], number, pixel[mine[seen]].astype(np.float64)))
    point = np.concatenate([np.zeros(0, np.int64), *(points for points, _, _ in found)])
    frame = np.concatenate([np.zeros(0, np.int64), *(np.full(len(points), number) for points, number, _ in found)])
    uv = np.concatenate([np.zeros((0, 2)), *(uv for _, _, uv in found)])
    order = np.lexsort((frame, point))
    return Observations(point[order], frame[order], uv[order])


def find_again(
    image: NDArray[np.uint8], target: View, pixel: NDArray[np.float32], expected: Array, depth: Array
) -> tuple[Index, Array]:
    """Which points (K,) of an image are found in a target, and where: (K, 2) px.

    pixel: (N, 2) px of the points in the image; expected: (N, 2) px where the poses put them in the target, at depth
    (N,) m. The target's own depth there must agree; then the patch is followed from the expected place to where it fits
    best (Lucas and Kanade), and back.
    """
    gray, measured = target
    height, width = gray.shape
    inside = (expected >= MARGIN).all(axis=1) & (expected < [width - MARGIN, height - MARGIN]).all(axis=1)
    candidates = np.flatnonzero(inside)
    column, row = np.rint(expected[candidates]).astype(np.int64).T
    there = measured[row, column]
    candidates = candidates[(there > 0) & (np.abs(there - depth[candidates]) < SAME_SURFACE * depth[candidates])]
    if len(candidates) == 0:
        return candidates, np.zeros((0, 2))
    start, guess = pixel[candidates], expected[candidates].astype(np.float32)
    there, ahead = _follow(image, gray, start, guess)
    back, behind = _follow(gray, image, there, start)
    missed = np.linalg.norm(back - start, axis=1)
    off = np.linalg.norm(there - guess, axis=1)
    good = ahead & behind & (missed < BACK) & (off < NEAR)
    return candidates[good], there[good].astype(np.float64)


def _follow(
    image: NDArray[np.uint8], target: NDArray[np.uint8], uv: NDArray[np.float32], guess: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Where patches (N, 2) px of an image lie in a target, from a guess (N, 2) on; and whether (N,) they are there."""
    there, found, _ = cv2.calcOpticalFlowPyrLK(
        image, target, uv, guess.copy(), winSize=(WINDOW, WINDOW), maxLevel=1, flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        minEigThreshold=CORNER,
    )  # fmt: skip
    return there, found[:, 0] == 1
