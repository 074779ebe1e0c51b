"""Sequences as torch's DataLoader and Python's pickle take them."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from torch.utils.data import DataLoader

from idrgbdo_torch import IdRgbdoError, RgbdFrame, open_sequence
from idrgbdo_torch.synthetic import RenderedSequence, SynthConfig


def test_a_sequence_has_length_and_index_and_survives_pickling(make_recording: Callable[..., Path]) -> None:
    sequence = open_sequence(make_recording(frames=7), start=1, every=2)
    assert len(sequence) == 3
    frames = [sequence[k] for k in range(3)]
    assert [f.timestamp for f in frames] == sequence.timestamps
    assert sequence[-1].timestamp == sequence.timestamps[-1]
    with pytest.raises(IndexError):
        sequence[3]
    copy = pickle.loads(pickle.dumps(sequence))
    assert copy.timestamps == sequence.timestamps and copy.camera == sequence.camera
    ours, theirs = sequence[1], copy[1]
    assert isinstance(ours, RgbdFrame) and torch.equal(ours.gray, theirs.gray) and torch.equal(ours.depth, theirs.depth)


@pytest.mark.parametrize("index", [slice(0, 3), "0", 1.0, None])
def test_what_is_no_number_of_a_frame_is_one_line(make_recording: Callable[..., Path], index: Any) -> None:
    for sequence in (open_sequence(make_recording(frames=2)), RenderedSequence(SynthConfig(frames=2))):
        with pytest.raises(IdRgbdoError, match=r"frame: expected the number of one frame, got .*; take several one by"):
            sequence[index]


@pytest.mark.parametrize("path", [None, 123, b"/tmp", ["/tmp"]])
def test_what_is_no_path_is_one_line(path: Any) -> None:
    with pytest.raises(IdRgbdoError, match=r"path: expected text or a pathlib\.Path, got"):
        open_sequence(path)


@pytest.mark.parametrize("context", ["fork", "spawn"])
def test_a_data_loader_with_workers_gives_the_same_frames(make_recording: Callable[..., Path], context: str) -> None:
    sequence = open_sequence(make_recording(frames=6))
    loader = DataLoader(
        sequence, batch_size=2, num_workers=2, collate_fn=list, multiprocessing_context=context  # type: ignore[arg-type]
    )  # fmt: skip
    loaded = [frame for batch in loader for frame in batch]
    assert [frame.timestamp for frame in loaded] == sequence.timestamps
    for frame, expected in zip(loaded, sequence, strict=True):
        assert isinstance(expected, RgbdFrame) and torch.equal(frame.gray, expected.gray)


def test_a_rendered_sequence_too() -> None:
    sequence = RenderedSequence(SynthConfig(frames=3, width=64, height=48, fx=52, fy=52, cx=31.5, cy=23.5))
    copy = pickle.loads(pickle.dumps(sequence))
    assert torch.equal(copy[-1].gray, sequence[2].gray)
