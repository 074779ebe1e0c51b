"""Entropy of each degree of freedom for every frame, in numpy: the twin of information.freedom_entropies_bits."""

from __future__ import annotations

from math import e, log2, pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


def freedom_entropies(information: Array) -> Array:
    """Bits (m,) of each variable given the others, 1/2 log2(2 pi e / Lambda_kk); infinite without information."""
    precision = information.diagonal()
    if precision.min() > 0.0:  # nearly always, and np.errstate costs more than the logarithm
        return np.asarray(0.5 * (log2(2.0 * pi * e) - np.log2(precision)))
    with np.errstate(divide="ignore", invalid="ignore"):
        bits = 0.5 * np.log2(2.0 * pi * e / precision)
    return np.where(precision > 0.0, bits, np.inf)
