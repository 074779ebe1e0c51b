"""The README and the documents beside it: every command parses, every snippet runs, every link leads somewhere."""

from __future__ import annotations

import re
import shlex
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import cv2
import numpy as np
import pytest

from idrgbdo_torch import Status, read_tum
from idrgbdo_torch.commands import cli
from idrgbdo_torch.datasets.calibration import find_calibration
from idrgbdo_torch.synthetic import RenderedSequence, SynthConfig

ROOT = Path(__file__).parent.parent
README = ROOT / "README.md"
PAGES = [README, *sorted((ROOT / "docs").glob("*.md"))]
each_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
COMMANDS = {command.__name__.removesuffix("Command").lower() for command in get_args(cli.Command)}
VARIABLES = {"$kind": "desk", "$SOME": "fr1_desk,fr2_desk", "$ALL": "fr1_desk,fr2_xyz"}


def blocks(page: Path, language: str) -> list[str]:
    """The fenced blocks of a language, without their indentation in a list."""
    found = re.findall(rf"^( *)```{language}\n(.*?)^ *```", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    return ["".join(line.removeprefix(indent) for line in text.splitlines(keepends=True)) for indent, text in found]


def commands(page: Path) -> list[list[str]]:
    """The arguments of every `idrgbdo ...` in the shell blocks."""
    lines = [line.split(" #")[0].strip() for block in blocks(page, "sh") for line in block.splitlines()]
    parts = [part.strip() for line in lines for part in re.split(r"&&|;", line)]
    found = [shlex.split(part.removeprefix("do ")) for part in parts if re.match(r"(do )?idrgbdo ", part)]
    return [[re.sub(r"\$\w+", lambda name: VARIABLES[name[0]], word) for word in words[1:]] for words in found]


@pytest.fixture(scope="module")
def shots() -> list[tuple[float, np.ndarray, np.ndarray]]:
    """Seconds, RGB and depth in metres of a rendered camera of 640 x 480 pixels."""
    sequence = RenderedSequence(SynthConfig(frames=4, samples=1))
    frames = [sequence.read(index) for index in range(4)]
    return [(f.timestamp, f.color.numpy(), f.depth.numpy()) for f in frames if f.color is not None]


@pytest.fixture
def my_recording(
    shots: list[tuple[float, np.ndarray, np.ndarray]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Path:
    """The folder my_recording as the README's reader has it: images and camera.toml."""
    folder = tmp_path / "my_recording"
    for kind in ("rgb", "depth"):
        (folder / kind).mkdir(parents=True)
    for number, (_, rgb, depth) in enumerate(shots):
        cv2.imwrite(str(folder / "rgb" / f"{number:06}.png"), np.ascontiguousarray(rgb[..., ::-1]))
        cv2.imwrite(str(folder / "depth" / f"{number:06}.png"), (5000 * depth).round().astype(np.uint16))
    (folder / "camera.toml").write_text(blocks(README, "toml")[0])
    monkeypatch.chdir(tmp_path)
    return folder


def test_the_readme_documents_the_commands() -> None:
    assert {"run", "demo", "synth", "evaluate", "compare"} <= set(
        re.findall(r"idrgbdo (\w+)", " ".join(page.read_text() for page in PAGES))
    )
    assert len(commands(README)) >= 6


@each_page
def test_every_command_and_flag_exists(page: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)  # for --config configs/...
    for arguments in commands(page):
        cli.parse(arguments)


@each_page
def test_every_command_and_flag_named_in_the_text_exists(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shown = ""
    for command in COMMANDS:
        with pytest.raises(SystemExit):
            cli.main([command, "--help"])
        shown += capsys.readouterr().out
    known = set(re.findall(r"--[\w.-]+", shown)) | {"--help"}
    code = " ".join(x for x in re.findall(r"`([^`\n]+)`", page.read_text()) if not x.startswith("python -m tests."))
    flags = set(re.findall(r"(?<!\S)--[\w.-]+", code))
    assert flags <= known, f"no such flag: {sorted(flags - known)}"
    named = {name for name in re.findall(r"`idrgbdo ([a-z]+)", page.read_text())}
    assert named <= COMMANDS


@each_page
def test_every_setting_named_in_the_text_exists(page: Path) -> None:
    tables = {"noise", "selection", "tracking", "keyframe", "window"}
    from idrgbdo_torch.config import Config

    for table, key in re.findall(r"`(\w+)\.(\w+)(?:`| = )", page.read_text()):
        if table in tables and key != "py":
            assert hasattr(getattr(Config(), table), key), f"no setting {table}.{key}"


@each_page
def test_every_link_and_file_named_is_there(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
        if not target.startswith("http"):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"
    for name in re.findall(r"`(\w+\.py)`", page.read_text()):
        code = [path for folder in ("idrgbdo_torch", "integrations") for path in (ROOT / folder).rglob(name)]
        assert code, f"{page.name} names {name}"


def test_pictures_are_small() -> None:
    for path in (ROOT / "docs").rglob("*.png"):
        assert path.stat().st_size < 300_000, path


def test_installation_is_what_the_package_offers() -> None:
    lines = [line for block in blocks(README, "sh") for line in block.splitlines() if line.startswith("pip ")]
    assert lines == [
        "pip install -c constraints.txt . && idrgbdo demo",
        'pip install -c constraints.txt ".[test]" && pytest -n 2 --dist worksteal',
    ]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert "test" in project["optional-dependencies"]
    assert (ROOT / "constraints.txt").exists()


def test_the_version_is_the_same_everywhere() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert f"## {version}" in (ROOT / "CHANGELOG.md").read_text()
    assert f"version: {version}" in (ROOT / "CITATION.cff").read_text()


def test_the_camera_file_is_a_camera(tmp_path: Path) -> None:
    (tmp_path / "camera.toml").write_text(blocks(README, "toml")[0])
    camera = find_calibration(tmp_path, tmp_path / "camera.toml")
    assert (camera.fx, camera.cy, camera.depth_scale) == (525.0, 239.5, 5000.0)


def test_the_readers_own_folder_is_tracked_as_written(
    my_recording: Path, shots: list[tuple[float, np.ndarray, np.ndarray]], capsys: pytest.CaptureFixture[str]
) -> None:
    live, recorded = blocks(README, "python")
    names: dict[str, object] = {}
    exec(recorded, names)
    done = names["done"]
    assert [status for status in done.statuses] == [Status.OK] * 4  # type: ignore[attr-defined]
    assert len(read_tum(Path("trajectory.txt"))) == 4

    def my_camera() -> Iterator[tuple[float, np.ndarray, np.ndarray]]:
        yield from shots

    capsys.readouterr()
    exec(live, {"my_camera": my_camera})
    shown = capsys.readouterr().out.splitlines()
    assert len(shown) == 4
    assert all(" ok [" in line for line in shown)

    (command,) = [arguments for arguments in commands(README) if "--figures" in arguments]
    assert cli.main(command) == 0
    written = {path.name for path in Path("runs/my_recording/latest").iterdir()}
    table = re.findall(r"^\| `([\w./]+)` \|", README.read_text(), flags=re.MULTILINE)
    assert {name.rstrip("/") for name in table} - {"groundtruth.txt"} <= written | {"trajectory_refined.txt"}
