"""notebooks/quickstart.ipynb runs from top to bottom as it is stored."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

NOTEBOOK = Path(__file__).parent.parent / "notebooks" / "quickstart.ipynb"


def test_the_notebook_runs(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    from matplotlib import pyplot

    cells = [cell for cell in json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"]
    assert len(cells) >= 6 and not any(cell["outputs"] for cell in cells)  # stored without what they made
    names: dict[str, Any] = {"__name__": "__main__"}
    for number, cell in enumerate(cells):
        exec(compile("".join(cell["source"]), f"cell {number}", "exec"), names)
    assert len(pyplot.get_fignums()) == 3
    pyplot.close("all")
    said = capsys.readouterr().out
    assert "40 frames" in said and "points in the map" in said
    assert names["evaluation"].ate.rmse_m < 0.01
    assert [status.value for status in set(names["done"].statuses)] == ["ok"]
