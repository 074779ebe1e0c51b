"""Which focal length and principal point explain the matches best? Bundle adjustment over points with depth.

A wrong focal length bends what the depth says against what the images show, in every rotation and every approach. The
depth scale cancels: a scaled world filmed along a scaled path gives the same images.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..definitions.camera import Pinhole
from .tracks import Pair

Array = NDArray[np.float64]

FEWEST = 20  # points with depth that agree with one motion
RANSAC_PX, RANSAC_ROUNDS, SEED = 4.0, 200, 0
SIGMA_PX, SIGMA_DEPTH = 1.0, 0.01  # of a match; of a depth, relative
UNIT_PX = 100.0  # of the principal point among the unknowns
EVALUATIONS = 30
PARTS = 4  # of a recording, that are fitted on their own, too
TELLS = 0.7  # logarithm of the focal factor: a part that moves so far, or may, tells nothing


@dataclass(frozen=True)
class SelfCalibration:
    """The intrinsics that explain the matches best, with standard deviations."""

    focal_factor: float  # times the stated focal length
    focal_sigma: float
    center_px: tuple[float, float]  # added to the stated principal point
    center_sigma_px: float
    residual: float  # robust standard deviation of the residuals, in units of SIGMA_PX and SIGMA_DEPTH
    pairs: int
    points: int
    motions: list[tuple[float, float, float]]  # times of the two frames (s), and how far apart they are (m)


@dataclass(frozen=True)
class _View:
    """The points of a pair that agree with one motion."""

    pair: Pair
    uv_first: Array  # (N, 2) px
    uv_second: Array
    depth_first: Array  # (N,), in units of the median depth
    depth_second: Array  # 0 where unknown
    start: Array  # (6,) rotation vector and translation of T_second_first


@dataclass(frozen=True)
class _Fit:
    """The intrinsics that fit some views: logarithm of the focal factor, principal point in UNIT_PX."""

    intrinsics: Array  # (3,)
    sigma: Array  # (3,) formal standard deviations
    noise: float
    motions: Array  # (V, 6)


def self_calibrate(pairs: list[Pair], camera: Pinhole) -> SelfCalibration | None:
    """Bundle adjustment of the pairs' motions, one factor on fx and fy, and the principal point; None without pairs.

    The formal deviations hold where only the matches err. Depth that bends, a rolling shutter or a moving object err
    too, another way in each part of a recording: the deviations grow by how much the parts disagree.
    """
    known = [pair.depth_first[pair.depth_first > 0] for pair in pairs]
    unit = float(np.median(np.concatenate(known))) if any(map(len, known)) else 1.0
    views = [view for pair in pairs if (view := _view(pair, camera, unit)) is not None]
    if not views:
        return None
    fit = _fit(views, camera)
    sigma = fit.sigma * _disagreement([_fit(part, camera) for part in _parts(views)])
    factor = float(np.exp(fit.intrinsics[0]))
    translations = [float(np.linalg.norm(motion[3:])) * unit for motion in fit.motions]
    return SelfCalibration(
        focal_factor=factor,
        focal_sigma=factor * float(sigma[0]),
        center_px=(UNIT_PX * float(fit.intrinsics[1]), UNIT_PX * float(fit.intrinsics[2])),
        center_sigma_px=UNIT_PX * float(max(sigma[1], sigma[2])),
        residual=fit.noise,
        pairs=len(views),
        points=sum(len(view.uv_first) for view in views),
        motions=[(v.pair.first, v.pair.second, metres) for v, metres in zip(views, translations, strict=True)],
    )


def _fit(views: list[_View], camera: Pinhole) -> _Fit:
    from scipy.optimize import least_squares  # 0.2 s to import
    from scipy.sparse import lil_matrix

    rows = np.cumsum([0] + [3 * len(view.uv_first) for view in views])
    sparsity = lil_matrix((rows[-1], 3 + 6 * len(views)), dtype=np.int8)
    for number in range(len(views)):
        here = slice(rows[number], rows[number + 1])
        sparsity[here, :3] = 1
        sparsity[here, 3 + 6 * number : 9 + 6 * number] = 1

    def residuals(x: Array) -> Array:
        return np.concatenate([_residuals(x[:3], x[3 + 6 * n : 9 + 6 * n], v, camera) for n, v in enumerate(views)])

    start = np.concatenate([np.zeros(3), *(view.start for view in views)])
    fit = least_squares(residuals, start, loss="soft_l1", jac_sparsity=sparsity, x_scale="jac", max_nfev=EVALUATIONS)
    noise = 1.4826 * float(np.median(np.abs(fit.fun)))
    J = np.asarray(fit.jac.todense())
    sigma = noise * np.sqrt(np.maximum(np.diag(np.linalg.pinv(J.T @ J))[:3], 0.0))
    return _Fit(fit.x[:3], sigma, noise, fit.x[3:].reshape(-1, 6))


def _parts(views: list[_View]) -> list[list[_View]]:
    """The views in stretches of the recording, one after another."""
    cuts = np.array_split(np.arange(len(views)), min(PARTS, len(views)))
    return [[views[index] for index in cut] for cut in cuts]


def _disagreement(fits: list[_Fit]) -> float:
    """By how much the fits of parts differ more than their deviations allow; at least 1.

    Parts that can tell nothing, as where the camera stood still, are left out.
    """
    told = [fit for fit in fits if abs(fit.intrinsics[0]) < TELLS and 0.0 < fit.sigma[0] < TELLS]
    if len(told) < 2:
        return 1.0
    x, sigma = (np.array([getattr(fit, name) for fit in told]) for name in ("intrinsics", "sigma"))
    weight = 1.0 / np.maximum(sigma, 1e-9) ** 2
    mean = (weight * x).sum(axis=0) / weight.sum(axis=0)
    chi2 = (weight * (x - mean) ** 2).sum(axis=0) / (len(told) - 1)
    return float(np.sqrt(max(1.0, chi2.mean())))


def _view(pair: Pair, camera: Pinhole, unit: float) -> _View | None:
    """The matches that one motion explains to a few pixels (RANSAC); None where they are too few."""
    known = pair.depth_first > 0
    if known.sum() < FEWEST:
        return None
    uv, uv_second, depth = pair.uv_first[known], pair.uv_second[known], pair.depth_first[known] / unit
    K = camera.matrix().numpy()
    P = np.column_stack([(uv - [camera.cx, camera.cy]) / [camera.fx, camera.fy] * depth[:, None], depth])
    cv2.setRNGSeed(SEED)
    found, turn, shift, agreeing = cv2.solvePnPRansac(
        P, uv_second, K, None, reprojectionError=RANSAC_PX, iterationsCount=RANSAC_ROUNDS
    )
    if not found or agreeing is None or len(agreeing) < FEWEST:
        return None
    keep = agreeing[:, 0]
    depth_second = pair.depth_second[known][keep] / unit
    return _View(pair, uv[keep], uv_second[keep], depth[keep], depth_second, np.r_[turn[:, 0], shift[:, 0]])


def _residuals(intrinsics: Array, motion: Array, view: _View, camera: Pinhole) -> Array:
    """(3 N,) where the points come to lie in the second image, right and down, and how far away, all whitened."""
    factor = np.exp(intrinsics[0])
    fx, fy = camera.fx * factor, camera.fy * factor
    cx, cy = camera.cx + UNIT_PX * intrinsics[1], camera.cy + UNIT_PX * intrinsics[2]
    P = np.column_stack([(view.uv_first - [cx, cy]) / [fx, fy] * view.depth_first[:, None], view.depth_first])
    x, y, z = (P @ cv2.Rodrigues(motion[:3])[0].T + motion[3:]).T
    z = np.maximum(z, 0.01)
    u, v = fx * x / z + cx - view.uv_second[:, 0], fy * y / z + cy - view.uv_second[:, 1]
    measured = view.depth_second > 0
    away = np.where(measured, z / np.where(measured, view.depth_second, 1.0) - 1.0, 0.0)
    return np.concatenate([u / SIGMA_PX, v / SIGMA_PX, away / SIGMA_DEPTH])
