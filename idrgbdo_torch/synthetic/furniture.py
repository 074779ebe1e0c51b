"""What stands in the rooms: a table, cabinets along the walls, and clutter."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from . import textures as tx
from .layout import Layout
from .surfaces import Array, Paint, Surface, box, cylinder, sheet, sphere, turned
from .textures import Image, Rng

FINE = 650.0  # texels per metre of things that may come as near as 0.6 m


def table(layout: Layout, paint: Paint, density: float = FINE) -> list[Surface]:
    """The table top and four legs."""
    x0, y0, x1, y1 = layout.table
    grids = box([(x0 + x1) / 2, (y0 + y1) / 2, layout.table_z - 0.04], [x1 - x0, y1 - y0, 0.04], 0.0)
    under = layout.table_z - 0.04 - layout.low[2]
    for x in (x0 + 0.06, x1 - 0.06):
        for y in (y0 + 0.06, y1 - 0.06):
            grids += box([x, y, layout.low[2]], [0.07, 0.07, under], 0.0)[1:]
    return [sheet(grid, paint, density) for grid in grids]


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
            layout_free = layout.is_free(base[0], base[1], deep / 2, layout.low[2] + height, near=0.7)
            if layout_free:
                layout.taken += [(*(base + k * width / 3 * along)[:2], deep / 2) for k in (-1, 0, 1)]
                body = tx.random_color(rng, 0.25, 0.7, 0.5)
                shelf = rng.random() < 0.6
                for side, grid in enumerate(box(base, [width, deep, height], yaw)):
                    surfaces.append(sheet(grid, _front(rng) if shelf and side else _wooden(rng, body), 400.0))
                on_top = base + [0, 0, height]
                for k in (-0.3, 0.0, 0.3):
                    place = on_top + k * width * along
                    if rng.random() < 0.7 and layout.distance(place[0], place[1], place[2] + 0.35) > 0.8:
                        surfaces += thing(place, 0.11, rng, 0.35, layout.low[2] - 1)
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
        if room_above is None or (base == layout.low[2] and _under_table(layout, x, y, radius)):
            continue
        layout.taken.append((x, y, radius))
        surfaces += thing(np.array([x, y, base]), radius, rng, room_above, layout.low[2])
        placed += 1
    return surfaces


def thing(base: Array, radius: float, rng: Rng, tall: float, floor: float) -> list[Surface]:
    """A carton, a stack of books, a tin, a ball, a screen or a paper, within the radius and not above `tall`."""
    style = rng.random()
    yaw = float(rng.uniform(0, 2 * np.pi))
    if base[2] == floor or style < 0.25:
        a = radius * rng.uniform(1.0, 1.5)
        size = [a, 2 * np.sqrt(max(radius**2 - a**2 / 4, 0.01 * radius)), tall * rng.uniform(0.4, 0.95)]
        return [sheet(g, _cover(rng), FINE) for g in box(base, size, yaw)]
    if style < 0.55:
        surfaces, z = [], 0.0
        for _ in range(int(rng.integers(1, 6))):
            thick = float(rng.uniform(0.012, 0.045))
            if z + thick > tall:
                break
            size = [1.5 * radius, 1.1 * radius, thick]
            grids = box(base + [*rng.normal(0, 0.006, 2), z], size, yaw + rng.normal(0, 0.15))
            surfaces += [sheet(g, _cover(rng), FINE) for g in grids]
            z += thick
        return surfaces
    if style < 0.75:
        r = min(radius * 0.8, 0.09)
        side, top = cylinder(base, r, tall * rng.uniform(0.3, 0.8))
        return [sheet(side, _label(rng), FINE), sheet(top, _ringed(rng), FINE)]
    if style < 0.85:
        r = min(radius * 0.9, tall / 2)
        return [sheet(sphere(base + [0, 0, r], r), _ball(rng), FINE)]
    if style < 0.93 and radius > 0.1:
        stand = cylinder(base, 0.5 * radius, 0.02)
        screen = box(base + [0, 0, 0.02], [1.7 * radius, 0.04, min(1.2 * radius, tall)], yaw)
        return [sheet(g, _wooden(rng, [0.1, 0.1, 0.11]), FINE) for g in stand] + [
            sheet(g, _printed_sheet(rng), FINE) for g in screen
        ]
    return [sheet(g, _printed_sheet(rng), FINE) for g in box(base, [1.3 * radius, 1.5 * radius, 0.004], yaw)]


def _under_table(layout: Layout, x: float, y: float, radius: float) -> bool:
    return layout.on_table(x, y, -radius)


def _wooden(rng: Rng, color: object) -> Paint:
    return lambda h, w, density: tx.wood(h, w, rng, density, np.asarray(color, np.float32))


def _front(rng: Rng) -> Paint:
    return lambda h, w, density: tx.spines(h, w, rng, density)


def _cover(rng: Rng) -> Paint:
    return lambda h, w, density: tx.cover(h, w, rng, density)


def _printed_sheet(rng: Rng) -> Paint:
    return lambda h, w, density: tx.poster(h, w, rng, density)


def _label(rng: Rng) -> Paint:
    def paint(h: int, w: int, density: float) -> Image:
        image = tx.stripes(h, w, rng)
        tx.draw_shapes(image, rng, 5)
        if h > 20:
            tx.write_text(image[h // 3 : 2 * h // 3], rng, density, 0.02, tx.random_color(rng, 0.0, 1.0))
        return image

    return paint


def _ringed(rng: Rng) -> Paint:
    return lambda h, w, density: tx.stripes(h, w, rng)


def _ball(rng: Rng) -> Paint:
    choice: Callable[[int, int, float], Image] = rng.choice(
        [lambda h, w, d: tx.checker(h, w, rng, d, 0.04), lambda h, w, d: tx.stripes(h, w, rng)]  # type: ignore[arg-type]
    )
    return choice
