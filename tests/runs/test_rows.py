"""What only grows lies beside the checkpoint: written once, compared, and gone with the run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from idrgbdo_torch.definitions import growing
from idrgbdo_torch.definitions.records import Records
from idrgbdo_torch.definitions.results import Record, Status, TrackResult
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.odometry import ConstantVelocity, run
from idrgbdo_torch.runs.checkpoint import NAME, Checkpoints, Identity, State, load
from idrgbdo_torch.runs.rows import PATTERN
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo
from idrgbdo_torch.tracker.warmup import tiny_film

IDENTITY = Identity("1", "seed = 0\n", "desk", 40, 0.0, 1.3, "camera")


def grow(records: Records, count: int) -> None:
    for _ in range(count):
        T = torch.eye(4, dtype=torch.float64)
        T[0, 3] = len(records)
        records.append(Record(len(records) / 30, TrackResult(T, Status.OK, "as good as it gets"), 0.5, 1.5))


def rows_files(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.glob(PATTERN))


def test_a_checkpoint_does_not_grow_with_the_run(tmp_path: Path) -> None:
    records = Records()
    state, checkpoints = State(ConstantVelocity(), records, []), Checkpoints(tmp_path, IDENTITY)
    sizes, appended = [], []
    for _ in range(6):
        grow(records, 4000)
        checkpoints.write(state)
        sizes.append((tmp_path / NAME).stat().st_size)
        appended.append((tmp_path / rows_files(tmp_path)[0]).stat().st_size)
    assert max(sizes) < 1.3e6 and sizes[-1] < 1.5 * sizes[1]
    steps = np.diff(appended)
    assert 0 < max(steps) < 2 * min(steps) and len(rows_files(tmp_path)) == 1
    back = load(tmp_path, IDENTITY).records
    assert torch.equal(Records.of(back).poses(), records.poses()) and back[12345].timestamp == records[12345].timestamp
    checkpoints.remove()
    assert not list(tmp_path.iterdir())


def test_a_run_goes_on_from_it_and_leaves_one_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growing, "CHUNK_BYTES", 1)
    monkeypatch.setattr(growing, "FIRST_ROWS", 2)
    frames = list(tiny_film())
    whole = IdRgbdo()
    expected = run(whole, frames).trajectory()
    half = IdRgbdo()
    records = Records(run(half, frames[:6]).records)
    Checkpoints(tmp_path, IDENTITY).write(State(half, records, []))
    (tmp_path / "checkpoint_rows_1.bin").write_bytes(b"of a process that was killed before it wrote a checkpoint")
    for end in (9, 12):
        state = load(tmp_path, IDENTITY)
        run(state.odometry, frames[len(state.records) : end], earlier=state.records)
        assert len(state.records) == end
        Checkpoints(tmp_path, IDENTITY).write(state)
        assert len(rows_files(tmp_path)) == 1
    assert torch.equal(Records.of(state.records).poses(), expected.T_world_cam)
    assert torch.equal(state.odometry.trajectory().T_world_cam, whole.trajectory().T_world_cam)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda path: path.unlink(),
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(path.read_bytes()[:-1]),
        lambda path: path.write_bytes(bytes([path.read_bytes()[0] ^ 1]) + path.read_bytes()[1:]),
    ],
)
def test_rows_that_are_damaged_are_never_believed(tmp_path: Path, spoil: Callable[[Path], object]) -> None:
    records = Records()
    grow(records, 4000)
    Checkpoints(tmp_path, IDENTITY).write(State(ConstantVelocity(), records, []))
    spoil(tmp_path / rows_files(tmp_path)[0])
    with pytest.raises(IdRgbdoError, match=r"resume: .* cannot be read .*checkpoint_rows_0\.bin"):
        load(tmp_path, IDENTITY)
