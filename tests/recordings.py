"""Tiny recordings made on the spot, and where the repository is."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parent.parent


def write_recording(
    parent: Path,
    name: str = "tiny",
    frames: int = 4,
    size: tuple[int, int] = (48, 64),
    depth_m: float = 1.5,
    depth_delay_s: float = 0.005,
    calibration: str | None = "60 60 31.5 23.5",
    groundtruth: bool = True,
) -> Path:
    """A small recording in TUM's layout; its folder."""
    rng = np.random.default_rng(7)
    folder = parent / name
    for kind in ("rgb", "depth"):
        (folder / kind).mkdir(parents=True)
    lists: dict[str, list[str]] = {"rgb": ["# images"], "depth": ["# images"], "groundtruth": ["# poses"]}
    for index in range(frames):
        time = 100 + index / 30
        color = rng.integers(0, 256, (*size, 3), dtype=np.uint8)
        depth = np.full(size, round(depth_m * 5000), dtype=np.uint16)
        depth[0] = 0
        for kind, stamp, image in (("rgb", time, color), ("depth", time + depth_delay_s, depth)):
            assert cv2.imwrite(str(folder / kind / f"{stamp:.6f}.png"), image)
            lists[kind].append(f"{stamp:.6f} {kind}/{stamp:.6f}.png")
        lists["groundtruth"].append(f"{time:.6f} {0.01 * index} {0.02 * index**2} 0 0 0 0 1")
    if not groundtruth:
        del lists["groundtruth"]
    for kind, lines in lists.items():
        (folder / f"{kind}.txt").write_text("\n".join(lines) + "\n")
    if calibration is not None:
        (folder / "calibration.txt").write_text(calibration + "\n")
    return folder
