"""Columns and records: what was put in comes back to the last bit, in little memory; full chunks never change."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from idrgbdo_torch.definitions import growing
from idrgbdo_torch.definitions.growing import Column
from idrgbdo_torch.definitions.records import Records
from idrgbdo_torch.definitions.results import Record, Status, TrackResult


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Chunks of 16 entries."""
    monkeypatch.setattr(growing, "CHUNK_BYTES", 1)


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("shape", [(), (4, 4)])
def test_a_column_is_a_list(shape: tuple[int, ...]) -> None:
    entries = np.random.default_rng(0).normal(size=(100, *shape))
    column = Column("float64", shape)
    for entry in entries:
        column.append(entry)
    assert len(column) == 100 and len(column.full) == 6
    assert np.array_equal(column.array(), entries) and np.array_equal(column.array(10, 70), entries[10:70])
    assert np.array_equal(column.array(5, 5), entries[5:5])
    assert np.array_equal(np.array(list(column)), entries)
    assert np.array_equal(column[-1], entries[-1]) and np.array_equal(column[3], entries[3])
    for number in (100, -101):
        with pytest.raises(IndexError):
            column[number]
    together = Column("float64", shape)
    together.extend(entries[:50])
    together.extend(entries[50:])
    assert np.array_equal(together.array(), entries)


@pytest.mark.usefixtures("small")
def test_full_chunks_never_change() -> None:
    column = Column("float64", (2,))
    column.extend(np.arange(80.0).reshape(40, 2))
    first, other = column.full[0], column.copied()
    column[3] = (7, 7)
    column[-1] = (8, 8)
    assert column[3].tolist() == [7, 7] and column[39].tolist() == [8, 8]
    assert first[3].tolist() == [6, 7] == other[3].tolist() and other[39].tolist() == [78, 79]
    assert not column.full[0].flags.writeable and column.full[1] is other.full[1]
    column[2][:] = 0.0  # an entry that is read is one's own
    assert column[2].tolist() == [4, 5]


def record(number: int, **changes: object) -> Record:
    rng = np.random.default_rng(number)
    T = torch.eye(4, dtype=torch.float64)
    T[:3] = torch.from_numpy(rng.normal(size=(3, 4)))
    information = rng.normal(size=(6, 6))
    parts: dict[str, object] = {
        "T_world_cam": T, "status": list(Status)[number % 3], "reason": "" if number % 2 else f"so ü {number}",
        "reference_time": number / 3, "T_ref_cam": T.flip(1).roll(1, 0).contiguous(), "keyframe": number % 5 == 0,
        "information": torch.from_numpy(information + information.T), "points": number, "iterations": 3,
        "entropy_bits": tuple(rng.normal(size=6).tolist()), "segment": 1,
    }  # fmt: skip
    parts["T_ref_cam"] = T.clone()
    return Record(number / 30, TrackResult(**{**parts, **changes}), 0.5, 1.5 if number % 4 else None)  # type: ignore[arg-type]


def as_text(record: Record) -> str:
    """Everything in it, to the last bit."""
    result = vars(record.result)
    tensors = {name: part.numpy().tobytes() for name, part in result.items() if isinstance(part, torch.Tensor)}
    return repr((record.timestamp, record.decode_ms, record.track_ms, {**result, **tensors}))


@pytest.mark.usefixtures("small")
def test_records_come_back_as_they_were() -> None:
    eye = torch.eye(4, dtype=torch.float64)
    odd = [
        record(50, T_world_cam=eye.float()),
        record(51, information=torch.full((6, 6), torch.nan, dtype=torch.float64)),
        record(52, entropy_bits=(1.0, 2.0)),
        record(53, points=1 << 40),
        record(54, T_world_cam=2 * eye),
        record(55, reference_time=None, T_ref_cam=None, information=None, entropy_bits=()),
    ]
    given = [*(record(number) for number in range(40)), *odd, record(60)]
    records = Records(given)
    assert [as_text(each) for each in records] == [as_text(each) for each in given]
    assert [as_text(each) for each in records[38:44]] == [as_text(each) for each in given[38:44]]
    assert as_text(records[-1]) == as_text(given[-1])
    assert records.statuses() == tuple(each.result.status for each in given)
    assert records.timestamps().tolist() == [each.timestamp for each in given]
    assert torch.equal(records.poses(), torch.stack([each.result.T_world_cam.double() for each in given]))
    with pytest.raises(IndexError):
        records[len(given)]


def test_a_day_of_records_fits() -> None:
    """2.6 million frames at 30 a second; what a frame takes is what its numbers take."""
    records = Records()
    one = record(1)
    for _ in range(4000):
        records.append(one)
    columns = [part for part in vars(records).values() if isinstance(part, Column)]
    size = sum(chunk.nbytes for column in columns for chunk in (*column.full, column.last))
    assert size / len(records) < 600
