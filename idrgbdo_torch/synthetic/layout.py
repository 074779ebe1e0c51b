"""Where things may stand: a room fitted around a camera path, and free places in what the camera sees."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .surfaces import Array
from .textures import Rng


@dataclass
class Layout:
    """The camera's path (scene frame, z up), the room around it, and the circles that are taken."""

    positions: Array  # (N, 3)
    rotations: Array  # (N, 3, 3) T_scene_cam's
    low: Array  # (3,) corner of the room
    high: Array
    table: tuple[float, float, float, float]  # x0, y0, x1, y1 of its top
    table_z: float
    taken: list[tuple[float, float, float]] = field(default_factory=list)  # x, y, radius

    @property
    def forward(self) -> Array:
        """(N, 3) viewing directions."""
        return self.rotations[:, :, 2]

    def distance(self, x: float, y: float, z: float) -> float:
        """Distance of the path from the vertical segment below (x, y, z)."""
        dx, dy, dz = self.positions[:, 0] - x, self.positions[:, 1] - y, self.positions[:, 2] - z
        return float(np.sqrt(dx**2 + dy**2 + np.clip(dz, 0, None) ** 2).min())

    def is_free(self, x: float, y: float, radius: float, top: float, near: float = 0.6) -> bool:
        """Whether a thing of this radius and top fits: inside the room, off the camera's path, off its neighbours."""
        place = np.array([x, y])
        inside = (self.low[:2] + radius < place).all() and (place < self.high[:2] - radius).all()
        if not inside or self.distance(x, y, top) < radius + near:
            return False
        return all(np.hypot(x - a, y - b) > 0.9 * (radius + r) for a, b, r in self.taken)

    def on_table(self, x: float, y: float, inset: float = 0.08) -> bool:
        """Whether (x, y) lies on the table top, off its rim."""
        x0, y0, x1, y1 = self.table
        return x0 + inset < x < x1 - inset and y0 + inset < y < y1 - inset

    def seen(self, rng: Rng) -> tuple[float, float]:
        """A random place (x, y) that the camera sees at about the table's height."""
        x, y = places_seen(self.positions, self.rotations, self.table_z, rng, 1)[0]
        return float(x), float(y)


def places_seen(positions: Array, rotations: Array, z: float, rng: Rng, count: int) -> Array:
    """(count, 2) places under random pixels of random frames: at height z, or 1 to 2.2 m away if z is not reached."""
    i = rng.integers(0, len(positions), count)
    pixel = np.c_[rng.uniform(-0.5, 0.5, count), rng.uniform(-0.3, 0.4, count), np.ones(count)]
    ray = np.einsum("nij,nj->ni", rotations[i], pixel)
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    fall = np.where(ray[:, 2] < -1e-3, (z - positions[i, 2]) / np.minimum(ray[:, 2], -1e-3), np.inf)
    reach = np.clip(np.where(fall < 2.6, fall, rng.uniform(1.0, 2.2, count)), 0.7, 2.6)
    return np.asarray(positions[i, :2] + reach[:, None] * ray[:, :2])


def scene_from_world(T_world_cam: Array) -> Array:
    """(4, 4) T_scene_world of a path (N, 4, 4): origin in its middle, and z along the world axis that is up.

    Up is the axis that the images' upward direction follows and their horizontal direction avoids.
    """
    up = -T_world_cam[:, :3, 1].mean(0)
    tilt = np.abs(T_world_cam[:, :3, 0]).mean(0)
    axis = int(np.argmax(np.abs(up) - tilt))
    z = np.eye(3)[axis] * (1.0 if up[axis] > 0 else -1.0)
    x = np.eye(3)[(axis + 1) % 3]
    R = np.stack([x, np.cross(z, x), z])
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = -R @ (T_world_cam[:, :3, 3].min(0) + T_world_cam[:, :3, 3].max(0)) / 2
    return T


def fit_room(T_scene_cam: Array, rng: Rng) -> Layout:
    """A closed room around a path (N, 4, 4): walls 1.1 to 1.9 m beyond it, a table top below the view."""
    positions, rotations = T_scene_cam[:, :3, 3], T_scene_cam[:, :3, :3]
    low, high = positions.min(0), positions.max(0)
    margin = np.clip(2.3 - 0.4 * (high - low)[:2], 1.1, 1.9) + rng.uniform(-0.1, 0.1, 2)
    down = float(np.clip(-rotations[:, 2, 2].mean(), 0, 1))
    table_z = float(low[2] - 0.5 - 0.35 * down)
    room_low = np.array([*(low[:2] - margin), low[2] - 1.3])
    room_high = np.array([*(high[:2] + margin), max(high[2] + 0.9, low[2] + 1.3)])
    seen = places_seen(positions, rotations, table_z, rng, 400)
    near, far = np.percentile(seen, 15, axis=0), np.percentile(seen, 85, axis=0)
    middle, size = (near + far) / 2, np.clip(far - near, [1.3, 1.0], [2.6, 2.2])
    near = np.maximum(middle - size / 2, room_low[:2] + 0.25)
    far = np.minimum(middle + size / 2, room_high[:2] - 0.25)
    return Layout(
        positions=positions,
        rotations=rotations,
        low=room_low,
        high=room_high,
        table=(float(near[0]), float(near[1]), float(far[0]), float(far[1])),
        table_z=table_z,
    )
