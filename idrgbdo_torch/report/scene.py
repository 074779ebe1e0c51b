"""The numbers behind the scene of a report, packed for its script: poses, map, keyframes, points, images.

Everything is laid into the world of the run, turned so that z is up and the cameras look along y on average.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..definitions.camera import Pinhole
from ..definitions.se3 import inverse, transform
from ..errors import IdRgbdoError
from ..evaluation import absolute_error
from ..export.points import read_map
from ..tracker.mapping import NOTHING, Cloud
from ..trajectory import Trajectory
from .figures import rigid, upright
from .glimpses import BITS, MM, PX, Glimpse
from .pictures import information_colors

MOST_MAP = 30_000  # points of the map
MOST_PATH = 3000  # positions of a path that is only a line
OUTSIDE = 0.005  # share of the map's points beyond each side of the box that is drawn
ROOM = 0.2  # of the box, added on each side


def scene(
    folder: Path,
    estimate: Trajectory,
    refined: Trajectory | None,
    reference: Trajectory | None,
    times: NDArray[np.float64],
    keyframes: Sequence[int],
    glimpses: Sequence[Glimpse],
    camera: Pinhole | None,
) -> dict[str, Any]:
    """What scene.js draws. reference: in its own world, overlapping the estimate; keyframes: their frames.

    times: s, of the frames. A frame whose pose is not in the estimate (its time was there twice) gets the next one.
    """
    T_up_world = rigid(upright(estimate))
    row = frame_of(times, estimate.timestamps.numpy()).astype(np.int64)  # of each frame in the estimate
    lines = {} if refined is None else {"refined": pack(_path(T_up_world, refined))}
    if reference is not None:
        T_reference_world = absolute_error(estimate, reference).T_reference_estimate
        within = (reference.timestamps >= times[0] - 0.1) & (reference.timestamps <= times[-1] + 0.1)
        lines["reference"] = pack(_path(T_up_world @ inverse(T_reference_world), reference.at(within)))
    windows = [frame_of(np.array(one.window), times) for one in glimpses]
    made = np.unique(np.concatenate([np.array(keyframes, np.uint32), *windows]))  # some of the frame before
    best = estimate if refined is None or len(refined) != len(estimate) else refined
    return {
        "poses": pack(_poses(T_up_world, estimate)[row]),
        "lines": lines,
        "keyframes": {
            "frame": pack(made),
            "poses": pack(_poses(T_up_world, best.at(torch.from_numpy(row[made])))),
        },
        "map": _map(folder, T_up_world, times),
        "camera": None if camera is None else [camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height],
        "glimpses": _glimpses(glimpses, [np.searchsorted(made, window).tolist() for window in windows]),
        "ramp": ["#{:02x}{:02x}{:02x}".format(*color) for color in information_colors(np.linspace(0, 1, 32))],
    }


def pack(values: NDArray[Any]) -> str:
    """Numbers as the bytes of an array in base64: whole ones as they are, others as float32."""
    kept = values if values.dtype.kind == "u" else values.astype(np.float32)
    return base64.b64encode(np.ascontiguousarray(kept).tobytes()).decode()


def frame_of(timestamps: NDArray[np.float64], times: NDArray[np.float64]) -> NDArray[np.uint32]:
    """(N,) numbers of the frames at some of their times, 0 for a time that is unknown (nan)."""
    known = np.nan_to_num(timestamps, nan=-np.inf)
    return np.searchsorted(times, known - 1e-6).clip(0, max(len(times) - 1, 0)).astype(np.uint32)


def _poses(T_up_world: Tensor, trajectory: Trajectory) -> NDArray[np.float64]:
    """(N, 12) rows of T_up_cam."""
    return np.asarray((T_up_world @ trajectory.T_world_cam)[:, :3].reshape(-1, 12).numpy())


def _path(T_up_world: Tensor, trajectory: Trajectory) -> NDArray[np.float64]:
    """(N, 3) positions, thinned."""
    positions = transform(T_up_world, trajectory.positions)
    if len(positions) > MOST_PATH:
        positions = positions[torch.linspace(0, len(positions) - 1, MOST_PATH).long()]
    return np.asarray(positions.numpy())


def _map(folder: Path, T_up_world: Tensor, times: NDArray[np.float64]) -> dict[str, Any]:
    """The points of all segments, in the order of the frames that brought them; fewer where there are many.

    Positions are 16 bits of a box that leaves out what lies far from the rest.
    """
    segments = sorted(_segment(path.stem) for path in (*folder.glob("map.ply"), *folder.glob("map_segment_*.ply")))
    parts = [NOTHING]
    for segment in segments:
        with suppress(IdRgbdoError):  # a map of an odometry that does not say where its points were seen
            parts.append(read_map(folder, segment))
    cloud = Cloud(*(np.concatenate([getattr(c, name) for c in parts]) for name in ("xyz", "rgb", "normal")))
    frame = frame_of(np.concatenate([c.origins()[:, 0] for c in parts]), times)
    total = len(cloud)
    chosen = np.random.default_rng(0).permutation(total)[:MOST_MAP]
    xyz = cloud.xyz[chosen] @ T_up_world[:3, :3].numpy().T.astype(np.float32)
    if len(xyz) == 0:
        return {"total": 0, "low": [0, 0, 0], "step": 1, "xyz": "", "rgb": "", "frame": ""}
    low, high = np.quantile(xyz, [OUTSIDE, 1.0 - OUTSIDE], axis=0)
    room = ROOM * float((high - low).max()) + 1e-3
    low, high = low - room, high + room
    inside = ((xyz > low) & (xyz < high)).all(axis=1)
    chosen, xyz = chosen[inside], xyz[inside]
    order = np.argsort(frame[chosen], kind="stable")
    chosen, xyz = chosen[order], xyz[order]
    step = float((high - low).max()) / 65535.0
    return {
        "total": total,
        "low": low.tolist(),
        "step": step,
        "xyz": pack(((xyz - low) / step).round().astype(np.uint16)),
        "rgb": pack(cloud.rgb[chosen]),
        "frame": pack(frame[chosen]),
    }


def _segment(stem: str) -> int:
    number = stem.rpartition("_")[2]
    return int(number) if number.isdigit() else 0


def _glimpses(glimpses: Sequence[Glimpse], windows: list[list[int]]) -> dict[str, Any]:
    """Which frames left what; windows: as places in the list of keyframes."""
    points = [np.zeros((0, 4), np.uint16), *(one.points for one in glimpses)]
    images = {str(one.number): base64.b64encode(one.jpeg.tobytes()).decode() for one in glimpses if len(one.jpeg)}
    return {
        "frame": pack(np.array([one.number for one in glimpses], np.uint32)),
        "count": pack(np.array([len(one.points) for one in glimpses], np.uint32)),
        "points": pack(np.concatenate(points)),
        "steps": [PX, MM, BITS],
        "windows": windows,
        "images": images,
    }
