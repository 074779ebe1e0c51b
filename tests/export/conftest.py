"""A rendered film as a folder, tracked by the command into a run's folder."""

from __future__ import annotations

from pathlib import Path

import pytest
from format_writers import tum
from rendered import Film

from idrgbdo_torch.commands.cli import main


@pytest.fixture(scope="session")
def tracked(desk: Film, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run's folder; 40 frames, five keyframes. Tests leave it as it is."""
    folder = tmp_path_factory.mktemp("export")
    tum(desk, folder / "film")
    assert main(["run", str(folder / "film"), "--out", str(folder / "run")]) == 0
    return folder / "run"
