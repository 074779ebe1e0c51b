"""Images of a world: linear radiance averaged over sub-pixel offsets and the exposure, and exact depth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from ..tracker.open3d_loader import load_open3d
from .config import SynthConfig
from .surfaces import Array
from .world import FULL, LEVELS, Floats, World

Pose = Callable[[float | Array], Array]  # (..., 4, 4) at times (...)


@dataclass(frozen=True)
class Depth:
    """The exact geometry seen through the pixel centres."""

    depth: Floats  # (H, W) m, along the optical axis
    cosine: Floats  # (H, W) of the angle between the surface's normal and the ray


@dataclass(frozen=True)
class Renderer:
    """A world seen through a pinhole camera. Poses are T_scene_cam (4, 4)."""

    world: World
    config: SynthConfig

    def rays(self, T_scene_cam: Array, du: float = 0.0, dv: float = 0.0) -> Floats:
        """(H, W, 6) origins and directions of unit depth through the pixels' centres moved by (du, dv) px.

        T_scene_cam: (4, 4), or (H, 4, 4) where every row sees from a place of its own.
        """
        c = self.config
        R = T_scene_cam[..., :3, :3]
        x, y = (np.arange(c.width) + du - c.cx) / c.fx, (np.arange(c.height) + dv - c.cy) / c.fy
        rays = np.empty((c.height, c.width, 6), np.float32)
        rays[..., :3] = T_scene_cam[..., None, :3, 3]
        for k in range(3):
            across = R[..., k, 0, None] * x + R[..., k, 2, None]  # (W,), or (H, W)
            rays[..., 3 + k] = across.astype(np.float32) + (R[..., k, 1] * y)[:, None].astype(np.float32)
        return rays

    def depth(self, T_scene_cam: Array) -> Depth:
        """Exact depth (pixels that hit nothing get 0) and incidence."""
        rays = self.rays(T_scene_cam)
        t, ids, _ = self._cast(rays)
        hit = np.isfinite(t)
        directions = rays[..., 3:]
        normal = self.world.normal[np.where(hit, ids, 0)]
        cosine = np.abs(np.einsum("hwk,hwk->hw", normal, directions)) / np.linalg.norm(directions, axis=-1)
        return Depth(depth=np.where(hit, t, 0).astype(np.float32), cosine=np.where(hit, cosine, 0).astype(np.float32))

    def radiance(self, pose: Pose, t: float, exposure_s: float, readout_s: float = 0.0) -> Floats:
        """(H, W, 3) mean linear radiance over the pixels and over the exposure centred at t; pose(t) is T_scene_cam.

        readout_s: from the exposure of the first row to that of the last; t is the middle row's.
        """
        c = self.config
        rows_s = readout_s * ((np.arange(c.height) + 0.5) / c.height - 0.5)
        swept = _image_speed(pose(t - exposure_s / 2), pose(t + exposure_s / 2), c.fx) if exposure_s > 0 else 0.0
        samples = int(np.clip(np.ceil(swept / 1.5), c.samples, 3 * c.samples))
        total = np.zeros((c.height, c.width, 3), np.float32)
        w = self.world
        for k, (du, dv) in enumerate(sub_pixels(samples)):
            T = pose(t + exposure_s * ((k + 0.5) / samples - 0.5) + (rows_s if readout_s else 0.0))
            rays = self.rays(T, du, dv)
            depth, ids, bary = self._cast(rays)
            blur = np.float32(1.0 / (c.fx * np.sqrt(min(samples, 4))))
            hits, surfaces = (rays, depth, ids, bary), (w.uv, w.normal, w.surface, w.density)
            _shade(hits, surfaces, (w.tables, w.texels), blur, total)
        return np.asarray(total * np.float32(w.white / (FULL * samples)), np.float32)

    def _cast(self, rays: Floats) -> tuple[Floats, npt.NDArray[np.uint32], Floats]:
        core = load_open3d().core
        hits = self.world.caster.cast_rays(core.Tensor.from_numpy(rays), nthreads=self.config.threads)
        return hits["t_hit"].numpy(), hits["primitive_ids"].numpy(), hits["primitive_uvs"].numpy()


def sub_pixels(samples: int) -> Array:
    """(samples, 2) offsets in pixels whose mean is exactly zero, well spread over the pixel (a rank-1 lattice)."""
    if samples == 4:
        return np.array([[-3, -1], [1, -3], [-1, 3], [3, 1]]) / 8.0
    k = np.arange(samples)
    lattice = np.stack([(k * 0.7548776662) % 1.0, (k * 0.5698402910) % 1.0], 1)
    return np.asarray(lattice - lattice.mean(0))


def _image_speed(T_a: Array, T_b: Array, focal: float) -> float:
    """Pixels that the image moves between two poses, for a scene one metre away."""
    R = T_a[:3, :3].T @ T_b[:3, :3]
    turn = np.sqrt(max(3.0 - np.trace(R), 0.0))
    return float(focal * (turn + np.linalg.norm(T_a[:3, 3] - T_b[:3, 3])))


@njit(cache=True, nogil=True)
def _shade(hits, surfaces, textures, blur, total):  # type: ignore[no-untyped-def]
    """Add to total (H, W, 3) the trilinear texture value of every hit.

    The mip level matches the pixel's footprint on the surface: the geometric mean of its two half axes.
    """
    rays, depth, ids, bary = hits
    uv, normals, owner, density = surfaces
    tables, texels = textures
    H, W = depth.shape
    for i in range(H):
        for j in range(W):
            z = depth[i, j]
            if not np.isfinite(z):
                continue
            k = ids[i, j]
            s = owner[k]
            dx, dy, dz = rays[i, j, 3], rays[i, j, 4], rays[i, j, 5]
            cosine = abs(normals[k, 0] * dx + normals[k, 1] * dy + normals[k, 2] * dz)
            cosine = max(cosine / np.sqrt(dx * dx + dy * dy + dz * dz), 0.05)
            footprint = z * blur * density[s] / np.sqrt(cosine)
            level = min(max(np.log2(max(footprint, 1e-3)), 0.0), LEVELS - 1.001)
            low = int(level)
            b1, b2 = bary[i, j, 0], bary[i, j, 1]
            b0 = np.float32(1.0) - b1 - b2
            x = b0 * uv[k, 0, 0] + b1 * uv[k, 1, 0] + b2 * uv[k, 2, 0]
            y = b0 * uv[k, 0, 1] + b1 * uv[k, 1, 1] + b2 * uv[k, 2, 1]
            for step in range(2):
                part = level - low if step == 1 else 1.0 - (level - low)
                if part == 0.0:
                    continue
                start, h, w = tables[s, low + step, 0], tables[s, low + step, 1], tables[s, low + step, 2]
                tx = min(max(x * w - 0.5, 0.0), w - 1.0)
                ty = min(max(y * h - 0.5, 0.0), h - 1.0)
                c0, r0 = int(tx), int(ty)
                c1, r1 = min(c0 + 1, w - 1), min(r0 + 1, h - 1)
                fx, fy = tx - c0, ty - r0
                a, b = start + r0 * w + c0, start + r0 * w + c1
                d, e = start + r1 * w + c0, start + r1 * w + c1
                wa, wb = part * (1 - fx) * (1 - fy), part * fx * (1 - fy)
                wd, we = part * (1 - fx) * fy, part * fx * fy
                for ch in range(3):
                    total[i, j, ch] += wa * texels[a, ch] + wb * texels[b, ch] + wd * texels[d, ch] + we * texels[e, ch]
