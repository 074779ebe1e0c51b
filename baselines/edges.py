"""Edge alignment after Canny-VO (Zhou, Li and Kneip 2019): Canny edges, a nearest-neighbour field, robust Gauss-Newton.

Beyond the original: edges are placed to a fraction of a pixel, and the Canny thresholds follow the image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import torch
from torch import Tensor

from idrgbdo_torch.definitions.camera import Pinhole, backproject, duv_dP, project
from idrgbdo_torch.definitions.image import pyramid, sample_bilinear
from idrgbdo_torch.definitions.se3 import exp, inverse, transform
from idrgbdo_torch.definitions.solver import normal_equations, solve
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.text.configfile import dump

from . import checked
from .geometry import student_weight, surface_inverse_depth, twist_jacobian
from .keyframes import Fit, Keyframe, KeyframeOdometry, KeyframeRule

BORDER = 3  # px
MAD_TO_SIGMA = 1.4826  # of a Gaussian


@dataclass(frozen=True)
class EdgeConfig:
    """Edge detection in gray levels per px, and the alignment's schedule in px."""

    blur: float = 1.0  # px, before the gradient
    pixels: float = 0.1  # share of the image above the upper Canny threshold
    min_gradient: float = 1.5  # gray levels per px, the lowest that threshold becomes
    max_gradient: float = 10.0  # and the highest
    low: float = 0.5  # lower over upper threshold
    points: int = 6000  # of a keyframe, before those without a surface are left out
    rounds: tuple[tuple[int, float], ...] = ((2, 12.0), (1, 6.0), (0, 6.0), (0, 3.0))  # level, and how far in its px
    iterations: int = 8  # at most, in each round
    tolerance: float = 3e-5  # m and rad, on the finest level
    alignment: float = 0.8  # least cosine between the directions of two edges
    freedom: float = 5.0  # of the t-distribution
    min_sigma: float = 0.1  # px
    min_points: int = 100


