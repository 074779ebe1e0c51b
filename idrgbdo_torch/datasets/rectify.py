"""Colour and depth as one undistorted pinhole sees them: undistortion, registration of a separate depth camera."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from ..definitions.camera import Pinhole
from ..errors import IdRgbdoError
from .calibration import LEAST_FOCAL, Calibration
from .images import MOST_PIXELS
from .reproject import interpolate_surfaces, reproject

Image32 = NDArray[np.float32]
MOST_ENLARGED = 1e4  # times, which no image is
ROWS = 64  # of an image that are calculated at a time, in float64
SURFACE = 1.02  # ratio of neighbouring depths of one surface


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
    the colour image is enlarged before, so that no holes arise.

    Coarser depth is interpolated within surfaces: repeated values would make steps of them, each block facing the
    camera, and a tracker that looks at slopes of depth takes these for the scene's (docs/data.md has what it costs).
    """

    def __init__(self, calibration: Calibration, camera: Pinhole) -> None:
        depth = calibration.depth
        T_color_depth = calibration.T_color_depth()
        self._camera = camera
        self._intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
        self._K_depth = np.array([[depth.fx, 0, depth.cx], [0, depth.fy, depth.cy], [0, 0, 1]], dtype=np.float64)
        self._R, self._t = T_color_depth[:3, :3], T_color_depth[:3, 3].astype(np.float32)
        self._same_place = np.allclose(T_color_depth, np.eye(4), atol=1e-9)
        K_color = camera.matrix().numpy()
        ratio = min(max(K_color[k, k] / self._K_depth[k, k] for k in (0, 1)), MOST_ENLARGED)
        self._enlarge = math.floor(ratio + 0.1) + 1  # so that the points lie less than a pixel apart
        self._coarse = ratio > 1.1
        # made when the depth image's size is known
        self._turned: Image32 | None = None
        self._between: tuple[Image32, Image32] | None = None
        v, u = np.indices((camera.height, camera.width))
        H = self._K_depth @ np.linalg.inv(K_color)
        self._map_u = (H[0, 0] * u + H[0, 2]).astype(np.float32)
        self._map_v = (H[1, 1] * v + H[1, 2]).astype(np.float32)

    def depth(self, image: Image32) -> Image32:
        """(H, W) metres in the colour camera, 0 where unknown, of any size of depth image in metres."""
        if min(self._K_depth[0, 0] / image.shape[1], self._K_depth[1, 1] / image.shape[0]) < LEAST_FOCAL:
            raise IdRgbdoError(
                f"depth: expected focal lengths of a depth camera of {image.shape[1]}x{image.shape[0]} pixels, got "
                f"fx={self._K_depth[0, 0]:g}, fy={self._K_depth[1, 1]:g}; correct [depth] in the camera file"
            )
        if self._same_place:
            return sampled(image, self._map_u, self._map_v, smooth=self._coarse)
        larger = self._enlarged(image) if self._enlarge > 1 else image
        seen = np.zeros((self._camera.height, self._camera.width), np.float32)
        reproject(np.ascontiguousarray(larger), self._rays(larger.shape), self._t, self._intrinsics, seen)
        return seen

    def _enlarged(self, image: Image32) -> Image32:
        shape = (image.shape[0] * self._enlarge, image.shape[1] * self._enlarge)
        if shape[0] * shape[1] > MOST_PIXELS:
            raise IdRgbdoError(
                f"depth: expected a depth camera about as fine as the colour camera, but each of its pixels covers "
                f"{self._enlarge}x{self._enlarge} of colour's; correct fx and fy of [depth] in the camera file"
            )
        if self._between is None or self._between[0].shape != shape:
            v, u = ((np.arange(size) + 0.5) / self._enlarge - 0.5 for size in shape)
            self._between = (
                np.ascontiguousarray(np.broadcast_to(u.astype(np.float32), shape)),
                np.ascontiguousarray(np.broadcast_to(v.astype(np.float32)[:, None], shape)),
            )
        return sampled(image, *self._between, smooth=self._coarse)

    def _rays(self, shape: tuple[int, int]) -> Image32:
        """(3, h, w) points at depth 1 of the depth camera, enlarged to (h, w) pixels, turned as the colour camera."""
        if self._turned is None or self._turned.shape[1:] != shape:
            self._turned = np.empty((3, *shape), np.float32)
            turn = self._R @ np.linalg.inv(self._K_depth)
            for row in range(0, shape[0], ROWS):
                part = self._turned[:, row : row + ROWS]
                v, u = np.indices(part.shape[1:])  # a pixel's centre: (c + 0.5) k - 0.5
                places = [(u + 0.5) / self._enlarge - 0.5, (v + row + 0.5) / self._enlarge - 0.5]
                part[:] = np.einsum("ij,jhw->ihw", turn, np.stack([*places, np.ones(part.shape[1:])]))
        return self._turned


def sampled(depth: Image32, map_u: Image32, map_v: Image32, *, smooth: bool) -> Image32:
    """(H, W) metres at the places (map_u, map_v) of a depth image, 0 outside.

    smooth: bilinear where the four pixels around are of one surface; else the nearest pixel, since a mean over a
    depth edge is no surface.
    """
    nearest = np.asarray(cv2.remap(depth, map_u, map_v, cv2.INTER_NEAREST), dtype=np.float32)
    if not smooth:
        return nearest
    between = np.asarray(cv2.remap(depth, map_u, map_v, cv2.INTER_LINEAR), dtype=np.float32)
    interpolate_surfaces(np.ascontiguousarray(depth), map_u, map_v, np.float32(SURFACE), between, nearest)
    return nearest
