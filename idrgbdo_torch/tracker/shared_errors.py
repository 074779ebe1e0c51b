"""What errors have in common: what more points do not average out, and what wide patches do.

The normal equations count every point as a measurement of its own, so twice the points claim half the variance. Two
errors are common to all. A pose that is reported has them in its covariance; choice, keyframes and window compare
information with information, where they would cancel.

- When the image was taken. A blurred image lies somewhere along its own motion: what it claims to know in that
  direction is better than the instant it stands for.
- A small share of a point's variance, that of the keyframe's own blur, interpolation and depth, is every point's.

The equations also take all pixels of a patch to be off in position and depth by the same amount. Those of a wide patch
are not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

INSTANT = 5e-5  # s, standard deviation of the instant that an image stands for
SHARED = 0.001  # of a point's variance, common to all points
WIDE_SAYS = 1.6  # times as much is known from wide patches


def believed(information: Array, points: int, velocity: Array, wide: bool = False) -> Array:
    """(6, 6) information of a left increment of T_cam_ref with errors that its points share.

    information: as the equations add it up over so many points. velocity: (6,) [v, w] of a left increment of
    T_cam_world, m/s and rad/s, zeros where it is unknown. wide: whether patches were. The covariance grows by the
    factor 1 + SHARED (points - 1), and by INSTANT^2 velocity velocity^T.
    """
    apart = (WIDE_SAYS if wide else 1.0) * information / (1.0 + SHARED * max(points - 1, 0))
    along = apart @ velocity
    out: Array = apart - np.outer(along, along) * (INSTANT**2 / (1.0 + INSTANT**2 * (velocity @ along)))
    return out
