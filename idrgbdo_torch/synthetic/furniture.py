"""What stands in the rooms: a table, cabinets along the walls, and clutter."""

from __future__ import annotations

from functools import partial

import numpy as np

from . import textures as tx
from .layout import Layout
from .surfaces import Array, Paint, Surface, box, cylinder, sphere, turned
from .textures import Rng

FINE = 560.0  # texels per metre of things that may come as near as 0.6 m


def table(layout: Layout, paint: Paint, density: float = FINE) -> list[Surface]:
    """The table: a top and four legs."""
    x0, y0, x1, y1 = layout.table
    grids = box([(x0 + x1) / 2, (y0 + y1) / 2, layout.table_z - 0.04], [x1 - x0, y1 - y0, 0.04], 0.0)
    under = layout.table_z - 0.04 - layout.low[2]
    for x in (x0 + 0.06, x1 - 0.06):
        for y in (y0 + 0.06, y1 - 0.06):
            grids += box([x, y, layout.low[2]], [0.07, 0.07, under], 0.0)[1:]
    return [Surface(grid, paint, density) for grid in grids]


def cabinets(layout: Layout, rng: Rng) -> list[Surface]:
    """Bookshelves and chests along the walls, off the camera's path, with a few things on top."""
    surfaces: list[Surface] = []
    x0, y0, x1, y1 = *layout.low[:2], *layout.high[:2]
    walls = (((x0, y1), 0.0, x1 - x0), ((x1, y1), -np.pi / 2, y1 - y0), ((x1, y0), np.pi, x1 - x0))
    for corner, yaw, length in (*walls, ((x0, y0), np.pi / 2, y1 - y0)):
        along, into = turned(yaw)
        position = rng.uniform(0.3, 0.8)
        while position < length - 0.8:
            width, deep, height = rng.uniform(0.6, 1.1), rng.uniform(0.28, 0.36), rng.uniform(0.6, 1.7)
            base = np.array([*corner, layout.low[2]]) + (position + width / 2) * along - (deep / 2 + 0.005) * into
            if layout.is_free(base[0], base[1], deep / 2, layout.low[2] + height, near=0.7):
                layout.taken += [(*(base + k * width / 3 * along)[:2], deep / 2) for k in (-1, 0, 1)]
                body = partial(tx.wood, color=tx.random_color(rng, 0.25, 0.7, 0.5))
                shelf = rng.random() < 0.6
                for side, grid in enumerate(box(base, [width, deep, height], yaw)):
                    surfaces.append(Surface(grid, tx.spines if shelf and side else body, 400.0))
                on_top = base + [0, 0, height]
                for k in (-0.3, 0.0, 0.3):
                    place = on_top + k * width * along
                    if rng.random() < 0.7 and layout.distance(place[0], place[1], place[2] + 0.35) > 0.8:
                        surfaces += thing(place, 0.11, 0.35, rng)
            position += width + rng.uniform(0.15, 0.9)
    return surfaces


def clutter(layout: Layout, rng: Rng, count: int) -> list[Surface]:
    """Up to `count` things on the table, and cartons on the floor, where the camera looks."""
    surfaces: list[Surface] = []
    placed = 0
    for _ in range(12 * count):
        if placed >= count:
            break
        x, y = layout.seen(rng)
        if layout.on_table(x, y):
            base, radius, tall = layout.table_z, float(rng.choice([0.05, 0.08, 0.12, 0.17])), 0.4
        else:
            base, radius, tall = layout.low[2], float(rng.uniform(0.15, 0.3)), 1.0
        room_above = next((h for h in (tall, 0.6 * tall, 0.3 * tall) if layout.is_free(x, y, radius, base + h)), None)
        if room_above is None or (base == layout.low[2] and layout.on_table(x, y, -radius)):
            continue
        layout.taken.append((x, y, radius))
        place = np.array([x, y, base])
        surfaces += (
            thing(place, radius, room_above, rng) if base > layout.low[2] else carton(place, radius, room_above, rng)
        )
        placed += 1
    return surfaces


def carton(base: Array, radius: float, tall: float, rng: Rng) -> list[Surface]:
    """A printed box that fills its circle."""
    a = radius * rng.uniform(1.0, 1.5)
    b = 2 * np.sqrt(max(radius**2 - a**2 / 4, 0.01 * radius))
    grids = box(base, [a, b, tall * rng.uniform(0.4, 0.95)], float(rng.uniform(0, 2 * np.pi)))
    return [Surface(g, tx.cover, FINE) for g in grids]


def thing(base: Array, radius: float, tall: float, rng: Rng) -> list[Surface]:
    """A carton, a stack of books, a tin, a ball, a screen or a paper, within the radius and not above `tall`."""
    style = rng.random()
    yaw = float(rng.uniform(0, 2 * np.pi))
    if style < 0.25:
        return carton(base, radius, tall, rng)
    if style < 0.55:
        surfaces, z = [], 0.0
        for _ in range(int(rng.integers(1, 6))):
            thick = float(rng.uniform(0.012, 0.045))
            if z + thick > tall:
                break
            size = [1.5 * radius, 1.1 * radius, thick]
            grids = box(base + [*rng.normal(0, 0.006, 2), z], size, yaw + rng.normal(0, 0.15))
            surfaces += [Surface(g, tx.cover, FINE) for g in grids]
            z += thick
        return surfaces
    if style < 0.75:
        r = min(radius * 0.8, 0.09)
        side, top = cylinder(base, r, tall * rng.uniform(0.3, 0.8))
        return [Surface(side, tx.label, FINE), Surface(top, tx.stripes, FINE)]
    if style < 0.85:
        r = min(radius * 0.9, tall / 2)
        paint: Paint = tx.checker if rng.random() < 0.5 else tx.stripes
        return [Surface(sphere(base + [0, 0, r], r), paint, FINE)]
    if style < 0.93 and radius > 0.1:
        stand = cylinder(base, 0.5 * radius, 0.02)
        screen = box(base + [0, 0, 0.02], [1.7 * radius, 0.04, min(1.2 * radius, tall)], yaw)
        black = partial(tx.plain, color=[0.1, 0.1, 0.11])
        return [Surface(g, black, FINE) for g in stand] + [Surface(g, tx.poster, FINE) for g in screen]
    return [Surface(g, tx.poster, FINE) for g in box(base, [1.3 * radius, 1.5 * radius, 0.004], yaw)]
