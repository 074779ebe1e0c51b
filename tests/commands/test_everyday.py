"""What every command offers: help that begins with what people need, presets, near names, completion, quiet, JSON."""

from __future__ import annotations

import json
import os
import pty
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from idrgbdo_torch.commands.cli import ACTIONS, main, parse
from idrgbdo_torch.commands.output import answer, as_json, collected
from idrgbdo_torch.commands.run import RunCommand
from idrgbdo_torch.config import PRESETS, Config, settings_file
from idrgbdo_torch.text import configfile

ROOT = Path(__file__).parents[2]
TEN = ("out", "config", "map", "figures", "viewer", "resume", "camera", "depth-scale", "format", "max-frames")
NAMES = [command.__name__.removesuffix("Command").lower() for command in ACTIONS]


def helped(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    with pytest.raises(SystemExit) as end:
        main([*words, "--help"])
    assert end.value.code == 0
    return capsys.readouterr().out


def test_help_of_run_begins_with_the_ten_options_that_people_need(capsys: pytest.CaptureFixture[str]) -> None:
    blocks: list[str] = []
    for line in (line.strip("│ ") for line in helped(capsys, "run").splitlines()):
        if re.match(r"(-\w, )?--\w", line):
            blocks.append(line)
        elif blocks:
            blocks[-1] += " " + line
    assert tuple(re.findall(r"--([\w-]+)", block)[0] for block in blocks[1:11]) == TEN  # after --help
    assert all("(default:" in block for block in blocks[1:11])


@pytest.mark.parametrize("name", NAMES)
def test_every_command_can_be_quiet_and_answer_in_json(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    if name != "completion":
        assert "--quiet" in (shown := helped(capsys, name)) and "--json" in shown


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_known_by_name(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    command = parse(["run", "somewhere", "--config", name])
    assert isinstance(command, RunCommand)
    assert command.settings == configfile.load(ROOT / "configs" / f"{name}.toml", Config()) != Config()
    Path(name).write_text("seed = 7\n")  # a file goes before a name
    assert settings_file(Path(name)) == Path(name)


def test_the_wheel_carries_the_presets(tmp_path: Path) -> None:
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tmp_path)
    for name in ("configs", "idrgbdo_torch", "baselines"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    build = [sys.executable, "setup.py", "-q", "bdist_wheel", "-d", "dist"]
    subprocess.run(build, cwd=tmp_path, capture_output=True, check=True)
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert {f"idrgbdo_torch/configs/{name}.toml" for name in PRESETS} <= set(names)
    sources = {str(path.relative_to(ROOT)) for path in (ROOT / "idrgbdo_torch").rglob("*.py")}
    assert sources <= set(names) and "idrgbdo_torch/py.typed" in names
    unpacked = tmp_path / "site"
    zipfile.ZipFile(wheel).extractall(unpacked)
    script = "from pathlib import Path; from idrgbdo_torch.config import *; print(settings_file(Path('fast')))"
    found = subprocess.run([sys.executable, "-c", script], cwd=unpacked, capture_output=True, text=True, check=True)
    assert found.stdout.strip() == str(unpacked / "idrgbdo_torch" / "configs" / "fast.toml")


@pytest.mark.parametrize(
    ("words", "hint"),
    [(["rnu", "x"], "did you mean 'run'?"), (["evalute"], "did you mean 'evaluate'?"), (["qqq"], "the commands are")],
)
def test_a_command_that_is_none_names_the_nearest(
    words: list[str], hint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        main(words)
    error = capsys.readouterr().err
    assert end.value.code == 2 and error.count("\n") == 1 and hint in error


def test_a_folder_in_place_of_a_command_is_what_run_takes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([str(tmp_path)])
    assert f"idrgbdo run {tmp_path}" in capsys.readouterr().err


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_knows_commands_and_flags(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert all(word in script for word in (*NAMES, "--selection.points", "--depth-scale"))


def test_bash_completes_the_words(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "bash"]) == 0
    (tmp_path / "words.sh").write_text(capsys.readouterr().out)
    ask = (
        "source ./words.sh; COMP_WORDS=(idrgbdo run --selection.mo); COMP_CWORD=2; "
        'COMP_LINE="idrgbdo run --selection.mo"; COMP_POINT=${#COMP_LINE}; '
        'name=$(complete -p idrgbdo | sed "s/.*-F \\([^ ]*\\).*/\\1/"); '
        '$name; echo "${COMPREPLY[@]}"'
    )
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    done = subprocess.run(["bash", "-c", ask], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.stdout.split() == ["--selection.mode"]


def test_json_is_one_object_and_nothing_else(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = ["--frames", "3", "--width", "80", "--height", "60", "--fx", "65", "--fy", "65", "--cx", "39.5"]
    assert main(["synth", str(tmp_path / "scene"), *scene, "--cy", "29.5", "--samples", "1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"status": 0, "frames": 3, "folder": str(tmp_path / "scene")}
    assert main(["run", str(tmp_path / "scene"), "--out", str(tmp_path / "out"), "--json"]) == 0
    shown = capsys.readouterr()
    answered = json.loads(shown.out)
    assert shown.err == "" and shown.out.count("\n") == 1
    assert (answered["frames"], answered["folder"]) == (3, str(tmp_path / "out"))
    assert {"evaluation", "timing_ms", "report"} <= set(answered)
    assert main(["run", str(tmp_path / "scene"), "--out", str(tmp_path / "out"), "-q"]) == 0
    assert capsys.readouterr().out == ""


def test_json_of_an_error_is_an_object_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(tmp_path / "nowhere"), "--json"]) == 1
    shown = capsys.readouterr()
    answered = json.loads(shown.out)
    assert answered["status"] == 1 and answered["error"].startswith("sequence: expected a folder")
    assert shown.err == f"error: {answered['error']}\n"


def test_numbers_that_are_none_are_null_and_paths_absolute(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with collected() as facts:
        answer(rpe=float("nan"), rows=({"out": Path("x")},))
    answer(late=1)
    assert json.loads(as_json(facts)) == {"rpe": None, "rows": [{"out": str(tmp_path / "x")}]}


def test_the_demo_shows_progress_while_it_renders_and_compiles_and_how_to_go_on(tmp_path: Path) -> None:
    """On a terminal, where no kernel has been compiled yet."""
    script = (
        "import sys; from idrgbdo_torch.commands import demo; from idrgbdo_torch.commands.cli import main\n"
        "from idrgbdo_torch.synthetic import SynthConfig\n"
        "demo.DEMO = SynthConfig(frames=6, width=80, height=60, fx=65, fy=65, cx=39.5, cy=29.5, samples=1)\n"
        "from numba import njit; from numba.core.event import install_listener\n"
        "from idrgbdo_torch.tracker import warmup\n"
        "def few(make, on_function=None):  # one kernel that is in no cache, where the others may be\n"
        "    with install_listener('numba:compile', warmup.Telling(on_function)): njit(lambda x: x + 1)(1)\n"
        "warmup.warm_up = few\n"
        "sys.exit(main(['demo']))"
    )
    ours, theirs = pty.openpty()
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path), "COLUMNS": "200", "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen([sys.executable, "-c", script], stdout=theirs, cwd=tmp_path, env=environment)
    os.close(theirs)
    shown = b""
    while True:
        try:
            shown += os.read(ours, 65536)
        except OSError:
            break
    text = re.sub(r"\x1b\[[\d;?]*\w", "", shown.decode())  # without colours and moves of the cursor
    assert process.wait(60) == 0
    assert "rendering" in text and "6/6" in text and "compiling the kernels" in text
    assert text.split("\n")[-2].strip().startswith("now your own: idrgbdo run ")
    assert re.search(rf"{re.escape(str(tmp_path))}/runs/demo/\S+/report\.html", text)
