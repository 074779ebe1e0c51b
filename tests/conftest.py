"""Shared by the tests: where the real sequences are, and tiny recordings made on the spot, a rendered desk."""

from __future__ import annotations

import os
import sys

if "PYTEST_XDIST_WORKER" in os.environ:  # workers beside each other; set before anything reads it
    os.environ.setdefault("OMP_NUM_THREADS", "1")

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from recordings import ROOT, write_recording
from rendered import FAULTLESS, Film, film

from idrgbdo_torch.synthetic import RenderedSequence

sys.path.append(str(ROOT))  # baselines/, which the installed package has as a part of itself


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder with the real sequences: IDRGBDO_DATA, else ../shared/data beside the checkout; skips without one."""
    folder = Path(os.environ.get("IDRGBDO_DATA") or ROOT.parent / "shared" / "data")
    if not folder.is_dir():
        pytest.skip(f"needs the real sequences: no folder '{folder}'; set IDRGBDO_DATA")
    return folder


@pytest.fixture(scope="session")
def desk() -> Film:
    """40 frames of a rendered desk with full sensor noise, rendered once for all tests."""
    return film()


@pytest.fixture(scope="session")
def faultless() -> RenderedSequence:
    """8 frames of a small film by an ideal sensor; its frames are rendered when read."""
    return RenderedSequence(FAULTLESS)


@pytest.fixture
def make_recording(tmp_path: Path) -> Callable[..., Path]:
    """A function that writes a small recording in TUM's layout and returns its folder."""
    return partial(write_recording, tmp_path)
