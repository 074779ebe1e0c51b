"""The site of docs/ and the history of results."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from idrgbdo_torch import __version__

ROOT = Path(__file__).parent.parent


def test_the_site_builds_and_every_link_of_it_leads_somewhere(tmp_path: Path) -> None:
    pytest.importorskip("material")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    for page in (ROOT / "docs").glob("*.md"):
        built = tmp_path / "site" / ("" if page.stem == "index" else page.stem) / "index.html"
        assert "fonts.googleapis.com" not in built.read_text(encoding="utf-8")


def test_the_history_has_this_version_with_the_figures_of_its_tables() -> None:
    history = runpy.run_path(str(ROOT / "docs" / "results" / "history.py"))
    rows = [row for row in history["rows"]() if row["version"] == __version__]
    assert [row["method"] for row in rows] == list(history["METHODS"])
    for row in rows:
        assert set(row) == set(history["COLUMNS"]) and all(row.values())
        assert {name: row[name] for name in history["medians"](row["method"])} == history["medians"](row["method"])
