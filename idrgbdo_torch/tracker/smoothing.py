"""The trajectory that hindsight gives: what left the window follows what stayed (section 5.2), frames their keyframes.

Only for what is asked at the end of a run: a causal pose never changes.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from ..definitions.growing import Column
from ..definitions.marginalization import scaled_solve
from ..kernels.se3 import inverse, log_se3, retract

Array = NDArray[np.float64]


class Departure(NamedTuple):
    """A keyframe at the moment when it left the window."""

    T: Array  # (4, 4) its T_kf_world
    T_others: Array  # (K - 1, 4, 4) those of the keyframes that stayed
    follows: Array  # (6, 6 (K - 1)) how it moves when they move, left increments


def departure(T: Array, information: Array, k: int) -> Departure:
    """Keyframe k of a window with the poses T (K, 4, 4) and their information (6K, 6K), its own points and all else.

    The lower row of Eq. 21, solved for what is marginalised: y_beta = H_bb^-1 (b_b - H_ba y_alpha). When the others
    move by y_alpha from where they were, the best pose of k moves by -H_bb^-1 H_ba y_alpha.
    """
    mine = slice(6 * k, 6 * k + 6)
    others = np.delete(information[mine], np.arange(6 * k, 6 * k + 6), axis=1)
    follows = -scaled_solve(torch.from_numpy(information[mine, mine]), torch.from_numpy(others)).numpy()
    return Departure(T[k].copy(), np.delete(T, k, axis=0), follows)


class Departures:
    """Of many keyframes, in the order of leaving: who left, who stayed, and how it left."""

    def __init__(self, stayed: int = 0) -> None:
        """stayed: how many stay when one leaves."""
        self._numbers = Column("int32", (1 + stayed,))  # of the keyframe, then of those that stayed
        self._T = Column("float64", (1 + stayed, 3, 4))  # without the row 0 0 0 1
        self._follows = Column("float64", (6 * stayed, 6))  # by columns, as they come: sums keep their order

    def __len__(self) -> int:
        return len(self._numbers)

    def append(self, number: int, others: Sequence[int], left: Departure) -> None:
        """One more; of all as many stayed."""
        if not len(self):
            self.__init__(len(others))  # type: ignore[misc]
        self._numbers.append((number, *others))
        self._T.append(np.concatenate([left.T[None], left.T_others])[:, :3])
        self._follows.append(left.follows.T)

    def __getitem__(self, k: int) -> tuple[int, list[int], Departure]:
        number, *others = self._numbers[k].tolist()
        T = np.tile(np.eye(4), (1 + len(others), 1, 1))
        T[:, :3] = self._T[k]
        return number, others, Departure(T[0], T[1:], self._follows[k].T)

    def __reversed__(self) -> Iterator[tuple[int, list[int], Departure]]:
        return (self[k] for k in reversed(range(len(self))))

    def move_world(self, numbers: Collection[int], T_old_new: Array) -> None:
        """See those keyframes from another world, which lies at this pose (4, 4) in the old one."""
        for k in range(len(self)):
            if self._numbers[k][0] in numbers:
                _, _, left = self[k]
                self._T[k] = np.concatenate([left.T[None] @ T_old_new, left.T_others @ T_old_new])[:, :3]


def followed(left: Departure, T_others: Array) -> Array:
    """(4, 4) pose of a keyframe that left, now that those that had stayed are at T_others (K - 1, 4, 4)."""
    moved = [log_se3(now @ inverse(then)) for now, then in zip(T_others, left.T_others, strict=True)]
    pose: Array = retract(left.follows @ np.concatenate(moved), left.T)
    return pose


def smooth_keyframes(poses: Iterable[Array], departures: Departures) -> list[Array]:
    """T_kf_world of all keyframes, given those of the window as they are now.

    departures: in the order of leaving, the number of the keyframe, the numbers of those that stayed, and how it left.
    The last one that left followed keyframes that are settled now, the one before may have followed it, and so on.
    """
    out = list(poses)
    for number, others, left in reversed(departures):
        out[number] = followed(left, np.stack([out[other] for other in others]))
    return out


def between(T_frame_kf: Array, T_kf: Array, T_next_kf: Array, T_next: Array, share: float) -> Array:
    """(4, 4) T_frame_world of a frame that was tracked between two keyframes whose poses are better known since.

    T_frame_kf: as tracked against the earlier one; T_next_kf: the later one, tracked against it just the same. What
    the later one has been corrected by is the error of that keyframe's points, which has grown from none at the
    earlier keyframe: share (0 to 1) of the way, the frame has so much of it.
    """
    correction = log_se3(T_next @ inverse(T_next_kf @ T_kf))
    pose: Array = retract(share * correction, T_frame_kf @ T_kf)
    return pose
