"""Images of one instant: the rows of a rolling shutter and depth that came late, brought to the time of their frame."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from ..definitions.camera import Pinhole
from ..frame import Frame, RgbdFrame, prepare

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Floats = NDArray[Any]

REDUCED = 8  # px that share a depth where the sensor gave none
AROUND = 9  # of such, over which it is averaged
NOTHING = -1e6  # m, stands for unknown depth while depths are interpolated, so that no mean with it passes for depth
SURFACE = 0.01  # relative difference of an interpolated depth from the nearest pixel's on one surface


def takes_time(camera: Pinhole) -> bool:
    """Whether a frame's images are of several instants, as far as the camera file says."""
    return camera.readout_ms != 0.0 or camera.depth_delay_ms != 0.0


def steady(rgbd: RgbdFrame, velocity: Array, blur: float) -> Frame:
    """prepare(), of one instant where the camera is known to take its time. velocity: as at_one_instant has it."""
    moved = at_one_instant(rgbd, velocity) if takes_time(rgbd.camera) and velocity.any() else rgbd
    return prepare(moved, blur)


def at_one_instant(rgbd: RgbdFrame, velocity: Array) -> RgbdFrame:
    """The frame as if all of it had been taken at its timestamp, by a camera of constant velocity.

    velocity: (6,) [v, w] of a left increment of T_cam_world, m/s and rad/s, so that a point P of the camera moves by
    dP/dt = v + w x P. To first order in the image: a pixel moves along its flow, whatever lies at it.
    """
    camera = rgbd.camera
    u, v, x, y = _grid(camera)
    z = rgbd.depth.numpy()
    if camera.depth_delay_ms:
        delay = np.float32(camera.depth_delay_ms / 1e3)
        du, dv, approach = flow(camera, x, y, _inverse(z), velocity)
        z = _depth_at(z, u + delay * du, v + delay * dv)
        z *= 1 - delay * approach
    gray, color = rgbd.gray.numpy(), rgbd.color
    if camera.readout_ms:
        row = np.float32(camera.readout_ms / 1e3 / camera.height)
        du, dv, _ = flow(camera, x, y, _inverse(z), velocity)
        late: Image = row * (v + np.float32(0.5 - camera.height / 2)) / (1 - row * dv)  # s, of the row that saw a point
        map_u, map_v = u + late * du, v + late * dv
        gray = _sampled(gray, map_u, map_v)
        color = color if color is None else torch.from_numpy(_sampled(color.numpy(), map_u, map_v))
    return replace(rgbd, gray=torch.from_numpy(gray), depth=torch.from_numpy(z), color=color)


def _grid(camera: Pinhole) -> tuple[Image, Image, Image, Image]:
    """Pixels u (1, W), v (H, 1), and where they lie at depth 1, x (1, W), y (H, 1)."""
    u, v = np.arange(camera.width, dtype=np.float32)[None], np.arange(camera.height, dtype=np.float32)[:, None]
    return (
        u,
        v,
        (u - np.float32(camera.cx)) / np.float32(camera.fx),
        (v - np.float32(camera.cy)) / np.float32(camera.fy),
    )


def flow(camera: Pinhole, x: Floats, y: Floats, d: Floats, velocity: Array) -> tuple[Floats, Floats, Floats]:
    """Velocity in the image, px/s right and down, and relative change of depth, 1/s; all in the points' type.

    Points at (x, y) of depth 1, which broadcast, with the inverse depth d in 1/m.
    """
    vx, vy, vz, wx, wy, wz = velocity.astype(np.float32)
    approach = vz * d + (wx * y - wy * x)  # of P / z: its third component
    right = vx * d + (wy - wz * y) - x * approach
    down = vy * d + (wz * x - wx) - y * approach
    return np.float32(camera.fx) * right, np.float32(camera.fy) * down, approach


def _inverse(z: Image) -> Image:
    """(H, W) inverse depth, 1/m; where it is unknown, what is known around, else 0."""
    known = z > 0
    d = np.zeros_like(z)
    np.divide(1.0, z, out=d, where=known)
    if known.all():
        return d
    few = (max(z.shape[1] // REDUCED, 1), max(z.shape[0] // REDUCED, 1))
    total, weight = (
        cv2.blur(cv2.resize(part, few, interpolation=cv2.INTER_AREA), (AROUND, AROUND))
        for part in (d, known.astype(np.float32))
    )
    around = cv2.resize(total / np.maximum(weight, np.float32(1e-3)), z.shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.where(known, d, around)


def _depth_at(z: Image, map_u: Floats, map_v: Floats) -> Image:
    """(H, W) depth at places (map_u, map_v): between the pixels of one surface, else the nearest pixel's."""
    marked = np.where(z > 0, z, np.float32(NOTHING))
    nearest = np.asarray(cv2.remap(z, map_u, map_v, cv2.INTER_NEAREST), np.float32)
    between = cv2.remap(marked, map_u, map_v, cv2.INTER_LINEAR, borderValue=NOTHING)
    return np.where(np.abs(between - nearest) < SURFACE * nearest, between, nearest)


def _sampled(image: NDArray[Any], map_u: Image, map_v: Image) -> NDArray[Any]:
    return np.asarray(cv2.remap(image, map_u, map_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
