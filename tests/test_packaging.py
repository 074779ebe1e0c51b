"""What a wheel and a source distribution hold."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PARTS = ("idrgbdo_torch", "baselines", "configs", "docs", "integrations", "notebooks", "tests", ".ci")


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with a wheel and a source distribution of a copy of the repository."""
    copy = tmp_path_factory.mktemp("built") / "copy"
    for part in PARTS:
        shutil.copytree(ROOT / part, copy / part, ignore=shutil.ignore_patterns("__pycache__"))
    for path in ROOT.iterdir():
        if path.is_file() and path.name != ".git":
            shutil.copy(path, copy)
    command = [sys.executable, "setup.py", "-q", "sdist", "-d", "dist", "bdist_wheel", "-d", "dist"]
    subprocess.run(command, cwd=copy, capture_output=True, check=True)
    return copy / "dist"


def test_the_wheel_holds_one_package_with_all_that_it_needs(built: Path) -> None:
    (wheel,) = built.glob("*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    tops = {name.partition("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"idrgbdo_torch"}
    for folder, inside in (
        (ROOT / "idrgbdo_torch", ""),
        (ROOT / "baselines", "baselines/"),
        (ROOT / "configs", "configs/"),
    ):
        kept = [path for path in folder.rglob("*") if path.suffix in (".py", ".toml", ".js", ".css", ".typed")]
        assert len(kept) >= 3
        assert {f"idrgbdo_torch/{inside}{path.relative_to(folder).as_posix()}" for path in kept} <= names
    assert not [name for name in names if name.endswith((".pyc", ".nbi", ".nbc"))]


def test_installed_the_methods_come_from_the_package(built: Path, tmp_path: Path) -> None:
    (wheel,) = built.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(tmp_path)
    (tmp_path / "baselines.py").write_text("raise RuntimeError('another package of this name')\n")
    script = "from idrgbdo_torch.comparison.shipped import *; print(shipped_folder()); print(len(shipped_methods()))"
    script += "; print(shipped_methods()['constant-velocity'].make(0).name)"
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True)
    folder, count, name = done.stdout.splitlines()
    assert folder == str(tmp_path / "idrgbdo_torch" / "baselines")
    assert int(count) > 10 and "velocity" in name


def test_the_source_holds_what_tests_and_documents_need(built: Path) -> None:
    (archive,) = built.glob("*.tar.gz")
    with tarfile.open(archive) as file:
        names = {name.partition("/")[2] for name in file.getnames()}
    for folder in PARTS:
        kept = [path for path in (ROOT / folder).rglob("*") if path.is_file() and "__pycache__" not in path.parts]
        assert {path.relative_to(ROOT).as_posix() for path in kept} <= names
    assert {"constraints.txt", "mkdocs.yml", "CHANGELOG.md", "LICENSE", ".ci/run", "pyproject.toml"} <= names
