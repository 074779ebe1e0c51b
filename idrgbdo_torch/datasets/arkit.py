"""What ARKit's recordings share, whichever app made them: coarse depth in the colour camera's place, its confidence, a
lens that breathes as it focuses, poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from ..errors import IdRgbdoError
from ..trajectory import rotation_from_quaternion
from .builder import RawPair
from .calibration import Calibration, DepthCamera, find_calibration, scaled
from .poses import Matrix
from .usual import LOOK_AT

LEAST_CONFIDENCE = 1  # of 0, 1, 2: low, medium, high
SHAPE = 0.02  # by which the ratio of the sides of colour and depth may differ
BREATH_PX = 0.3  # that focusing must move a pixel in the corner before the image is put right

Lenses = NDArray[np.float64]  # (N, 4) fx, fy, cx, cy of each frame, in pixels of the colour images


def rigid(positions: NDArray[np.float64], quaternions: NDArray[np.float64]) -> Matrix:
    """(N, 4, 4) of (N, 3) positions and (N, 4) quaternions x, y, z, w; not finite where a quaternion is 0."""
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    poses[:, :3, :3] = rotation_from_quaternion(torch.from_numpy(np.ascontiguousarray(quaternions))).numpy()
    poses[:, :3, 3] = positions
    return poses


def own_or(path: Path, camera: Path | None, found: Calibration) -> Calibration:
    """The camera file that the user names or that lies in the folder as camera.toml, else what the app wrote."""
    if camera is not None or (path / "camera.toml").is_file():
        return find_calibration(path, camera)
    return found


def first_good(read: Callable[[int], RawPair], frames: int) -> RawPair:
    """The images of the first frame that can be read. Raises the first one's error where none of the first can."""
    first_error: IdRgbdoError | None = None
    for index in range(min(frames, LOOK_AT)):
        try:
            return read(index)
        except IdRgbdoError as error:
            first_error = first_error or error
    raise first_error or IdRgbdoError("sequence: expected frames, found none; export the recording again")


def with_depth_camera(calibration: Calibration, pair: RawPair, where: str) -> Calibration:
    """The calibration with the depth camera of ARKit: the colour camera with fewer pixels.

    Raises IdRgbdoError where colour and depth have different shapes: then one of them was turned or cut.
    """
    (height, width), (rows, columns) = pair[0].shape[:2], pair[1].shape
    if abs(width * rows / (height * columns) - 1) > SHAPE:
        raise IdRgbdoError(
            f"{where}: expected colour and depth of one shape, got {width}x{height} and {columns}x{rows}: one of "
            "them was turned or cut after the recording; copy the original files"
        )
    if calibration.depth.fx is not None or (rows, columns) == (height, width):
        return calibration
    d = scaled(calibration, (width, height), (columns, rows))
    return replace(calibration, depth=DepthCamera(d.fx, d.fy, d.cx, d.cy))


def sure(depth: NDArray[Any], confidence: NDArray[Any] | None) -> NDArray[Any]:
    """The depth, 0 where ARKit's confidence is low. Confidence of another size, or low everywhere, says nothing."""
    if confidence is None or confidence.shape != depth.shape or not bool((confidence >= LEAST_CONFIDENCE).any()):
        return depth
    return np.where(confidence >= LEAST_CONFIDENCE, depth, np.zeros((), depth.dtype))


def usual_lens(lenses: Lenses) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy: the median of all frames."""
    fx, fy, cx, cy = np.median(lenses, axis=0).tolist()
    return fx, fy, cx, cy


def steady(pair: RawPair, lens: NDArray[np.float64], usual: tuple[float, float, float, float]) -> RawPair:
    """The images as the usual lens sees them. lens, usual: fx, fy, cx, cy in pixels of the colour image.

    Focusing changes the focal length by up to some per cent, which an odometry takes for motion along the axis.
    """
    color, depth = pair
    (height, width), (rows, columns) = color.shape[:2], depth.shape
    s = np.array([usual[0] / lens[0], usual[1] / lens[1]])
    t = np.array(usual[2:]) - s * lens[2:]  # u_usual = s u + t
    corners = np.array([[0, 0], [width - 1, height - 1]])
    if np.abs(corners * s + t - corners).max() < BREATH_PX:
        return pair
    A = np.array([[s[0], 0, t[0]], [0, s[1], t[1]]])
    color = np.asarray(cv2.warpAffine(color, A, (width, height), borderMode=cv2.BORDER_REPLICATE), dtype=np.uint8)
    k = np.array([columns / width, rows / height])
    B = np.array([[s[0], 0, 0.0], [0, s[1], 0.0]])
    B[:, 2] = (t + 0.5 - 0.5 * s) * k + 0.5 * s - 0.5  # the same map between centres of larger pixels
    return color, np.asarray(cv2.warpAffine(depth, B, (columns, rows), flags=cv2.INTER_NEAREST))
