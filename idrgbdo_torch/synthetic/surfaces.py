"""What a scene is made of: rectangular point grids that carry a texture."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .textures import Image, Rng

Array = npt.NDArray[np.float64]
Paint = Callable[[int, int, Rng, float], Image]  # rows, columns, random, texels per metre -> albedo (rows, columns, 3)


@dataclass(frozen=True)
class Surface:
    """A bent sheet: grid (R, C, 3) in metres, rows downwards and columns to the right as one looks at its front."""

    grid: Array
    paint: Paint
    density: float  # texels per metre, for a camera of 525 px focal length

    @property
    def size(self) -> tuple[float, float]:
        """Greatest length in metres along the columns (down) and the rows (across)."""
        down = np.linalg.norm(np.diff(self.grid, axis=0), axis=2).sum(0).max()
        across = np.linalg.norm(np.diff(self.grid, axis=1), axis=2).sum(1).max()
        return float(down), float(across)


def rectangle(top_left: npt.ArrayLike, right: npt.ArrayLike, down: npt.ArrayLike) -> Array:
    """(2, 2, 3) grid from a corner and two edge vectors."""
    p, a, b = (np.asarray(v, np.float64) for v in (top_left, right, down))
    return np.array([[p, p + a], [p + b, p + a + b]])


def box(center: npt.ArrayLike, size: npt.ArrayLike, yaw: float) -> list[Array]:
    """Five grids of an upright box without bottom: its top, then four sides; `center` is of its base."""
    c = np.asarray(center, np.float64)
    sx, sy, h = np.asarray(size, np.float64)
    ex, ey = turned(yaw)
    up = np.array([0.0, 0.0, 1.0])
    top = c + h * up
    faces = [rectangle(top - ex * sx / 2 + ey * sy / 2, ex * sx, -ey * sy)]
    for right, out, width, depth in ((ex, -ey, sx, sy), (ey, ex, sy, sx), (-ex, ey, sx, sy), (-ey, -ex, sy, sx)):
        faces.append(rectangle(top + out * depth / 2 - right * width / 2, right * width, -up * h))
    return faces


def cylinder(center: npt.ArrayLike, radius: float, height: float, segments: int = 28) -> list[Array]:
    """Side (2, segments + 1, 3) and top disc (polar, 2 rows) of an upright cylinder; `center` is of its base."""
    c = np.asarray(center, np.float64)
    angle = np.linspace(0, 2 * np.pi, segments + 1)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], 1) * radius
    high = c + ring + [0, 0, height]
    apex = np.broadcast_to(c + [0, 0, height], high.shape)
    return [np.stack([high, c + ring]), np.stack([apex, high])]


def sphere(center: npt.ArrayLike, radius: float, rows: int = 14, columns: int = 28) -> Array:
    """(rows + 1, columns + 1, 3) grid from the upper pole down."""
    polar = np.linspace(0, np.pi, rows + 1)[:, None]
    angle = np.linspace(0, 2 * np.pi, columns + 1)[None]
    unit = np.stack([np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.cos(polar) + 0 * angle], -1)
    return np.asarray(np.asarray(center, np.float64) + radius * unit)


def turned(yaw: float) -> tuple[Array, Array]:
    """The horizontal axes x and y turned by yaw about z."""
    return np.array([np.cos(yaw), np.sin(yaw), 0.0]), np.array([-np.sin(yaw), np.cos(yaw), 0.0])


def room(low: npt.ArrayLike, high: npt.ArrayLike) -> dict[str, Array]:
    """Six grids that face inwards."""
    (x0, y0, z0), (x1, y1, z1) = np.asarray(low, np.float64), np.asarray(high, np.float64)
    dx, dy, dz = x1 - x0, y1 - y0, z1 - z0
    return {
        "north": rectangle([x0, y1, z1], [dx, 0, 0], [0, 0, -dz]),
        "south": rectangle([x1, y0, z1], [-dx, 0, 0], [0, 0, -dz]),
        "east": rectangle([x1, y1, z1], [0, -dy, 0], [0, 0, -dz]),
        "west": rectangle([x0, y0, z1], [0, dy, 0], [0, 0, -dz]),
        "floor": rectangle([x0, y1, z0], [dx, 0, 0], [0, -dy, 0]),
        "ceiling": rectangle([x0, y0, z1], [dx, 0, 0], [0, dy, 0]),
    }
