"""A scene made ready for the ray caster: triangles, light baked into the textures, mip-map pyramids."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ..tracker.open3d_loader import load_open3d
from .scenes import Scene
from .surfaces import Array, Surface

Floats = npt.NDArray[np.float32]
Ints = npt.NDArray[np.int64]
GAMMA = 2.2
LEVELS = 8  # of the mip maps
FULL = 65535.0  # stored value of radiance `World.white`


@dataclass(frozen=True)
class World:
    """What the renderer reads. Triangles of all surfaces stand in one mesh."""

    caster: Any  # open3d.t.geometry.RaycastingScene
    uv: Floats  # (T, 3, 2) of each corner, in 0..1 of its texture, (column, row)
    normal: Floats  # (T, 3) outwards
    surface: Ints  # (T,)
    density: Floats  # (S,) texels per metre
    tables: Ints  # (S, LEVELS, 3) start texel, rows, columns of each mip level
    texels: npt.NDArray[np.uint16]  # (N, 3) linear radiance
    white: float  # radiance that is stored as FULL


def build_world(scene: Scene, seed: int, detail: float = 1.0, threads: int = 1) -> World:
    """Tessellate, light and paint a scene; detail scales the textures' resolution (1 for a focal length of 525 px)."""
    surfaces = scene.surfaces
    o3d = load_open3d()
    vertices, triangles, uv, owner = _tessellate(surfaces)
    caster = o3d.t.geometry.RaycastingScene(nthreads=threads)
    caster.add_triangles(
        o3d.core.Tensor(np.ascontiguousarray(vertices, np.float32)),
        o3d.core.Tensor(np.ascontiguousarray(triangles, np.uint32)),
    )
    corners = vertices[triangles]
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 1] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    light = _bake(scene, caster, o3d, threads)
    white = max(float(field.max()) for field in light)
    tables, texels = _mip_maps(surfaces, light, white, seed, detail)
    return World(
        caster=caster,
        uv=uv.astype(np.float32),
        normal=normal.astype(np.float32),
        surface=owner,
        density=np.array([s.density * detail for s in surfaces], np.float32),
        tables=tables,
        texels=texels,
        white=white,
    )


