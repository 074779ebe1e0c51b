"""What it costs to start: importing, asking for help, loading the compiled kernels."""

from __future__ import annotations

import subprocess
import sys

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

STARTS = {
    "python": "pass",
    "import idrgbdo_torch": "import idrgbdo_torch",
    "import torch": "import torch",
    "import IdRgbdo": "from idrgbdo_torch import IdRgbdo",
    "import IdRgbdo, load the kernels": ("from idrgbdo_torch import IdRgbdo; IdRgbdo()"),
    "idrgbdo --help": "from idrgbdo_torch.commands.cli import main; raise SystemExit(main(['--help']))",
}


@pytest.mark.parametrize("name", list(STARTS))
def test_start(name: str, full: bool, benchmark: BenchmarkFixture) -> None:
    benchmark.group = "7 a process"
    if not full and name == "import torch":
        pytest.skip("only of interest beside the others")
    command = [sys.executable, "-c", STARTS[name]]
    done = benchmark.pedantic(subprocess.run, (command,), {"capture_output": True}, rounds=5 if full else 1)
    assert done.returncode == 0, done.stderr.decode()
