"""Colour and depth as one undistorted pinhole sees them: undistortion, registration of a separate depth camera."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from ..camera import Pinhole
from .calibration import Calibration

Image32 = NDArray[np.float32]


class Undistortion:
    """The precomputed map from distorted images to the pinhole of the same intrinsics."""

    def __init__(self, calibration: Calibration, camera: Pinhole) -> None:
        K = camera.matrix().numpy()
        self._map_u, self._map_v = cv2.initUndistortRectifyMap(
            K, np.array(calibration.distortion), np.eye(3), K, (camera.width, camera.height), cv2.CV_32FC1
        )

    def color(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Bilinear; pixels from outside repeat the border, so that no false edge arises there."""
        remapped = cv2.remap(image, self._map_u, self._map_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(remapped, dtype=np.uint8)

    def depth(self, image: Image32) -> Image32:
        """Nearest neighbour, since a mean over a depth edge is no surface; 0 (invalid) from outside."""
        remapped = cv2.remap(image, self._map_u, self._map_v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)
        return np.asarray(remapped, dtype=np.float32)


class Registration:
    """Depth of a camera of its own, as the colour camera sees it.

    Two cameras in one place differ by a map of the image plane. Otherwise each depth pixel becomes a point that is
    projected into the colour camera, the nearest of those that fall on a pixel winning; depth that is coarser than
    the colour image is enlarged before, without inventing values, so that no holes arise.
    """

    def __init__(self, calibration: Calibration, camera: Pinhole) -> None:
        depth = calibration.depth
        self._T_color_depth = calibration.T_color_depth()
        self._size = (camera.width, camera.height)
        self._K_color = camera.matrix().numpy()
        self._K_depth = np.array([[depth.fx, 0, depth.cx], [0, depth.fy, depth.cy], [0, 0, 1]], dtype=np.float64)
        ratio = max(self._K_color[0, 0] / self._K_depth[0, 0], self._K_color[1, 1] / self._K_depth[1, 1])
        self._enlarge = math.ceil(ratio - 1e-6)
        self._same_place = np.allclose(self._T_color_depth, np.eye(4), atol=1e-9)
        v, u = np.indices((camera.height, camera.width))
        H = self._K_depth @ np.linalg.inv(self._K_color)
        self._map_u = (H[0, 0] * u + H[0, 2]).astype(np.float32)
        self._map_v = (H[1, 1] * v + H[1, 2]).astype(np.float32)

    def depth(self, image: Image32) -> Image32:
        """(H, W) metres in the colour camera, 0 where unknown, of any size of depth image in metres."""
        if self._same_place:
            return np.asarray(cv2.remap(image, self._map_u, self._map_v, cv2.INTER_NEAREST), dtype=np.float32)
        k = self._enlarge
        larger = image.repeat(k, axis=0).repeat(k, axis=1)
        K = self._K_depth * np.array([[k], [k], [1]])
        K[:2, 2] += (k - 1) / 2  # a pixel's centre: (c + 0.5) k - 0.5
        unknown = np.where(larger > 0, larger, np.float32(np.nan))
        registered = cv2.registerDepth(K, self._K_color, np.zeros(0), self._T_color_depth, unknown, self._size)
        return np.nan_to_num(np.asarray(registered, dtype=np.float32), nan=0.0, posinf=0.0, neginf=0.0)
