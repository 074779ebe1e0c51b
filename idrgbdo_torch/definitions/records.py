"""The records of a run, in as little memory as they take: a day of them fits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import overload

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .growing import Column
from .results import Record, Status, TrackResult

STATUSES = tuple(Status)
# bits of what a record has besides its status
KEYFRAME, REFERENCE, MOTION, INFORMATION, TIMED, ENTROPIES = (1 << bit for bit in range(4, 10))
STATUS_BITS = 3
LAST_ROW = np.array([0.0, 0.0, 0.0, 1.0]).tobytes()
UPPER = np.triu_indices(6)
NO_POSE, NO_INFORMATION, NO_ENTROPIES = np.zeros((3, 4)), np.zeros(len(UPPER[0])), np.zeros(6)
LARGEST = (1 << 31) - 1  # of a whole number

Array = NDArray[np.float64]


class Records(Sequence[Record]):
    """A growing sequence of records. Each comes back as it was to the last bit, as an object of its own.

    One that is not as TrackResult says (poses of other types, say) is kept as the object that it is.
    """

    def __init__(self, records: Sequence[Record] = ()) -> None:
        self._seconds = Column("float64", (4,))  # timestamp, reference_time, decode_ms, track_ms
        self._flags = Column("int16")
        self._whole = Column("int32", (3,))  # points, iterations, segment
        self._ends = Column("int64")  # of the reasons
        self._pose = Column("float64", (3, 4))  # T_world_cam
        self._motion = Column("float64", (3, 4))  # T_ref_cam
        self._information = Column("float64", (len(NO_INFORMATION),))
        self._entropies = Column("float64", (6,))
        self._reasons = Column("uint8")  # all in a row, UTF-8
        self._odd: dict[int, Record] = {}
        for record in records:
            self.append(record)

    @staticmethod
    def of(records: Sequence[Record]) -> Records:
        """The same where they are Records, else those."""
        return records if isinstance(records, Records) else Records(records)

    def __len__(self) -> int:
        return len(self._flags)

    def append(self, record: Record) -> None:
        """One more."""
        result = record.result
        plain = is_plain(record)
        flags = STATUSES.index(result.status)
        pose, motion, information, entropies = NO_POSE, NO_POSE, NO_INFORMATION, NO_ENTROPIES
        whole = (0, 0, 0)
        if plain:
            flags |= KEYFRAME * result.keyframe | REFERENCE * (result.reference_time is not None)
            flags |= MOTION * (result.T_ref_cam is not None) | INFORMATION * (result.information is not None)
            flags |= TIMED * (record.track_ms is not None) | ENTROPIES * bool(result.entropy_bits)
            pose, whole = result.T_world_cam.numpy()[:3], (result.points, result.iterations, result.segment)
            self._reasons.extend(np.frombuffer(result.reason.encode("utf-8", "surrogatepass"), np.uint8))
        else:
            self._odd[len(self)] = record
        if plain and result.T_ref_cam is not None:
            motion = result.T_ref_cam.numpy()[:3]
        if plain and result.information is not None:
            information = result.information.numpy()[UPPER]
        if plain and result.entropy_bits:
            entropies = np.array(result.entropy_bits)
        self._seconds.append((record.timestamp, result.reference_time or 0.0, record.decode_ms, record.track_ms or 0.0))
        self._whole.append(whole)
        self._ends.append(len(self._reasons))
        self._pose.append(pose)
        self._motion.append(motion)
        self._information.append(information)
        self._entropies.append(entropies)
        self._flags.append(flags)

    @overload
    def __getitem__(self, number: int) -> Record: ...

    @overload
    def __getitem__(self, number: slice) -> list[Record]: ...

    def __getitem__(self, number: int | slice) -> Record | list[Record]:
        if isinstance(number, slice):
            return [self[each] for each in range(*number.indices(len(self)))]
        if not -len(self) <= number < len(self):
            raise IndexError(f"record {number} of {len(self)}")
        number %= len(self)
        if (odd := self._odd.get(number)) is not None:
            return odd
        flags = self._flags[number]
        time, reference, decode_ms, track_ms = self._seconds[number].tolist()
        points, iterations, segment = self._whole[number].tolist()
        begin, end = self._ends[number - 1] if number else 0, self._ends[number]
        result = TrackResult(
            T_world_cam=whole_pose(self._pose[number]),
            status=STATUSES[flags & STATUS_BITS],
            reason=self._reasons.array(begin, end).tobytes().decode("utf-8", "surrogatepass") if end > begin else "",
            reference_time=reference if flags & REFERENCE else None,
            T_ref_cam=whole_pose(self._motion[number]) if flags & MOTION else None,
            information=torch.from_numpy(symmetric(self._information[number])) if flags & INFORMATION else None,
            keyframe=bool(flags & KEYFRAME),
            points=points,
            iterations=iterations,
            entropy_bits=tuple(self._entropies[number].tolist()) if flags & ENTROPIES else (),
            segment=segment,
        )
        return Record(time, result, decode_ms, track_ms if flags & TIMED else None)

    def __iter__(self) -> Iterator[Record]:
        return (self[number] for number in range(len(self)))

    def timestamps(self) -> Tensor:
        """(N,) float64 seconds."""
        return torch.from_numpy(self._seconds.array()[:, 0].copy())

    def statuses(self) -> tuple[Status, ...]:
        """One status a record."""
        return tuple(STATUSES[flags & STATUS_BITS] for flags in self._flags)

    def poses(self) -> Tensor:
        """(N, 4, 4) float64 T_world_cam."""
        out = torch.eye(4, dtype=torch.float64).repeat(len(self), 1, 1)
        out[:, :3] = torch.from_numpy(self._pose.array())
        for number, record in self._odd.items():
            out[number] = record.result.T_world_cam
        return out


def is_plain(record: Record) -> bool:
    """Whether a record is of the types that TrackResult names, so that nothing is lost in the columns."""
    result = record.result
    numbers = (record.timestamp, record.decode_ms, record.track_ms or 0.0, result.reference_time or 0.0)
    if any(type(number) is not float for number in numbers) or type(result.reason) is not str:
        return False
    if any(type(n) is not int or abs(n) > LARGEST for n in (result.points, result.iterations, result.segment)):
        return False
    if len(result.entropy_bits) not in (0, 6) or any(type(bits) is not float for bits in result.entropy_bits):
        return False
    poses = (result.T_world_cam,) if result.T_ref_cam is None else (result.T_world_cam, result.T_ref_cam)
    information = result.information
    if not all(has_shape(T, (4, 4)) and T[3].numpy().tobytes() == LAST_ROW for T in poses):
        return False
    if information is None:
        return True
    return has_shape(information, (6, 6)) and information.numpy().tobytes() == information.numpy().T.tobytes()


def has_shape(tensor: Tensor, shape: tuple[int, ...]) -> bool:
    """Whether it is a float64 tensor of that shape on the CPU."""
    return (
        isinstance(tensor, Tensor)
        and tensor.dtype == torch.float64
        and tuple(tensor.shape) == shape
        and tensor.device.type == "cpu"
        and not tensor.requires_grad
    )


def whole_pose(upper: Array) -> Tensor:
    """(4, 4) of its first three rows."""
    T = np.zeros((4, 4))
    T[:3] = upper
    T[3, 3] = 1.0
    return torch.from_numpy(T)


def symmetric(upper: NDArray[np.floating]) -> Array:
    """(..., 6, 6) of their upper triangles (..., 21)."""
    out = np.zeros((*upper.shape[:-1], 6, 6))
    out[..., UPPER[0], UPPER[1]] = upper
    out[..., UPPER[1], UPPER[0]] = upper
    return out
