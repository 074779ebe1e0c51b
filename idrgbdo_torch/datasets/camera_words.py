"""Keys and numbers as calibrations of other programs write them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np


def by_name(data: Mapping[str, Any]) -> dict[str, Any]:
    """The values by their keys in small letters, without what stands before a dot.

    `Camera.fx` and `Camera1.fx` are ORB-SLAM's, `RGBD.DepthMapFactor` too; `Camera2` is another camera.
    """
    return {
        key.lower().rsplit(".", 1)[-1]: value for key, value in data.items() if not key.lower().startswith("camera2.")
    }


def number(value: Any) -> Any:
    """Text that is a number as that number."""
    try:
        return float(value) if isinstance(value, str) else value
    except ValueError:
        return value


def numbers(value: Any) -> list[float]:
    """The numbers of a list, nested or not, or of {rows, cols, data}; empty for anything else."""
    if isinstance(value, Mapping):
        value = value.get("data")
    try:
        return [float(item) for item in np.asarray(value, dtype=np.float64).ravel()] if value is not None else []
    except (TypeError, ValueError, OverflowError):
        return []
