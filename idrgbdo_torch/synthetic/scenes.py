"""The kinds of scenes, after the TUM freiburg3 set, each built around a camera path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from . import textures as tx
from .config import Kind
from .furniture import cabinets, clutter, table
from .layout import Layout, fit_room
from .surfaces import Array, Paint, Surface, box, cylinder, rectangle, room
from .textures import Image, Rng

WALL = 350.0  # texels per metre: walls are seen from a metre on


@dataclass(frozen=True)
class Scene:
    """Surfaces that close a space, and the corners (3,) of the part that its lamps light."""

    surfaces: list[Surface]
    low: Array
    high: Array


def build_scene(kind: Kind, T_scene_cam: Array, seed: int) -> Scene:
    """A scene of this kind around a camera path (N, 4, 4), z up."""
    rng = np.random.default_rng([seed, 1])
    return SCENES[kind](fit_room(T_scene_cam, rng), rng)


def _desk(layout: Layout, rng: Rng) -> Scene:
    """A cluttered table in a furnished room with prints on its walls."""
    walls = room(layout.low, layout.high)
    surfaces = [Surface(grid, FURNISHED.get(name, _papered_wall), WALL) for name, grid in walls.items()]
    surfaces += table(layout, partial(tx.wood, color=[0.55, 0.4, 0.26]))
    surfaces += cabinets(layout, rng)
    return Scene(surfaces + clutter(layout, rng, 90), layout.low, layout.high)


def _poor(layout: Layout, rng: Rng) -> Scene:
    """Bare walls and furniture: weak shading and few edges."""
    walls = room(layout.low, layout.high)
    surfaces = [Surface(grid, BARE.get(name, _bare_wall), WALL / 2) for name, grid in walls.items()]
    surfaces += table(layout, partial(tx.plain, color=tx.random_color(rng, 0.5, 0.65, 0.3)), WALL)
    for _ in range(300):
        if len(layout.taken) >= 9:
            break
        x, y = layout.seen(rng)
        size = rng.uniform(0.08, 0.3, 3)
        radius = float(np.hypot(size[0], size[1])) / 2
        base = layout.table_z if layout.on_table(x, y, radius) else layout.low[2]
        if base == layout.low[2] and layout.on_table(x, y, -radius):
            continue
        if layout.is_free(x, y, radius, base + size[2]):
            layout.taken.append((x, y, radius))
            paint = partial(tx.plain, color=tx.random_color(rng, 0.4, 0.75, 0.3))
            surfaces += [Surface(g, paint, WALL) for g in box([x, y, base], size, float(rng.uniform(0, np.pi)))]
    return Scene(surfaces, layout.low, layout.high)


def _structure_texture(layout: Layout, rng: Rng) -> Scene:
    return _structure(layout, rng, _printed, WALL)


def _structure_notexture(layout: Layout, rng: Rng) -> Scene:
    return _structure(layout, rng, _white, WALL / 4)


def _structure(layout: Layout, rng: Rng, paint: Paint, density: float) -> Scene:
    """Folded panels for walls, boxes, steps and columns."""
    outer = room(layout.low, layout.high)
    surfaces = [Surface(outer[name], paint, density) for name in ("floor", "ceiling")]
    depth = 0.35
    for name in ("north", "south", "east", "west"):
        surfaces += [Surface(g, paint, density) for g in _folded(outer[name], depth, rng)]
    for _ in range(400):
        if len(layout.taken) >= 14:
            break
        x, y = layout.seen(rng)
        height = max(layout.table_z - layout.low[2] + rng.uniform(-0.35, 0.35), 0.2)
        a, b, yaw = (float(v) for v in rng.uniform([0.25, 0.25, 0.0], [0.7, 0.7, np.pi]))
        column = rng.random() < 0.25
        radius = a / 2 if column else float(np.hypot(a, b)) / 2
        if layout.is_free(x, y, radius, layout.low[2] + height):
            layout.taken.append((x, y, radius))
            base = [x, y, layout.low[2]]
            grids = cylinder(base, radius, height, 40) if column else box(base, [a, b, height], yaw)
            surfaces += [Surface(g, paint, 1.5 * density) for g in grids]
    inset = np.array([depth, depth, 0.0])
    return Scene(surfaces, layout.low + inset, layout.high - inset)


def _nostructure_texture(layout: Layout, rng: Rng) -> Scene:
    """One large printed plane across the mean viewing direction, closed by a printed box behind the camera."""
    forward = layout.rotations[:, :, 2].mean(0)
    z = forward / np.linalg.norm(forward)
    x = np.cross(z, [0.0, 0.0, 1.0] if abs(z[2]) < 0.95 else [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    axes = np.stack([x, np.cross(z, x), z])  # rows: right, down, forward
    reach = layout.positions @ axes.T
    low, high = reach.min(0) - [2.6, 2.6, 2.0], reach.max(0) + [2.6, 2.6, 1.25]
    r, d, f = ((high - low)[k] * axes[k] for k in range(3))
    corner = low @ axes
    surfaces = [Surface(rectangle(corner + f, r, d), _printed, 450.0)]
    behind, left, right = rectangle(corner + r, -r, d), rectangle(corner, f, d), rectangle(corner + f + r, -f, d)
    above, below = rectangle(corner, r, f), rectangle(corner + f + d, r, -f)
    surfaces += [Surface(grid, partial(_printed, per_m2=4.0), WALL / 2) for grid in (behind, left, right, above, below)]
    middle = reach.mean(0) @ axes
    return Scene(surfaces, middle - 1.0, middle + 1.0)  # lamps near the path, in front of the plane


SCENES: dict[Kind, Callable[[Layout, Rng], Scene]] = {
    "desk": _desk,
    "structure_texture": _structure_texture,
    "structure_notexture": _structure_notexture,
    "nostructure_texture": _nostructure_texture,
    "poor": _poor,
}


def _folded(wall: Array, depth: float, rng: Rng) -> list[Array]:
    """A wall (2, 2, 3) as panels that zigzag into the room by up to `depth`, starting and ending on the wall."""
    top, right, down = wall[0, 0], wall[0, 1] - wall[0, 0], wall[1, 0] - wall[0, 0]
    into = np.cross(down, right)
    into /= np.linalg.norm(into)
    folds = 2 * max(int(np.linalg.norm(right) / 1.1), 2)
    share = np.linspace(0, 1, folds + 1)
    share[1:-1] += rng.uniform(-0.2, 0.2, folds - 1) / folds
    inset = np.where(np.arange(folds + 1) % 2 == 1, depth * rng.uniform(0.5, 1.0, folds + 1), 0.0)
    corners = top + share[:, None] * right + inset[:, None] * into
    return [rectangle(a, b - a, down) for a, b in pairwise(corners)]


def _printed(h: int, w: int, rng: Rng, density: float, per_m2: float = 7.0) -> Image:
    """A rough surface with prints pinned all over it."""
    image = tx.rough(h, w, rng, density, tx.random_color(rng, 0.35, 0.7))
    return tx.pinned(image, rng, density, per_m2, 0.15, 0.5)


def _white(h: int, w: int, rng: Rng, density: float) -> Image:
    return tx.plain(h, w, rng, density, tx.random_color(rng, 0.68, 0.78, 0.08), 0.006)


def _papered_wall(h: int, w: int, rng: Rng, density: float) -> Image:
    image = tx.rough(h, w, rng, density, tx.random_color(rng, 0.55, 0.8, 0.3), 0.1)
    return tx.pinned(image, rng, density, 2.2, 0.2, 0.6)


def _bare_wall(h: int, w: int, rng: Rng, density: float) -> Image:
    """A skirting board and a few blank boards, of nearly the wall's colour."""
    image = tx.plain(h, w, rng, density, tx.random_color(rng, 0.62, 0.72, 0.15), 0.03)
    image[-max(int(0.08 * density), 1) :] *= 0.75
    for _ in range(max(2, round(0.5 * h * w / density**2))):
        rows, cols = (int(density * rng.uniform(0.3, 0.7)) for _ in range(2))
        y, x = int(rng.uniform(0.1, 0.5) * h), int(rng.uniform(0.0, 1.0) * max(w - cols, 1))
        image[y : y + rows, x : x + cols] *= 0.86
    return image


FURNISHED: dict[str, Paint] = {
    "floor": lambda h, w, rng, density: tx.rough(h, w, rng, density, tx.random_color(rng, 0.25, 0.5, 0.5), 0.3),
    "ceiling": partial(tx.rough, color=[0.8, 0.8, 0.78], contrast=0.05),
}
BARE: dict[str, Paint] = {
    "floor": partial(tx.plain, color=[0.53, 0.52, 0.51], contrast=0.03),
    "ceiling": partial(tx.plain, color=[0.7, 0.7, 0.69], contrast=0.03),
}
