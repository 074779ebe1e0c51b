"""ORB features of a frame, and where a frame must stand to see those of a keyframe: the start of a search, no more.

Only a frame that the direct search has lost pays for them, and a place that is kept for such frames. They are from the
half-size level, where they cost a quarter and still start an alignment within a pixel or two; from the whole image only
where a frame is so far from its keyframe that every match counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..frame import Frame
from ..kernels.matching import mutual_matches, rigid_triples

Array = NDArray[np.float64]

FULL, HALF = 0, 1  # levels of the pyramid
COUNT = {FULL: 1500, HALF: 500}  # features of an image
WORDS = 4  # of 64 bits, of a descriptor
THRESHOLDS = (20, 7)  # gray levels, of a corner; the lower one where an image is smooth, as in motion blur:
PLENTY = 0.8  # of COUNT, and the lower threshold, which takes twice as long, finds hardly others
CHANCE = 6  # matches that may agree with a pose where two images show different places: none in 119 of 121 cases
RATIO = 0.8  # of the best to the second-best match (Lowe)
FEWEST = 12  # matches with depth that are worth a try, and that must agree with a pose
SUPPORT = 20  # matches that speak for a pose whose brightness agrees in half of the points only
REPROJECTION_PX = 3.0  # of a match that agrees, on that level
TRIPLES = 3000  # of matches that are looked at,
POSES = 100  # and of which the first so many that could be one triangle are tried
SAME_SHARE, SAME_M = 0.03, 0.01  # by which its sides may differ: share, and m at a depth of 1 m, with its square
APART = 0.1  # of the depth: shortest side
NEAREST_M = 1e-3  # m, in front of the camera
MOST_TURNED = np.pi / 3  # rad, between two views that overlap; a mirrored or rolled image fits at more


@dataclass(frozen=True)
class Features:
    """The features of one image, with depth where the sensor has it."""

    uv: NDArray[np.float32]  # (F, 2) px of its level
    descriptor: NDArray[np.uint8]  # (F, 8 WORDS)
    P: NDArray[np.float32]  # (F, 3) m in the camera; 0 where there is no depth
    clear: bool = False  # PLENTY of them by the higher of the THRESHOLDS: neither poor nor blurred


def features(frame: Frame, level: int) -> Features:
    """The features of a frame on a level, always the same ones; the frame keeps them, as it may be looked at again."""
    kept: dict[int, Features] = vars(frame).setdefault("_features", {})  # beside its fields, as cached_property does
    if level not in kept:
        kept[level] = detected(frame, level)
    return kept[level]


def detected(frame: Frame, level: int) -> Features:
    """Find them."""
    shown = frame.images[level] if frame.sharp is None or level != FULL else frame.sharp
    image = np.nan_to_num(shown).clip(0.0, 255.0).astype(np.uint8)
    clear = False
    for threshold in THRESHOLDS:
        detector = cv2.ORB.create(nfeatures=COUNT[level], fastThreshold=threshold)
        keypoints, descriptor = detector.detectAndCompute(image, None)
        if len(keypoints) >= PLENTY * COUNT[level]:
            clear = threshold == max(THRESHOLDS)
            break
    if not keypoints:
        return Features(np.zeros((0, 2), np.float32), np.zeros((0, 8 * WORDS), np.uint8), np.zeros((0, 3), np.float32))
    uv = np.asarray(cv2.KeyPoint.convert(keypoints), np.float32)
    at_full = np.rint((uv + 0.5) * 2.0**level - 0.5).astype(np.int64)
    height, width = frame.depth.shape
    z = frame.depth[at_full[:, 1].clip(0, height - 1), at_full[:, 0].clip(0, width - 1)]
    fx, fy, cx, cy = frame.intrinsics[level]
    P = np.column_stack([(uv[:, 0] - cx) / fx * z, (uv[:, 1] - cy) / fy * z, z])
    with np.errstate(over="ignore"):  # of depth that is none
        return Features(uv, descriptor, P.astype(np.float32), clear)


def match(host: Features, target: Features) -> NDArray[np.int64]:
    """(M, 2) numbers of a host's feature with depth and the target's that is clearly its own match, both ways."""
    deep = np.flatnonzero(host.P[:, 2] > 0.0)
    if len(deep) < 2 or len(target.uv) < 2:
        return np.zeros((0, 2), np.int64)
    pairs = mutual_matches(host.descriptor[deep].view(np.uint64), target.descriptor.view(np.uint64), RATIO)
    return np.column_stack([deep[pairs[:, 0]], pairs[:, 1]])


@dataclass(frozen=True)
class Perspective:
    """A pose from features, and the matches that agree with it."""

    T_target_host: Array  # (4, 4)
    P: Array  # (M, 3) m in the host
    uv: Array  # (M, 2) px in the target
    camera: Array  # (4,) fx fy cx cy

    def supports(self, T_target_host: Array) -> bool:
        """Whether enough of the matches, and most of them, agree with a refined pose too."""
        agree = int(agreeing(T_target_host[None], self.P, self.uv, self.camera).sum())
        return agree >= SUPPORT and 2 * agree >= len(self.P)


def agreeing(T: Array, P: Array, uv: Array, camera: Array) -> NDArray[np.bool_]:
    """(N, M): which of M points (M, 3) m fall on their pixels (M, 2) at each of N poses (N, 4, 4)."""
    fx, fy, cx, cy = camera
    x, y, z = np.moveaxis(P @ T[:, :3, :3].transpose(0, 2, 1) + T[:, None, :3, 3], -1, 0)
    ahead = z > NEAREST_M
    z = np.where(ahead, z, 1.0)
    off2 = (fx * x / z + cx - uv[:, 0]) ** 2 + (fy * y / z + cy - uv[:, 1]) ** 2
    out: NDArray[np.bool_] = ahead & (off2 < REPROJECTION_PX**2)
    return out


def pose_from_features(host: Features, target: Features, camera: Array) -> Perspective | None:
    """The pose by perspective from the host's points, None where too few agree.

    It starts from three matches whose triangle is as large in both views, since both know depth: the one that most
    matches agree with. camera: (4,) fx fy cx cy of the target on the level of its features.
    """
    return pose_from_matches(host, target, match(host, target), camera)


def pose_from_matches(host: Features, target: Features, pairs: NDArray[np.int64], camera: Array) -> Perspective | None:
    """pose_from_features() of matches (M, 2) as match() gives them."""
    if len(pairs) < FEWEST:
        return None
    T, agree = most_agreeing(host, target, pairs, camera)
    if agree.sum() < FEWEST:
        return None
    P, uv = host.P[pairs[:, 0]].astype(np.float64), target.uv[pairs[:, 1]].astype(np.float64)
    refined = refined_perspective(T, P[agree], uv[agree], camera)
    inliers = agreeing(refined[None], P, uv, camera)[0]
    turned = float(np.arccos(np.clip((np.trace(refined[:3, :3]) - 1.0) / 2.0, -1.0, 1.0)))
    if inliers.sum() < FEWEST or turned > MOST_TURNED:
        return None
    return Perspective(refined, P[inliers], uv[inliers], camera)


def most_agreeing(
    host: Features, target: Features, pairs: NDArray[np.int64], camera: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """The pose (4, 4) of three matches that most of them (M, 2) agree with, and which ones do (M,)."""
    P, Q = host.P[pairs[:, 0]].astype(np.float64), target.P[pairs[:, 1]].astype(np.float64)
    T = poses_of_triangles(P, Q)
    if not len(T):
        return np.eye(4), np.zeros(len(pairs), bool)
    agree = agreeing(T, P, target.uv[pairs[:, 1]].astype(np.float64), camera)
    best = int(np.argmax(agree.sum(axis=1)))
    return T[best], agree[best]


def poses_of_triangles(P: Array, Q: Array) -> Array:
    """(N, 4, 4) T_target_host of triples of matched points (M, 3) m that are as far apart in host and target."""
    deep = np.flatnonzero(Q[:, 2] > 0.0)
    if len(deep) < 3:
        return np.zeros((0, 4, 4))
    triples = deep[np.random.default_rng(0).integers(0, len(deep), (TRIPLES, 3))]
    rigid = rigid_triples(P, Q, triples, POSES, (SAME_SHARE, SAME_M, APART))
    A, B = P[rigid], Q[rigid]
    middle_a, middle_b = A.mean(axis=1, keepdims=True), B.mean(axis=1, keepdims=True)
    U, _, Vt = np.linalg.svd((B - middle_b).transpose(0, 2, 1) @ (A - middle_a))  # Kabsch
    U[:, :, 2] *= np.linalg.det(U @ Vt)[:, None]
    T = np.tile(np.eye(4), (len(A), 1, 1))
    T[:, :3, :3] = U @ Vt
    T[:, :3, 3] = (middle_b - middle_a @ T[:, :3, :3].transpose(0, 2, 1))[:, 0]
    return T


def refined_perspective(T: Array, P: Array, uv: Array, camera: Array) -> Array:
    """The pose (4, 4) that puts points (M, 3) nearest to their pixels (M, 2), from a close one; else that one."""
    fx, fy, cx, cy = camera
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    rvec, t = cv2.Rodrigues(T[:3, :3])[0], T[:3, 3].copy()
    try:
        found, rvec, t = cv2.solvePnP(P, uv, K, None, rvec, t, True, cv2.SOLVEPNP_ITERATIVE)
    except cv2.error:  # degenerate, all points in a line
        return T
    out = np.eye(4)
    out[:3, :3] = cv2.Rodrigues(rvec)[0]
    out[:3, 3] = np.ravel(t)
    return out if found and np.isfinite(out).all() else T


def start_from_features(frame: Frame, keyframe: Frame, level: int = FULL) -> Perspective | None:
    """The pose T_frame_kf that the features of both give on a level; None where too few agree."""
    return pose_from_features(features(keyframe, level), features(frame, level), frame.intrinsics[level])


def strangers(frame: Frame, keyframe: Frame) -> bool:
    """Whether two clear images share no more features of the half-size level than chance would."""
    host, target = features(keyframe, HALF), features(frame, HALF)
    if not (host.clear and target.clear):
        return False
    pairs = match(host, target)
    return len(pairs) < FEWEST or int(most_agreeing(host, target, pairs, frame.intrinsics[HALF])[1].sum()) < CHANCE
