"""What frames are tracked against: a keyframe, and what has been learnt since it was made."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..frame import Keyframe

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass
class Reference:
    """The newest keyframe. A new one takes its place whole."""

    keyframe: Keyframe
    T_kf_world: Array  # (4, 4)
    turn: Array  # (3,) rad/s, of its frame
    index: Index  # the points being tracked, among its candidates
    T_chosen: Array = field(default_factory=lambda: np.eye(4))  # the guess of T_frame_kf that they were chosen for
    affine: Array = field(default_factory=lambda: np.zeros(2))  # brightness of the last frame relative to it
    entropies: list[Array] = field(default_factory=list)  # (6,) bits per degree of freedom, of the frames since
