"""compare(): every outcome once, failures as reasons, figures side by side."""

from __future__ import annotations

import csv
import io
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from comparison_methods import METHODS, other_settings
from recordings import write_recording

from idrgbdo_torch.commands.cli import main
from idrgbdo_torch.comparison import Comparison, External, Outcome, Source, compare, parse_external
from idrgbdo_torch.comparison.outcome import RESULTS, append_outcome, read_outcomes
from idrgbdo_torch.comparison.table import tables, to_csv, to_json, to_latex, to_markdown
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.trajectory import read_tum

ROOT = Path(__file__).parents[2]
MakeRecording = Callable[..., Path]


def lines(out: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in (out / RESULTS).read_text().splitlines()]


@pytest.fixture
def recording(make_recording: MakeRecording) -> Path:
    return make_recording("walk", frames=40)


@pytest.fixture(scope="module")
def comparison(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    folder = tmp_path_factory.mktemp("comparison")
    recording = write_recording(folder, "walk", frames=40)
    external = External("outside", recording / "groundtruth.txt")
    return compare(METHODS, [Source(recording)], folder / "out", seeds=2, externals=[external])


def test_every_outcome_stands_in_its_row(comparison: Comparison) -> None:
    rows = {row.method: row for row in comparison.rows("walk")}
    assert list(rows) == [*METHODS, "outside"]

    walks = rows["walks"]
    assert [outcome.seed for outcome in walks.outcomes] == [0, 1]
    assert walks.outcomes[0].ate_rmse_m != walks.outcomes[1].ate_rmse_m
    ate = walks.spread("ate_rmse_m")
    assert ate is not None and ate.count == 2 and ate.worst > ate.mean and ate.std > 0
    assert walks.track_ms is not None and 0 < walks.track_ms < 1000
    assert walks.peak_memory_mb is not None and 50 < walks.peak_memory_mb < 5000
    assert walks.spread("k2fe_mean_m") is None

    assert rows["loses"].lost == 1 and rows["loses"].reasons == {"dark": 1}
    assert rows["keyframes"].spread("k2fe_mean_m") is not None
    assert rows["raises"].error == "RuntimeError: the third frame was too much"
    assert "signal 9" in rows["killed"].error
    assert rows["outside"].outcomes[0].ate_rmse_m == pytest.approx(0, abs=1e-9)
    assert rows["outside"].track_ms is None
    fastest = min(rows[name].track_ms or 9e9 for name in ("walks", "loses", "keyframes"))
    assert rows["loses"].speedup == pytest.approx(fastest / (rows["loses"].track_ms or 0))


def test_agreement_needs_no_reference(comparison: Comparison) -> None:
    agreement = comparison.agreement("walk")
    assert agreement.methods == ("walks", "loses", "keyframes", "outside")
    assert agreement.of["loses", "keyframes"] == pytest.approx(0, abs=1e-6)
    assert agreement.of["walks", "outside"] == agreement.of["outside", "walks"]
    assert (agreement.of["walks", "outside"] or 0) > 0.01


def test_tables_in_every_form(comparison: Comparison) -> None:
    titles = [table.title for table in tables(comparison)]
    assert titles[0] == "walk" and "needs no reference" in titles[1]
    markdown = to_markdown(comparison)
    for name in (*METHODS, "outside"):
        assert f"| {name} |" in markdown
    assert "1 x dark" in markdown and "torch 2" in markdown and "±" in markdown
    cells = list(csv.DictReader(io.StringIO(to_csv(comparison))))
    assert [line["method"] for line in cells] == [*METHODS, "outside"]
    assert float(cells[0]["ate_rmse_m_worst"]) >= float(cells[0]["ate_rmse_m_mean"])
    assert json.loads(to_json(comparison))["agreement"][0]["sequence"] == "walk"


def test_what_is_done_is_not_repeated(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    methods = {name: METHODS[name] for name in ("loses", "raises")}
    first = compare(methods, [Source(recording)], out)
    ran: list[str] = []

    def again(**options: bool) -> Comparison:
        ran.clear()
        return compare(methods, [Source(recording)], out, on_progress=lambda p: ran.append(p.method), **options)

    second = again()
    assert set(ran) == {"raises"}  # what broke is tried again
    assert second.outcomes[0] == first.outcomes[0]
    del methods["raises"]
    methods["loses"] = replace(methods["loses"], settings=other_settings)
    again()
    assert "loses" in ran  # other settings, other result
    again(overwrite=True)
    assert "loses" in ran
    assert len(lines(out)) == 5 and len(read_outcomes(out)) == 3  # a retry and a repetition replaced what was there


def test_a_half_written_line_is_no_outcome(tmp_path: Path) -> None:
    outcome = Outcome("a", "s", 0, "c", {"torch": "1"}, frames=3)
    append_outcome(tmp_path, outcome)
    with (tmp_path / RESULTS).open("a") as file:
        file.write('{"method": "b", "seq')
    append_outcome(tmp_path, replace(outcome, method="c"))
    assert [found.method for found in read_outcomes(tmp_path).values()] == ["a", "c"]


def test_killed_half_way_it_goes_on_from_there(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = ["compare", str(recording), "--add", str(ROOT / "tests" / "comparison_methods.py"), "--out", str(out)]
    arguments += ["--methods", "loses,keyframes,walks", "--seeds", "2"]
    process = subprocess.Popen([sys.executable, "-m", "idrgbdo_torch", *arguments], cwd=ROOT)
    deadline = time.monotonic() + 120
    while not (out / RESULTS).exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.wait()
    before = lines(out)
    assert 1 <= len(before) < 4
    assert main(arguments) == 0
    after = lines(out)
    assert after[: len(before)] == before
    assert sorted((line["method"], line["seed"]) for line in after) == [
        ("keyframes", 0),
        ("loses", 0),
        ("walks", 0),
        ("walks", 1),
    ]


def test_the_documented_example_runs(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    text = (ROOT / "docs" / "comparison.md").read_text()
    code = text.split("```python\n")[1].split("```")[0]
    (tmp_path / "mine.py").write_text(code)
    monkeypatch.chdir(tmp_path)
    assert main(["compare", str(recording), "--add", "mine.py", "--methods", "mine", "--out", "cmp"]) == 0
    assert "| mine |" in capsys.readouterr().out
    assert "40/40 (39 weak)" in (tmp_path / "cmp" / "comparison.md").read_text()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--methods", "ours-42"], "did you mean 'ours-24'"),
        (["--add", "nothing.py"], "nothing.py"),
        (["--external", "dvo"], "NAME=FILE"),
        (["--external", "dvo@there=x.txt"], "no sequence 'there'"),
        (["--external", "../../evil=x.txt"], "a name that a folder can have"),
        (["--external", "..=x.txt"], "a name that a folder can have"),
        (["--external", "\x1b[31mred=x.txt"], "a name that a folder can have"),
        (["--methods", "constant-velocity", "--external", "constant-velocity=x.txt"], "is the name of a method"),
        (["--methods", "constant-velocity", "--external", "dvo=missing.txt"], "missing.txt"),
    ],
)
def test_mistakes_are_one_line(
    arguments: list[str], words: str, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compare", str(recording), "--out", str(tmp_path / "out"), *arguments]) == 1
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1


def test_results_of_other_frames_are_not_shown_with_the_poses_of_these(recording: Path, tmp_path: Path) -> None:
    methods, out = {"keyframes": METHODS["keyframes"]}, tmp_path / "out"
    ran: list[int] = []

    def lengths(max_frames: int | None) -> tuple[int, int]:
        ran.clear()
        source = Source(recording, max_frames=max_frames)
        found = compare(methods, [source], out, on_progress=lambda p: ran.append(p.frame)).outcomes[0]
        return found.frames, len(read_tum(out / found.folder / "trajectory.txt"))

    assert lengths(20) == (20, 20)
    assert lengths(None) == (40, 40)
    assert lengths(20) == (20, 20) and ran
    assert lengths(20) == (20, 20) and not ran


def test_the_results_of_an_edited_file_are_other_results(recording: Path, tmp_path: Path) -> None:
    code = (ROOT / "docs" / "comparison.md").read_text().split("```python\n")[1].split("```")[0]
    (tmp_path / "edited_later.py").write_text(code)
    call = ["compare", str(recording), "--add", str(tmp_path / "edited_later.py"), "--methods", "mine"]
    call += ["--out", str(tmp_path / "out"), "--max-frames", "3"]
    for expected in (1, 1):
        assert main(call) == 0 and len(lines(tmp_path / "out")) == expected
    (tmp_path / "edited_later.py").write_text(code + "\n# edited\n")
    assert main(call) == 0 and len(lines(tmp_path / "out")) == 2


@pytest.mark.parametrize("code", ["METHODS = {", "import nothing_of_this_name", "METHODS = 3", "x = 1 / 'a'"])
def test_a_file_that_cannot_be_imported_is_one_line(
    code: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "broken_methods.py"
    path.write_text(code + "\n")
    assert main(["compare", "x", "--add", str(path)]) == 1
    error = capsys.readouterr().err
    assert str(path) in error and error.count("\n") == 1


@pytest.mark.parametrize("name", ["report.html", "comparison.csv", "results.jsonl"])
def test_files_that_no_comparison_wrote_are_never_replaced(
    recording: Path, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / name).write_text("mine\n")
    assert main(["compare", str(recording), "--methods", "constant-velocity", "--out", str(out)]) == 1
    assert f"'{name}' that no comparison wrote" in capsys.readouterr().err
    assert [path.read_text() for path in out.iterdir()] == ["mine\n"]


def test_the_methods_can_be_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", "--methods", "list"]) == 0
    assert "after ORB-SLAM2" in capsys.readouterr().out


def test_an_external_trajectory_finds_its_sequence(make_recording: MakeRecording, tmp_path: Path) -> None:
    here, there = make_recording("here"), make_recording("there")
    sources = [Source(here), Source(there)]
    found = compare({}, sources, tmp_path / "out", externals=[External("truth", there / "groundtruth.txt")])
    assert [(o.method, o.sequence) for o in found.outcomes] == [("truth", "there")]
    elsewhere = tmp_path / "elsewhere.txt"
    elsewhere.write_text((here / "groundtruth.txt").read_text())
    with pytest.raises(IdRgbdoError, match="which sequence"):
        compare({}, sources, tmp_path / "out", externals=[External("truth", elsewhere)])
    named = compare({}, sources, tmp_path / "out", externals=[parse_external(f"truth@here={elsewhere}")])
    assert named.outcomes[0].sequence == "here"


def test_two_sequences_of_one_name_are_refused(make_recording: MakeRecording, tmp_path: Path) -> None:
    folder = make_recording("same")
    with pytest.raises(IdRgbdoError, match="twice"):
        compare({}, [Source(folder), Source(folder)], tmp_path / "out")


def test_latex_has_translation_and_rotation_and_the_best_of_each(comparison: Comparison) -> None:
    text = to_latex(comparison)
    head = next(line for line in text.splitlines() if line.lstrip().startswith("method"))
    assert [title.strip() for title in head.rstrip("\\ ").split("&")][:4] == [
        "method",
        "ATE mm",
        "RPE mm/s",
        "RPE deg/s",
    ]
    assert r"\toprule" in text and r"\textbf{0.00}" in text  # the outside trajectory is the reference itself
    assert text.count(r"\begin{table}") == 1 and text.startswith("% ATE")


def test_the_command_draws_figures_and_reads_recordings_as_told(
    make_recording: MakeRecording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = make_recording("bare", frames=40, calibration=None)
    out = tmp_path / "out"
    command = [
        "compare",
        str(folder),
        "--methods",
        "constant-velocity,opencv-rgb",
        "--out",
        str(out),
        "--max-frames",
        "35",
    ]
    assert main(command) == 1
    assert "intrinsics" in capsys.readouterr().err
    (tmp_path / "camera.toml").write_text("fx = 60\nfy = 60\ncx = 31.5\ncy = 23.5\n")
    reading = ["--camera", str(tmp_path / "camera.toml"), "--format", "tum", "--depth-scale", "2500"]
    assert main([*command, *reading, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert {row["method"] for row in answer["rows"]} == {"constant-velocity", "opencv-rgb"}
    source = Source(folder, 0, 1, 35, "tum", tmp_path / "camera.toml", 2500.0).open().read(0)
    assert float(source.depth.max()) == pytest.approx(3.0, abs=1e-3)  # type: ignore[union-attr]
    for suffix in ("tex", "svg", "pdf"):
        assert (out / f"comparison.{suffix}").stat().st_size > 500
