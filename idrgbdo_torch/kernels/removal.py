"""Which keyframe a window can spare, in numpy: the twin of definitions/removal.py for the window's sizes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..measurement import LINK_FLOOR, UNKNOWN

Array = NDArray[Any]


def next_view_bits(information: Array, links: Array, adjoints: Array) -> Array:
    """Twin of removal.next_view_bits: (K,) bits, from (6K, 6K), (K, 6, 6) and (K, 6, 6)."""
    K, n = len(links), 6 * len(links)
    scale = 1.0 / np.sqrt(np.maximum(information.diagonal(), 1e-12))
    unit = scale[:, None] * information * scale
    unit.flat[:: n + 1] += UNKNOWN
    covariance = (scale[:, None] * np.linalg.inv(unit) * scale).reshape(K, 6, K, 6)
    moved = adjoints[:, None] @ covariance.transpose(0, 2, 1, 3) @ adjoints.transpose(0, 2, 1)  # (K, K, 6, 6)
    moved = moved.transpose(0, 2, 1, 3).copy()
    floor = LINK_FLOOR * links.diagonal(axis1=1, axis2=2).max(axis=0)
    k = np.arange(K)
    moved[k, :, k, :] += np.linalg.inv(links + np.diag(floor))
    placings = moved.reshape(n, n)
    back = 1.0 / np.sqrt(placings.diagonal())
    W = (back[:, None] * np.linalg.inv(back[:, None] * placings * back) * back).reshape(K, 6, K, 6)
    w = W.sum(axis=0).transpose(1, 0, 2)  # (K, 6, 6), rows of the view
    lost = w @ np.linalg.solve(W[k, :, k, :], w.transpose(0, 2, 1))
    share = np.linalg.solve(np.broadcast_to(w.sum(axis=0), (K, 6, 6)), lost)
    bits: Array = -0.5 * np.linalg.slogdet(np.eye(6) - share).logabsdet / np.log(2.0)
    return bits