@dataclass(frozen=True)
class Edges:
    """The edge pixels of one pyramid level of a frame."""

    camera: Pinhole
    level: int
    frame: RgbdFrame
    mask: Tensor  # (H, W) bool
    uv: Tensor  # (M, 2) float64, to a fraction of a pixel, in the order of the mask's pixels
    normal: Tensor  # (M, 2) float64, unit, up the gradient
    most: int  # EdgeConfig.points

    @cached_property
    def points(self) -> tuple[Tensor, Tensor]:
        """For a keyframe: indices (N,) of evenly thinned pixels on surfaces, and their points (N, 3) float64, m."""
        picks = torch.linspace(0, len(self.uv) - 1, min(len(self.uv), self.most)).long()
        d = surface_inverse_depth(self.frame.depth, (self.uv[picks] + 0.5) * 2**self.level - 0.5)
        index = torch.nonzero(torch.isfinite(d))[:, 0]
        return picks[index], backproject(self.camera, self.uv[picks[index]], d[index])

    @cached_property
    def nearest(self) -> Tensor:
        """(H, W) the nearest edge pixel of every pixel, as an index into uv."""
        blank = (~self.mask).to(torch.uint8).numpy()
        _, labels = cv2.distanceTransformWithLabels(blank, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
        edge_of_label = np.zeros(int(labels.max()) + 1, dtype=np.int64)
        edge_of_label[labels[self.mask.numpy()]] = np.arange(len(self.uv))
        return torch.from_numpy(edge_of_label[labels])


class EdgeFront:
    """Aligns the newest keyframe's edges in space with the frame's edges in the image."""

    def __init__(self, config: EdgeConfig) -> None:
        self.config = config

    def prepare(self, frame: RgbdFrame) -> dict[int, Edges] | str:
        """Canny edges on all levels that are used."""
        config = self.config
        levels = sorted({level for level, _ in config.rounds})
        grays = pyramid(frame.gray, levels[-1] + 1)
        edges = {
            level: Edges(frame.camera.at_level(level), level, frame, *_detect(grays[level], config), config.points)
            for level in levels
        }
        usable = int((edges[levels[0]].mask & (frame.depth[:: 2 ** levels[0], :: 2 ** levels[0]] > 0)).sum())
        return edges if usable >= config.min_points else f"only {usable} edge pixels have a depth"

    def fit(self, keyframes: Sequence[Keyframe[dict[int, Edges]]], current: dict[int, Edges], guess: Tensor) -> Fit:
        """Gauss-Newton on the distances from the projected points to the nearest edges, along these edges' normals."""
        config, keyframe = self.config, keyframes[-1]
        T = guess @ keyframe.T_world_cam  # T_cam_kf
        H, iterations, points, known = torch.eye(6, dtype=torch.float64), 0, 0, 1
        for level, reach in config.rounds:
            known = max(len(keyframe.data[level].points[0]), 1)
            for _ in range(config.iterations):
                iterations += 1
                r, J = _linearise(keyframe.data[level], current[level], T, reach, config.alignment)
                points = len(r)
                if points < config.min_points >> level:
                    return Fit(guess, f"only {points} edge pixels of level {level} are within {reach:g} px of an edge")
                sigma = (MAD_TO_SIGMA * r.abs().median()).clamp(min=config.min_sigma)
                H, b = normal_equations(J, r, student_weight((r / sigma).square(), config.freedom, 1) / sigma**2)
                step = solve(H, b)
                if not bool(step.ok):
                    return Fit(guess, step.reason)
                T = exp(step.y) @ T
                if float(step.y.abs().max()) < config.tolerance * 4.0**level:
                    break
        T_cam_world = T @ inverse(keyframe.T_world_cam)
        return Fit(T_cam_world, "", H, points, iterations, points / known)


RULE = KeyframeRule(share=0.35)


def make() -> KeyframeOdometry[dict[int, Edges]]:
    """Edge odometry, frame to keyframe."""
    return KeyframeOdometry(EdgeFront(EdgeConfig()), "edges, after Canny-VO", RULE)


def settings() -> str:
    """All settings as TOML."""
    return dump(EdgeConfig()) + dump(RULE) + checked.settings()


def _detect(gray: Tensor, config: EdgeConfig) -> tuple[Tensor, Tensor, Tensor]:
    """The mask (H, W) of edge pixels, their places (M, 2) and unit normals (M, 2)."""
    blurred = cv2.GaussianBlur(gray.numpy(), (0, 0), config.blur)
    g_u, g_v = (cv2.Scharr(blurred, cv2.CV_32F, *order) / 32 for order in ((1, 0), (0, 1)))
    strength = cv2.magnitude(g_u, g_v)
    high = float(np.clip(np.quantile(strength[::4, ::4], 1 - config.pixels), config.min_gradient, config.max_gradient))
    fixed_u, fixed_v = (np.round(g * 32).astype(np.int16) for g in (g_u, g_v))
    edges = cv2.Canny(fixed_u, fixed_v, 32 * config.low * high, 32 * high, L2gradient=True)
    mask = torch.zeros(gray.shape, dtype=torch.bool)
    inner = (slice(BORDER, -BORDER), slice(BORDER, -BORDER))
    mask[inner] = torch.from_numpy(edges)[inner] > 0
    v, u = torch.nonzero(mask, as_tuple=True)
    g = torch.stack([torch.from_numpy(g_u)[v, u], torch.from_numpy(g_v)[v, u]], dim=-1).double()
    normal = g / g.norm(dim=1, keepdim=True).clamp(min=1e-9)
    uv = torch.stack([u, v], dim=-1).double()
    ahead, _ = sample_bilinear(torch.from_numpy(strength).double(), uv + normal)
    behind, _ = sample_bilinear(torch.from_numpy(strength).double(), uv - normal)
    bend = ahead - 2 * torch.from_numpy(strength).double()[v, u] + behind
    peak = torch.where(bend < -1e-3, (behind - ahead) / (2 * bend.clamp(max=-1e-3)), 0.0).clamp(-0.7, 0.7)
    return mask, uv + peak[:, None] * normal, normal


def _linearise(reference: Edges, current: Edges, T: Tensor, reach: float, alignment: float) -> tuple[Tensor, Tensor]:
    """Distances (N,) in px to the nearest edge of the same direction within reach, and their Jacobian (N, 6)."""
    camera = current.camera
    index, P = reference.points
    P = transform(T, P)
    uv, valid = project(camera, P)
    u, v = uv.round().long().unbind(-1)
    valid &= (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    seen = torch.nonzero(valid)[:, 0]
    edge = current.nearest[v[seen], u[seen]]
    offset, normal = uv[seen] - current.uv[edge], current.normal[edge]
    turned = reference.normal[index[seen]] @ T[:2, :2].T  # by the rotation about the optical axis
    cosine = (turned * normal).sum(1) / turned.norm(dim=1)
    good = (cosine > alignment) & (offset.norm(dim=1) < reach)
    offset, normal, P = offset[good], normal[good], P[seen[good]]
    dr_dP = (normal[:, None, :] @ duv_dP(camera, P))[:, 0]  # (N, 3)
    return (offset * normal).sum(1), twist_jacobian(dr_dP, P)
