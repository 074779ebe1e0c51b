"""A COLMAP model, as its documentation has it: cameras, images and points3D, as text and as binary.

COLMAP's cameras look along +z with y down like ours, but the centre of its top-left pixel is (0.5, 0.5), ours (0, 0).
Its poses are T_cam_world. Numbers of images and points begin with 1.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from ..definitions.camera import Pinhole
from ..definitions.se3 import inverse
from ..errors import IdRgbdoError
from ..trajectory import quaternion_from_rotation
from .images import image_name
from .points import Observations, project
from .tracked import TrackedRun

Array = NDArray[np.float64]

HALF = 0.5  # px, COLMAP's centre of the top-left pixel
PINHOLE = 1  # the number of its camera model


@dataclass(frozen=True)
class Image:
    """One image of a model."""

    name: str
    pose: tuple[float, ...]  # qw qx qy qz tx ty tz of T_cam_world
    uv: Array  # (K, 2) COLMAP's px of its observations
    point: NDArray[np.int64]  # (K,) numbers of their points


@dataclass(frozen=True)
class Model:
    """What the files hold; an image's number is its place + 1."""

    camera: Pinhole
    images: tuple[Image, ...]
    point: NDArray[np.int64]  # (P,) numbers of the points, increasing
    xyz: Array  # (P, 3) m
    rgb: NDArray[np.uint8]  # (P, 3)
    error: Array  # (P,) px, mean distance of a point's observations from where the poses put it
    tracks: tuple[tuple[tuple[int, int], ...], ...]  # a point: number of the image, place among its observations

    @property
    def observations(self) -> int:
        """How many there are in all images."""
        return sum(len(image.point) for image in self.images)


def make_model(
    run: TrackedRun, frames: Sequence[int], camera: Pinhole, seen: Observations, xyz: Array, rgb: NDArray[np.uint8]
) -> Model:
    """A model of the frames, and of the points (xyz (N, 3) m, rgb (N, 3)) that were seen in them."""
    number_of = {frame: place + 1 for place, frame in enumerate(frames)}
    keep = np.isin(seen.frame, frames)
    point, frame, uv = seen.point[keep], seen.frame[keep], seen.uv[keep]
    residual = np.zeros(len(point))
    images: list[Image] = []
    track: dict[int, list[tuple[int, int]]] = {}
    for number in frames:
        mine = np.flatnonzero(frame == number)
        T_world_cam = run.T_world_cam[number]
        expected, _ = project(camera, xyz[point[mine]], T_world_cam)
        residual[mine] = np.linalg.norm(uv[mine] - expected, axis=1)
        T = inverse(torch.from_numpy(T_world_cam))
        x, y, z, w = quaternion_from_rotation(T[:3, :3]).tolist()
        pose = (w, x, y, z, *T[:3, 3].tolist())
        images.append(Image(image_name(number), pose, uv[mine] + HALF, point[mine] + 1))
        for place, one in enumerate(point[mine].tolist()):
            track.setdefault(one, []).append((number_of[number], place))
    tracked = np.array(sorted(track), np.int64)
    total = np.bincount(point, residual, minlength=len(xyz))[tracked]
    error = total / np.maximum(np.bincount(point, minlength=len(xyz))[tracked], 1)
    tracks = tuple(tuple(track[one]) for one in tracked.tolist())
    return Model(camera, tuple(images), tracked + 1, xyz[tracked], rgb[tracked], error, tracks)


def write_binary(folder: Path, model: Model) -> None:
    """cameras.bin, images.bin and points3D.bin. Raises IdRgbdoError where they cannot be written."""
    c = model.camera
    parameters = (c.fx, c.fy, c.cx + HALF, c.cy + HALF)
    cameras = struct.pack("<QIiQQ4d", 1, 1, PINHOLE, c.width, c.height, *parameters)
    images = [struct.pack("<Q", len(model.images))]
    observation = np.dtype([("uv", "<f8", 2), ("point", "<u8")])
    for number, image in enumerate(model.images, start=1):
        images.append(struct.pack("<I7dI", number, *image.pose, 1))
        images.append(image.name.encode() + b"\0" + struct.pack("<Q", len(image.point)))
        seen = np.empty(len(image.point), observation)
        seen["uv"], seen["point"] = image.uv, image.point
        images.append(seen.tobytes())
    points = [struct.pack("<Q", len(model.point))]
    for place, number in enumerate(model.point.tolist()):
        track = model.tracks[place]
        points.append(struct.pack("<Q3d3Bd", number, *model.xyz[place], *model.rgb[place], model.error[place]))
        points.append(struct.pack(f"<Q{2 * len(track)}I", len(track), *(value for pair in track for value in pair)))
    _write(folder / "cameras.bin", cameras)
    _write(folder / "images.bin", b"".join(images))
    _write(folder / "points3D.bin", b"".join(points))


def write_text(folder: Path, model: Model) -> None:
    """cameras.txt, images.txt and points3D.txt. Raises IdRgbdoError where they cannot be written."""
    c = model.camera
    cameras = [
        "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]: fx, fy, cx, cy",
        f"1 PINHOLE {c.width} {c.height} {_numbers((c.fx, c.fy, c.cx + HALF, c.cy + HALF))}",
    ]
    images = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME", "# POINTS2D[] as (X, Y, POINT3D_ID)"]
    for number, image in enumerate(model.images, start=1):
        images.append(f"{number} {_numbers(image.pose)} 1 {image.name}")
        seen = zip(image.uv.tolist(), image.point.tolist(), strict=True)
        images.append(" ".join(f"{u:.4f} {v:.4f} {point}" for (u, v), point in seen))
    points = ["# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)"]
    for place, number in enumerate(model.point.tolist()):
        color = " ".join(map(str, model.rgb[place].tolist()))
        track = " ".join(f"{image} {observation}" for image, observation in model.tracks[place])
        points.append(f"{number} {_numbers(model.xyz[place].tolist())} {color} {model.error[place]:.4f} {track}")
    for name, lines in (("cameras", cameras), ("images", images), ("points3D", points)):
        _write(folder / f"{name}.txt", ("\n".join(lines) + "\n").encode())


def _numbers(values: Sequence[float]) -> str:
    return " ".join(f"{value:.12g}" for value in values)


def _write(path: Path, content: bytes) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    except OSError as error:
        raise IdRgbdoError(f"out: cannot write '{path}': {error.strerror}; pass another --out") from error
