"""docs/api.md runs, top to bottom; the public names are all there, documented and cheap to import."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from test_readme import blocks

import idrgbdo_torch
from idrgbdo_torch.definitions.se3 import log

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "api.md"


@pytest.fixture(scope="module")
def names() -> dict[str, Any]:
    """What is left after the blocks of the page have run in order."""
    torch.manual_seed(0)
    left: dict[str, Any] = {}
    for number, block in enumerate(blocks(PAGE, "python")):
        exec(compile(block, f"{PAGE.name}, block {number + 1}", "exec"), left)
    return left


def test_tracking(names: dict[str, Any]) -> None:
    trajectory = names["odometry"].trajectory()
    assert len(trajectory) == 12 and names["result"].status is idrgbdo_torch.Status.OK
    off = trajectory.positions - (names["poses"][:, :3, 3] - names["poses"][0, :3, 3]) @ names["poses"][0, :3, :3]
    assert off.norm(dim=1).max() < 0.005
    assert names["thorough"].config.selection.points == 100


def test_residuals(names: dict[str, Any]) -> None:
    term = names["term"]
    n = len(term.r)
    assert n > 300 and term.r.shape == (n, 8) and term.dr_dxi.shape == (n, 8, 6)
    assert term.valid.float().mean() > 0.7
    expected = 2 * (term.r[..., None] * term.dr_daffine)[term.valid].mean((0, 1))
    torch.testing.assert_close(names["slope"], expected.detach())


def test_pairs(names: dict[str, Any]) -> None:
    aligned = names["aligned"]
    assert aligned.ok.all()
    assert log(names["T_true"] @ torch.linalg.inv(aligned.T_target_host))[:, :3].norm(dim=1).max() < 0.005
    losses, sigma = names["losses"], float(names["log_sigma"].detach().exp())
    assert losses[-1] < losses[0] - 1.0 and 1.0 < sigma < 10.0
    assert names["system"].H.shape == (11, 8, 8) and names["system"].seen.float().mean() > 0.5


def test_rows_and_information(names: dict[str, Any]) -> None:
    chosen, J = names["chosen"], names["J"]
    assert len(chosen) == 30 and len(set(names["cells"][chosen].tolist())) == 30
    some = torch.randperm(2000)[:30]
    information = [idrgbdo_torch.information_from_rows(J[k].reshape(-1, 6), torch.ones(60)) for k in (chosen, some)]
    gained = idrgbdo_torch.entropy_reduction_bits(torch.linalg.inv(information[1]), torch.linalg.inv(information[0]))
    assert gained > 1.0  # bits better than chance


def test_every_public_name_is_documented() -> None:
    text = PAGE.read_text()
    listed = set(re.findall(r"`(\w+)`", text[text.index("## Names") :]))
    assert set(idrgbdo_torch.__all__) == listed
    assert idrgbdo_torch.__all__ == sorted(idrgbdo_torch.__all__)
    for name in idrgbdo_torch.__all__:
        thing = getattr(idrgbdo_torch, name)
        assert name in dir(idrgbdo_torch)
        if inspect.isclass(thing) or inspect.isfunction(thing):
            assert thing.__doc__ and not thing.__doc__.startswith(f"{name}("), f"{name} has no docstring"
            assert thing.__name__ == name
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        getattr(idrgbdo_torch, "nothing")  # noqa: B009


def test_no_public_name_is_a_file_s() -> None:
    """Once imported, a file of that name would hide it."""
    files = {path.stem for path in (ROOT / "idrgbdo_torch").iterdir()}
    assert not files & set(idrgbdo_torch.__all__)


def test_type_information_is_shipped_and_importing_takes_no_time() -> None:
    assert (ROOT / "idrgbdo_torch" / "py.typed").exists()
    code = "import sys, idrgbdo_torch; print(sorted({'torch', 'numpy', 'cv2', 'numba', 'open3d'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"
