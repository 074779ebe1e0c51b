"""Feature-based odometry after ORB-SLAM2 (Mur-Artal and Tardos 2017) without its map: ORB, PnP and local refinement.

On OpenCV's parts: ORB matches against the newest keyframe give the pose (RANSAC); with it the points of the last few
keyframes are looked up in the frame to a fraction of a pixel, and all of them refine the pose together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from idrgbdo_torch.definitions.camera import Pinhole, backproject, duv_dP, inside, project
from idrgbdo_torch.definitions.se3 import exp, inverse, transform
from idrgbdo_torch.definitions.solver import normal_equations, solve
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.text.configfile import dump

from . import checked
from .geometry import student_weight, surface_inverse_depth, twist_jacobian
from .keyframes import Fit, Keyframe, KeyframeOdometry, KeyframeRule

Array = NDArray[Any]


@dataclass(frozen=True)
class FeatureConfig:
    """Numbers of features, windows in px, and what a measurement is trusted with."""

    features: int = 1000
    min_matches: int = 12
    max_hamming: float = 64.0  # bits of 256
    ransac_px: float = 4.0
    window: int = 11  # px, of the sub-pixel search
    search_px: float = 8.0  # how far from its predicted place a point is believed
    max_difference: float = 12.0  # gray levels, mean over the window
    sigma_px: float = 0.3
    sigma_inverse_depth: float = 0.004  # 1/m
    freedom: float = 4.0  # of the t-distribution
    iterations: int = 10


@dataclass(frozen=True)
class Features:
    """The ORB features of a frame that have a depth, and what others need to find them."""

    camera: Pinhole
    gray: Array  # (H, W) uint8
    depth: Tensor  # (H, W) float32 m
    uv: Tensor  # (N, 2) float64
    descriptors: Array  # (N, 32) uint8
    P: Tensor  # (N, 3) float64 m


class FeatureFront:
    """Finds the pose of a frame from the keyframes' ORB features."""

    def __init__(self, config: FeatureConfig) -> None:
        self.config = config
        self._orb = cv2.ORB.create(nfeatures=config.features, fastThreshold=10)
        self._matcher = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)

    def prepare(self, frame: RgbdFrame) -> Features | str:
        """ORB features on surfaces."""
        gray = frame.gray.round().clamp(0, 255).to(torch.uint8).numpy()
        keypoints, descriptors = self._orb.detectAndCompute(gray, None)
        if descriptors is None:
            return "no ORB feature in the image"
        uv = torch.tensor([point.pt for point in keypoints], dtype=torch.float64)
        d = surface_inverse_depth(frame.depth, uv)
        usable = torch.isfinite(d)
        if int(usable.sum()) < self.config.min_matches:
            return f"only {int(usable.sum())} ORB features have a depth"
        P = backproject(frame.camera, uv[usable], d[usable])
        return Features(frame.camera, gray, frame.depth, uv[usable], descriptors[usable.numpy()], P)

    def fit(self, keyframes: Sequence[Keyframe[Features]], current: Features, guess: Tensor) -> Fit:
        """PnP on matches with the newest keyframe, then all keyframes' points at sub-pixel places."""
        newest = keyframes[-1]
        matched = self._match(newest.data, current, guess @ newest.T_world_cam)
        if isinstance(matched, str):
            return Fit(guess, matched)
        T_cam_world = matched @ inverse(newest.T_world_cam)
        found = [self._look_up(keyframe, current, T_cam_world) for keyframe in keyframes]
        P_world, uv = torch.cat([P for P, _ in found]), torch.cat([uv for _, uv in found])  # (N, 3), (N, 2)
        if len(uv) < self.config.min_matches:
            return Fit(guess, f"only {len(uv)} points of the keyframes are found again")
        fit = self._refine(P_world, uv, current, T_cam_world)
        share = len(found[-1][0]) / len(newest.data.uv)
        return Fit(fit.T_cam_world, fit.reason, fit.information, fit.points, fit.iterations, share)

    def _match(self, keyframe: Features, current: Features, T_guess: Tensor) -> Tensor | str:
        """T_cam_kf (4, 4) from matches of two frames, by PnP inside RANSAC from a guess."""
        matches = [
            m
            for m in self._matcher.match(keyframe.descriptors, current.descriptors)
            if m.distance < self.config.max_hamming
        ]
        if len(matches) < self.config.min_matches:
            return f"only {len(matches)} ORB matches"
        P = keyframe.P[[m.queryIdx for m in matches]].numpy()
        uv = current.uv[[m.trainIdx for m in matches]].numpy()
        rotation, _ = cv2.Rodrigues(T_guess[:3, :3].numpy())
        translation = T_guess[:3, 3:].numpy().copy()
        cv2.setRNGSeed(0)
        found, rotation, translation, inliers = cv2.solvePnPRansac(
            P, uv, current.camera.matrix().numpy(), None, rotation, translation, True, 100, self.config.ransac_px, 0.99
        )
        if not found or inliers is None or len(inliers) < self.config.min_matches:
            return f"only {0 if inliers is None else len(inliers)} of {len(matches)} ORB matches agree on a motion"
        T = torch.eye(4, dtype=torch.float64)
        T[:3, :3] = torch.from_numpy(cv2.Rodrigues(rotation)[0])
        T[:3, 3] = torch.from_numpy(np.asarray(translation).reshape(3))
        return T

    def _look_up(self, keyframe: Keyframe[Features], current: Features, T_cam_world: Tensor) -> tuple[Tensor, Tensor]:
        """World points (N, 3) of a keyframe and where they are in the frame (N, 2), by a search from where they
        should be."""
        config, camera, data = self.config, current.camera, keyframe.data
        predicted, valid = project(camera, transform(T_cam_world @ keyframe.T_world_cam, data.P))
        index = torch.nonzero(valid & inside(camera, predicted, config.window))[:, 0]
        if len(index) == 0:
            return torch.empty(0, 3, dtype=torch.float64), torch.empty(0, 2, dtype=torch.float64)
        begin, start = (x[index].float().numpy() for x in (data.uv, predicted))
        uv, status, difference = cv2.calcOpticalFlowPyrLK(
            data.gray, current.gray, begin, start.copy(), winSize=(config.window, config.window), maxLevel=1,
            criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.01), flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        )  # fmt: skip
        close = np.linalg.norm(uv - start, axis=1) < config.search_px
        good = torch.from_numpy((status[:, 0] > 0) & close & (difference[:, 0] < config.max_difference))
        return transform(keyframe.T_world_cam, data.P[index[good]]), torch.from_numpy(uv).double()[good]

    def _refine(self, P_world: Tensor, uv: Tensor, current: Features, T_cam_world: Tensor) -> Fit:
        """Gauss-Newton on reprojection and, where there is a surface, inverse depth, both with t weights."""
        config, camera = self.config, current.camera
        measured = surface_inverse_depth(current.depth, uv, half=2)
        on_surface = torch.isfinite(measured)
        H, squared = torch.eye(6, dtype=torch.float64), torch.zeros(len(uv), dtype=torch.float64)
        iterations = 0
        for _ in range(config.iterations):
            iterations += 1
            P = transform(T_cam_world, P_world)
            projected, _ = project(camera, P)
            z = P[:, 2]
            r_uv = (projected - uv) / config.sigma_px  # (N, 2)
            r_d = torch.where(on_surface, 1 / z - measured, 0.0) / config.sigma_inverse_depth  # (N,)
            dd_dP = torch.nn.functional.pad(-1 / z[:, None, None] ** 2, (2, 0))  # (N, 1, 3)
            J_uv = twist_jacobian(duv_dP(camera, P) / config.sigma_px, P)  # (N, 2, 6)
            J_d = twist_jacobian(dd_dP / config.sigma_inverse_depth, P)  # (N, 1, 6)
            squared = r_uv.square().sum(1)
            weight_uv = student_weight(squared, config.freedom, 2)[:, None].expand(-1, 2)
            weight_d = student_weight(r_d.square(), config.freedom, 1) * on_surface
            J = torch.cat([J_uv.reshape(-1, 6), J_d.reshape(-1, 6)])
            r, weight = torch.cat([r_uv.reshape(-1), r_d]), torch.cat([weight_uv.reshape(-1), weight_d])
            H, b = normal_equations(J, r, weight)
            step = solve(H, b)
            if not bool(step.ok):
                return Fit(T_cam_world, step.reason)
            T_cam_world = exp(step.y) @ T_cam_world
            if float(step.y.abs().max()) < 1e-6:
                break
        return Fit(T_cam_world, "", H, int((squared < 9).sum()), iterations)


RULE = KeyframeRule(keep=3)


def make() -> KeyframeOdometry[Features]:
    """Feature-based odometry with a local map of the last keyframes."""
    return KeyframeOdometry(FeatureFront(FeatureConfig()), "features, after ORB-SLAM2", RULE)


def settings() -> str:
    """All settings as TOML."""
    return dump(FeatureConfig()) + dump(RULE) + checked.settings()
