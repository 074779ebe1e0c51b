"""Dense RGB-D alignment after DVO (Kerl et al. 2013): all pixels, photometric and depth residual, t-distribution.

Beyond the original: the depth residual is one of inverse depth, whose noise does not grow with distance, and the
brightness may change by a gain and an offset.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
import torch.nn.functional as F
from torch import Tensor

from idrgbdo_torch.definitions.camera import Pinhole
from idrgbdo_torch.definitions.image import gradient, pyramid
from idrgbdo_torch.definitions.se3 import exp, inverse, log
from idrgbdo_torch.definitions.solver import solve
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.text.configfile import dump

from . import checked
from .keyframes import Fit, Keyframe, KeyframeOdometry, KeyframeRule


@dataclass(frozen=True)
class DenseConfig:
    """Defaults of Kerl et al. where they give any."""

    levels: tuple[int, ...] = (3, 2, 1)
    iterations: int = 20  # at most, on each level
    tolerance: float = 1e-4  # m and rad, the last step on the finest level
    freedom: float = 5.0  # degrees of freedom of the t-distribution
    prior: float = 0.05  # m and rad, how far the constant velocity is trusted
    gain: float = 0.1  # how much the brightness may change by a factor
    offset: float = 10.0  # and by a sum, gray levels
    jump: float = 0.05  # of the inverse depth between neighbours, above which there is no surface
    occlusion: float = 0.15  # of the inverse depth, above which it is not the same surface
    min_pixels: int = 200


@dataclass(frozen=True)
class Level:
    """One pyramid level of a frame."""

    camera: Pinhole
    images: Tensor  # (1, 6, H, W) float32: gray, its gradient, inverse depth, its gradient; NaN where there is no depth

    @cached_property
    def points(self) -> tuple[Tensor, Tensor]:
        """For a keyframe: points (N, 3) in m and gray, gradient (3, N) of all pixels on surfaces."""
        v, u = torch.nonzero(torch.isfinite(self.images[0].sum(0)), as_tuple=True)
        pixels, c = self.images[0, :, v, u], self.camera  # (6, N)
        z = 1 / pixels[3]
        return torch.stack([(u - c.cx) / c.fx * z, (v - c.cy) / c.fy * z, z], dim=-1), pixels[:3]


class DenseFront:
    """Aligns all pixels of the newest keyframe with the frame, coarse to fine."""

    def __init__(self, config: DenseConfig) -> None:
        self.config = config

    def prepare(self, frame: RgbdFrame) -> dict[int, Level] | str:
        """The levels of the pyramid that are used."""
        config = self.config
        count = max(config.levels) + 1
        grays = pyramid(frame.gray, count)
        inverse_depth = torch.where(frame.depth > 0, 1 / frame.depth.clamp(min=1e-6), 0.0)
        inverse_depths = [inverse_depth]
        for _ in range(count - 1):
            inverse_depths.append(_halve_surfaces(inverse_depths[-1], config.jump))
        levels = {
            level: _level(frame.camera.at_level(level), grays[level], inverse_depths[level], config.jump)
            for level in config.levels
        }
        pixels = int(torch.isfinite(levels[config.levels[-1]].images[0, 4:].sum(0)).sum())
        return levels if pixels >= config.min_pixels else f"only {pixels} pixels have a usable depth"

    def fit(self, keyframes: Sequence[Keyframe[dict[int, Level]]], current: dict[int, Level], guess: Tensor) -> Fit:
        """Gauss-Newton on T_cam_kf and two brightness parameters; weights and covariance come from the residuals."""
        config, keyframe = self.config, keyframes[-1]
        T_predicted = guess @ keyframe.T_world_cam
        T, affine = T_predicted, torch.zeros(2, dtype=torch.float64)
        prior = torch.tensor(6 * [config.prior**-2] + [config.gain**-2, config.offset**-2], dtype=torch.float64)
        H, iterations, pixels = torch.zeros(8, 8, dtype=torch.float64), 0, 0
        for level in config.levels:
            covariance = torch.tensor([[100.0, 0.0], [0.0, 1e-4]])
            for _ in range(config.iterations):
                iterations += 1
                r, J = _linearise(keyframe.data[level], current[level], T, affine, config.occlusion)
                pixels = r.shape[1]
                if pixels < config.min_pixels >> level:
                    return Fit(guess, f"only {pixels} pixels of the keyframe are seen again on level {level}")
                H, b, covariance = _normal_equations(r, J, covariance, config.freedom)
                distance = torch.cat([log(T @ inverse(T_predicted)), affine])
                step = solve(H + prior.diag(), b - prior * distance)
                if not bool(step.ok):
                    return Fit(guess, step.reason)
                T, affine = exp(step.y[:6]) @ T, affine + step.y[6:]
                if float(step.y[:6].abs().max()) < config.tolerance * 2.0 ** (level - config.levels[-1]):
                    break
        share = pixels / len(keyframe.data[config.levels[-1]].points[0])
        return Fit(T @ inverse(keyframe.T_world_cam), "", H[:6, :6], pixels, iterations, share)


RULE = KeyframeRule()


def make() -> KeyframeOdometry[dict[int, Level]]:
    """Dense odometry, frame to keyframe."""
    return KeyframeOdometry(DenseFront(DenseConfig()), "dense, after DVO", RULE)


def settings() -> str:
    """All settings as TOML."""
    return dump(DenseConfig()) + dump(RULE) + checked.settings()


def _level(camera: Pinhole, gray: Tensor, inverse_depth: Tensor, jump: float) -> Level:
    d = torch.where(inverse_depth > 0, inverse_depth, torch.nan)
    g_d = gradient(d)
    g_d[:, 0], g_d[:, -1], g_d[:, :, 0], g_d[:, :, -1] = (torch.nan for _ in range(4))
    g_d = torch.where(g_d.abs().amax(0) < jump * d, g_d, torch.nan)
    images = torch.cat([gray[None], gradient(gray), d[None], g_d])  # (6, H, W)
    return Level(camera, images[None])


def _halve_surfaces(inverse_depth: Tensor, jump: float) -> Tensor:
    """Means of the valid among 2x2 inverse depths, where at least two are valid and all of one surface; else 0."""
    height, width = (n // 2 * 2 for n in inverse_depth.shape)
    four = F.pixel_unshuffle(inverse_depth[None, :height, :width], 2)  # (4, H/2, W/2)
    valid = four > 0
    high, low = four.amax(0), torch.where(valid, four, torch.inf).amin(0)
    count = valid.sum(0)
    return torch.where((count >= 2) & (high <= (1 + jump) * low), four.sum(0) / count.clamp(min=1), 0.0)


def _linearise(reference: Level, current: Level, T: Tensor, affine: Tensor, occlusion: float) -> tuple[Tensor, Tensor]:
    """Residuals (2, N) in gray levels and 1/m of the pixels seen in both, and their Jacobians (2, 8, N) float32.

    The columns are the left increment [v, w] of T_cam_kf, brightness gain and offset. The photometric gradient is the
    mean of both images', which converges in fewer steps (Malis 2004).
    """
    c, (height, width) = current.camera, current.images.shape[2:]
    R, t = T[:3, :3].float(), T[:3, 3].float()
    P, gray = reference.points
    P = P @ R.T + t
    x, y, z = P.unbind(-1)
    iz = 1 / z
    u, v = c.fx * x * iz + c.cx, c.fy * y * iz + c.cy
    grid = torch.stack([(2 * u + 1) / width - 1, (2 * v + 1) / height - 1], dim=-1)
    sampled = F.grid_sample(current.images, grid[None, None], align_corners=False)[0, :, 0]  # (6, N)
    inside = (z > 0.1) & (u > 1) & (v > 1) & (u < width - 2) & (v < height - 2)
    same = (sampled[3] - iz).abs() < occlusion * iz  # false for NaN
    seen = torch.nonzero(inside & same & torch.isfinite(sampled[4] + sampled[5]))[:, 0]
    sampled, (gray, g_u0, g_v0) = sampled[:, seen], gray[:, seen]
    x, y, z, iz = x[seen], y[seen], z[seen], iz[seen]
    gain, offset = 1 + float(affine[0]), float(affine[1])
    r = torch.stack([sampled[0] - gain * gray - offset, sampled[3] - iz])
    g_u = torch.stack([(sampled[1] + g_u0) / 2, sampled[4]]) * (c.fx * iz)  # dr/dx, (2, N)
    g_v = torch.stack([(sampled[2] + g_v0) / 2, sampled[5]]) * (c.fy * iz)
    g_z = -(g_u * x + g_v * y) * iz
    g_z[1] += iz * iz
    zero, one = torch.zeros_like(iz), torch.ones_like(iz)
    brightness = torch.stack([torch.stack([-gray, -one]), torch.stack([zero, zero])])  # (2, 2, N)
    dr_dxi = torch.stack([g_u, g_v, g_z, g_z * y - g_v * z, g_u * z - g_z * x, g_v * x - g_u * y], dim=1)  # (2, 6, N)
    return r, torch.cat([dr_dxi, brightness], dim=1)


def _normal_equations(r: Tensor, J: Tensor, covariance: Tensor, freedom: float) -> tuple[Tensor, Tensor, Tensor]:
    """H (8, 8), b (8,) float64 under a bivariate t-distribution, and its scale matrix (2, 2) by fixed-point steps."""
    pixels = r.shape[1]
    for _ in range(3):
        precision = torch.linalg.inv(covariance)
        weight = (freedom + 2) / (freedom + (r * (precision @ r)).sum(0))
        covariance = (r * weight) @ r.T / pixels + torch.diag(torch.tensor([1e-2, 1e-8]))  # a floor for perfect images
    precision = torch.linalg.inv(covariance)
    weight = (freedom + 2) / (freedom + (r * (precision @ r)).sum(0))
    L = torch.linalg.cholesky(precision)  # whitens: L^T r
    white_r, white_J = L.T @ r, torch.einsum("ij,ikn->jkn", L, J)
    weighted = white_J * weight
    H = sum((weighted[i] @ white_J[i].T for i in range(2)), torch.zeros(8, 8))
    b = -sum((weighted[i] @ white_r[i] for i in range(2)), torch.zeros(8))
    return H.double(), b.double(), covariance
