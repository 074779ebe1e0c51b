"""What a real camera does wrong, and what its calibration says of it."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import numpy.typing as npt

from .config import FaultConfig, SynthConfig

Image = TypeVar("Image", bound=np.generic)

DEPTH_SCALE = 5000.0  # per metre, of TUM's files
JUMP_S = 0.5  # between changes of gain
CENTER = (0.8, 0.6)  # direction in which the principal point is off


def jump_gain(t: float, jump: float, seed: int) -> float:
    """Relative gain at time t (s) of an automatic exposure in steps: 1 - jump, 1 and 1 + jump in a random order."""
    if not jump:
        return 1.0
    steps = np.random.default_rng([seed, 8]).permutation([-1.0, 0.0, 1.0])
    return 1.0 + jump * float(steps[int(t / JUMP_S) % len(steps)])


def spoilt_depth(depth: npt.NDArray[np.uint16], faults: FaultConfig) -> npt.NDArray[np.uint16]:
    """(H, W) raw depth with the wrong scale, its growth with distance, and at the wrong place."""
    if faults.depth_scale or faults.depth_growth:
        z = depth / DEPTH_SCALE
        if faults.depth_growth:  # solves z = m (1 + growth m)
            z = 2 * z / (1 + np.sqrt(np.maximum(1 + 4 * faults.depth_growth * z, 0)))
        counts = np.round(z * (1 + faults.depth_scale) * DEPTH_SCALE)
        depth = np.where(counts <= 65535, counts, 0).astype(np.uint16)
    return shifted(depth, faults.misregistration_px)


def understood_depth(depth: npt.NDArray[np.uint16], faults: FaultConfig) -> npt.NDArray[np.float32]:
    """(H, W) metres of raw depth, as a reader has them who knows what the camera file says."""
    if not faults.named:
        return depth.astype(np.float32) / np.float32(DEPTH_SCALE)
    metres = depth.astype(np.float32) / np.float32(DEPTH_SCALE * (1 + faults.depth_scale))
    if faults.depth_growth:
        metres *= 1 + np.float32(faults.depth_growth) * metres
    return shifted(metres, -faults.misregistration_px)


def shifted(image: npt.NDArray[Image], right: int) -> npt.NDArray[Image]:
    """The image moved by so many columns to the right, 0 where nothing comes in."""
    out = np.roll(image, right, axis=1)
    if right > 0:
        out[:, :right] = 0
    elif right < 0:
        out[:, right:] = 0
    return out


def stated_intrinsics(config: SynthConfig) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy as the calibration has them: wrong by the faults, unless it names them."""
    f = config.faults
    wrong = 0.0 if f.named else 1.0
    scale = 1 + wrong * f.focal
    cx, cy = (c + wrong * f.center_px * part for c, part in zip((config.cx, config.cy), CENTER, strict=True))
    return config.fx * scale, config.fy * scale, cx, cy


def camera_file(config: SynthConfig) -> str:
    """The camera.toml that names what a user can know of the faults."""
    f = config.faults
    fx, fy, cx, cy = stated_intrinsics(config)
    lines = [f"{name} = {value!r}" for name, value in zip(("fx", "fy", "cx", "cy"), (fx, fy, cx, cy), strict=True)]
    lines.append(f"depth_scale = {DEPTH_SCALE * (1 + f.depth_scale)!r}")
    lines += [
        f"{name} = {getattr(f, name)!r}"
        for name in ("depth_growth", "readout_ms", "depth_delay_ms")
        if getattr(f, name)
    ]
    if f.misregistration_px:
        lines += ["[depth]", f"fx = {fx!r}", f"fy = {fy!r}", f"cx = {cx + f.misregistration_px!r}", f"cy = {cy!r}"]
    return "\n".join(lines) + "\n"
