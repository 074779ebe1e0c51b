"""Attacks on checkpoints: spoiled ones are never believed, and those of somebody who can seal them run no code."""

from __future__ import annotations

import hashlib
import json
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from numpy.random import Generator

from idrgbdo_torch.odometry import run
from idrgbdo_torch.runs import checkpoint
from idrgbdo_torch.runs.checkpoint import COUNT_BYTES, DIGEST_BYTES, MAGIC, NAME, Checkpoints, Identity, State, load
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo
from idrgbdo_torch.tracker.warmup import tiny_film

from .mutate import spoiled, tree_spoiled
from .promise import refused

IDENTITY = Identity("1", "seed = 0\n", "wall", 12, 0.0, 0.4, "camera")


@cache
def whole() -> bytes:
    """The checkpoint of a run over a tiny film."""
    odometry = IdRgbdo()
    records = list(run(odometry, tiny_film()).records)
    with TemporaryDirectory() as folder:
        Checkpoints(Path(folder), IDENTITY).write(State(odometry, records, []))
        return (Path(folder) / NAME).read_bytes()


def spoiled_checkpoint(rng: Generator, folder: Path) -> None:
    """Bits flipped, pieces lost: refused."""
    (folder / NAME).write_bytes(spoiled(rng, whole()))
    assert refused(lambda: load(folder, IDENTITY)), "a spoiled checkpoint was believed"


def sealed_checkpoint(rng: Generator, folder: Path) -> None:
    """Another content under a right checksum: a state or a sentence, and no code of its own."""
    data = whole()
    begin = len(MAGIC) + COUNT_BYTES
    end = begin + int.from_bytes(data[len(MAGIC) : begin], "big")
    text = json.dumps(tree_spoiled(rng, json.loads(data[begin:end]))).encode()
    sealed = MAGIC + len(text).to_bytes(COUNT_BYTES, "big") + text + data[end:-DIGEST_BYTES]
    (folder / NAME).write_bytes(sealed + hashlib.sha256(sealed).digest())
    refused(lambda: load(folder, IDENTITY))
    assert [path.name for path in folder.iterdir()] == [checkpoint.NAME]
