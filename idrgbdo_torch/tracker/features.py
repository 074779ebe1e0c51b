"""ORB features of a frame, and where a frame must stand to see those of a keyframe: the start of a search, no more.

Only a frame that the direct search has lost pays for them, and a place that is kept for such frames. Places have them
from the half-size level, where they cost a quarter and still start an alignment within a pixel or two; a keyframe that
is far from the frame has them from the whole image, since there every match counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..frame import Frame

Array = NDArray[np.float64]

FULL, HALF = 0, 1  # levels of the pyramid
COUNT = {FULL: 1500, HALF: 500}  # features of an image
THRESHOLD = 7  # gray levels, of a corner: half-size levels are smooth, and so is motion blur
RATIO = 0.8  # of the best to the second-best match (Lowe)
FEWEST = 12  # matches with depth that are worth a try, and that must agree with a pose
SUPPORT = 20  # matches that speak for a pose whose brightness agrees in half of the points only
REPROJECTION_PX = 3.0  # of a match that agrees, on that level
TRIES = 1000  # samples of RANSAC at most
MOST_TURNED = np.pi / 3  # rad, between two views that overlap; a mirrored or rolled image fits at more
SURE = 0.999  # after which it stops


@dataclass(frozen=True)
class Features:
    """The features of one image, with depth where the sensor has it."""

    uv: NDArray[np.float32]  # (F, 2) px of its level
    descriptor: NDArray[np.uint8]  # (F, 32)
    P: NDArray[np.float32]  # (F, 3) m in the camera; 0 where there is no depth


def features(frame: Frame, level: int) -> Features:
    """The features of a frame on a level, always the same ones."""
    shown = frame.images[level] if frame.sharp is None or level != FULL else frame.sharp
    image = np.nan_to_num(shown).clip(0.0, 255.0).astype(np.uint8)
    detector = cv2.ORB.create(nfeatures=COUNT[level], fastThreshold=THRESHOLD)
    keypoints, descriptor = detector.detectAndCompute(image, None)
    if not keypoints:
        return Features(np.zeros((0, 2), np.float32), np.zeros((0, 32), np.uint8), np.zeros((0, 3), np.float32))
    uv = np.array([point.pt for point in keypoints], np.float32)
    at_full = np.rint((uv + 0.5) * 2.0**level - 0.5).astype(np.int64)
    height, width = frame.depth.shape
    z = frame.depth[at_full[:, 1].clip(0, height - 1), at_full[:, 0].clip(0, width - 1)]
    fx, fy, cx, cy = frame.intrinsics[level]
    P = np.column_stack([(uv[:, 0] - cx) / fx * z, (uv[:, 1] - cy) / fy * z, z])
    with np.errstate(over="ignore"):  # of depth that is none
        return Features(uv, descriptor, P.astype(np.float32))


def match(host: Features, target: Features) -> NDArray[np.int64]:
    """(M, 2) numbers of a host's feature with depth and the target's that is clearly its own match, both ways."""
    if len(host.uv) < 2 or len(target.uv) < 2:
        return np.zeros((0, 2), np.int64)
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    there = matcher.knnMatch(host.descriptor, target.descriptor, k=2)
    back = {m.queryIdx: m.trainIdx for m in matcher.match(target.descriptor, host.descriptor)}
    pairs = [
        (best.queryIdx, best.trainIdx)
        for best, second in (found for found in there if len(found) == 2)
        if best.distance < RATIO * second.distance
        and back.get(best.trainIdx) == best.queryIdx
        and host.P[best.queryIdx, 2] > 0.0
    ]
    return np.array(pairs, np.int64).reshape(-1, 2)


@dataclass(frozen=True)
class Perspective:
    """A pose from features, and the matches that agree with it."""

    T_target_host: Array  # (4, 4)
    P: Array  # (M, 3) m in the host
    uv: Array  # (M, 2) px in the target
    camera: Array  # (4,) fx fy cx cy

    def supports(self, T_target_host: Array) -> bool:
        """Whether enough of the matches, and most of them, agree with a refined pose too."""
        P = self.P @ T_target_host[:3, :3].T + T_target_host[:3, 3]
        ahead = P[:, 2] > 0.0
        fx, fy, cx, cy = self.camera
        z = np.where(ahead, P[:, 2], 1.0)
        at = np.column_stack([fx * P[:, 0] / z + cx, fy * P[:, 1] / z + cy])
        agree = int((ahead & (np.linalg.norm(at - self.uv, axis=1) < REPROJECTION_PX)).sum())
        return agree >= SUPPORT and 2 * agree >= len(P)


def pose_from_features(host: Features, target: Features, camera: Array) -> Perspective | None:
    """The pose by perspective from the host's points (RANSAC), None where too few agree.

    camera: (4,) fx fy cx cy of the target on the level of its features.
    """
    pairs = match(host, target)
    if len(pairs) < FEWEST:
        return None
    fx, fy, cx, cy = camera
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    P, uv = host.P[pairs[:, 0]].astype(np.float64), target.uv[pairs[:, 1]].astype(np.float64)
    try:
        found, rvec, t, inliers = cv2.solvePnPRansac(
            P, uv, K, None, iterationsCount=TRIES, reprojectionError=REPROJECTION_PX, confidence=SURE,
            flags=cv2.SOLVEPNP_EPNP,
        )  # fmt: skip
    except cv2.error:  # degenerate samples, all points in a line
        return None
    if not found or inliers is None or len(inliers) < FEWEST:
        return None
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(rvec)[0]
    T[:3, 3] = t[:, 0]
    turned = float(np.linalg.norm(rvec))
    if not np.isfinite(T).all() or turned > MOST_TURNED:
        return None
    return Perspective(T, P[inliers[:, 0]], uv[inliers[:, 0]], camera)


def start_from_features(frame: Frame, keyframe: Frame) -> Perspective | None:
    """The pose T_frame_kf that the features of both give; None where too few agree."""
    return pose_from_features(features(keyframe, FULL), features(frame, FULL), frame.intrinsics[FULL])