def _tessellate(surfaces: list[Surface]) -> tuple[Array, Ints, Array, Ints]:
    """Vertices (V, 3), triangles (T, 3), texture coordinates (T, 3, 2) and owning surface (T,)."""
    vertices, triangles, uv, owner, base = [], [], [], [], 0
    for index, surface in enumerate(surfaces):
        R, C = surface.grid.shape[:2]
        vertices.append(surface.grid.reshape(-1, 3))
        r, c = (x.ravel() for x in np.meshgrid(np.arange(R - 1), np.arange(C - 1), indexing="ij"))
        a, b, d, e = r * C + c, r * C + c + 1, (r + 1) * C + c, (r + 1) * C + c + 1
        cells = np.concatenate([np.stack([a, b, e], 1), np.stack([a, e, d], 1)])
        triangles.append(cells + base)
        uv.append(np.stack([(cells % C) / (C - 1), (cells // C) / (R - 1)], -1))
        owner.append(np.full(len(cells), index, np.int64))
        base += R * C
    return np.concatenate(vertices), np.concatenate(triangles), np.concatenate(uv), np.concatenate(owner)


def _bake(scene: Scene, caster: Any, o3d: Any, threads: int) -> list[Floats]:
    """Irradiance of each surface on a coarse grid: lamp and window with soft shadows, and occluded ambient light."""
    sizes, points, normals = [], [], []
    for surface in scene.surfaces:
        cell = 0.04 if max(surface.size) > 0.6 else 0.02
        rows, cols = (int(np.clip(length / cell, 4, 160)) for length in surface.size)
        s, t = (np.arange(n) + 0.5 for n in (rows, cols))
        P, N = _on_grid(surface.grid, s / rows, t / cols)
        sizes.append((rows, cols))
        points.append(P.reshape(-1, 3))
        normals.append(N.reshape(-1, 3))
    N = np.concatenate(normals)
    P = np.concatenate(points) + 0.003 * N

    def free(direction: Array, far: float) -> npt.NDArray[np.bool_]:
        rays = o3d.core.Tensor(np.concatenate([P, np.broadcast_to(direction, P.shape)], 1).astype(np.float32))
        return ~np.asarray(caster.test_occlusions(rays, tnear=0.0, tfar=far, nthreads=threads).numpy(), bool)

    light = np.zeros(len(P))
    low, high = scene.low, scene.high
    middle, size = (low + high) / 2, high - low
    grid = (np.arange(4) + 0.5) / 4 - 0.5
    lamp = np.array([[x * 1.2, y * 1.2, 0] for x in grid for y in grid]) + [middle[0], middle[1], high[2] - 0.15]
    pane = np.array([[0, y * 0.4 * size[1], z * 0.4 * size[2]] for y in grid for z in grid])
    window = pane + [low[0] + 0.05, middle[1], middle[2] + 0.15 * size[2]]
    for samples, facing, power in ((lamp, [0.0, 0.0, -1.0], 3.2), (window, [1.0, 0.0, 0.0], 3.0)):
        for sample in samples:
            ray = sample - P
            square = np.sum(ray * ray, 1)
            received = np.clip(np.sum(ray * N, 1), 0, None) / np.sqrt(square)
            sent = 0.3 + 0.7 * np.clip(-(ray @ np.array(facing)), 0, None) / np.sqrt(square)
            light += power / len(samples) * received * sent * free(ray, 0.99) / (1.0 + square)
    up = (np.arange(16) + 0.5) / 16
    spiral = np.arange(16) * np.pi * (3 - np.sqrt(5))
    ball = np.stack([np.sqrt(1 - (2 * up - 1) ** 2) * f for f in (np.cos(spiral), np.sin(spiral))] + [2 * up - 1], 1)
    ambient, weight = np.zeros(len(P)), np.zeros(len(P))
    for direction in ball:
        cosine = np.clip(N @ direction, 0, None)
        ambient += cosine * free(direction, 0.6)
        weight += cosine
    light += 0.30 * (0.25 + 0.75 * ambient / np.maximum(weight, 1e-9))
    fields, start = [], 0
    for rows, cols in sizes:
        field = light[start : start + rows * cols].reshape(rows, cols).astype(np.float32)
        fields.append(cv2.GaussianBlur(field, (0, 0), 0.7))
        start += rows * cols
    return fields


def _on_grid(grid: Array, s: Array, t: Array) -> tuple[Array, Array]:
    """Points and outward unit normals (len(s), len(t), 3) at fractions s of the rows and t of the columns."""
    R, C = grid.shape[:2]
    r, c = np.minimum((s * (R - 1)).astype(int), R - 2), np.minimum((t * (C - 1)).astype(int), C - 2)
    fr, fc = (s * (R - 1) - r)[:, None, None], (t * (C - 1) - c)[None, :, None]
    a, b = grid[np.ix_(r, c)], grid[np.ix_(r, c + 1)]
    d, e = grid[np.ix_(r + 1, c)], grid[np.ix_(r + 1, c + 1)]
    P = (a * (1 - fc) + b * fc) * (1 - fr) + (d * (1 - fc) + e * fc) * fr
    right, down = (b - a) * (1 - fr) + (e - d) * fr, (d - a) * (1 - fc) + (e - b) * fc
    normal = np.cross(down, right)
    return P, normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)


def _mip_maps(
    surfaces: list[Surface], light: list[Floats], white: float, seed: int, detail: float
) -> tuple[Ints, npt.NDArray[np.uint16]]:
    """All levels of all lit textures in one list of texels (N, 3), and where each begins."""
    tables = np.zeros((len(surfaces), LEVELS, 3), np.int64)
    parts, start = [], 0
    for index, (surface, field) in enumerate(zip(surfaces, light, strict=True)):
        density = surface.density * detail
        h, w = (max(int(np.ceil(length * density)), 4) for length in surface.size)
        albedo = surface.paint(h, w, np.random.default_rng([seed, 5, index]), density)
        irradiance = cv2.resize(field, (w, h), interpolation=cv2.INTER_LINEAR) * np.float32(FULL / white)
        image = cv2.pow(albedo, GAMMA) * irradiance[..., None]
        for level in range(LEVELS):
            h, w = image.shape[:2]
            tables[index, level] = start, h, w
            parts.append((image.reshape(-1, 3) + np.float32(0.5)).astype(np.uint16))
            start += h * w
            if h > 1 or w > 1:
                half = (max(w // 2, 1), max(h // 2, 1))
                image = cv2.resize(image, half, interpolation=cv2.INTER_AREA)
    return tables, np.concatenate(parts)
