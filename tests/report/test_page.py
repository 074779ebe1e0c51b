"""The pages: everything in one file, nothing fetched, and every figure drawn by a real browser where there is one."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
import torch
from comparison_methods import METHODS
from inspected import Inspected
from recordings import write_recording

from idrgbdo_torch.comparison import Comparison, External, Source, compare
from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.definitions.se3 import exp
from idrgbdo_torch.evaluation import evaluate
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.odometry import Status, TrackResult, run
from idrgbdo_torch.report import Snapshot, comparison_page, figures, run_page, series, watch
from idrgbdo_torch.report.figures import Line
from idrgbdo_torch.runs.folder import RunFolder
from idrgbdo_torch.trajectory import Trajectory


class Chatty(Inspected):
    """Reports everything a page can show."""

    def track(self, frame: RgbdFrame) -> TrackResult:
        result = super().track(frame)
        number = len(self._times)
        return TrackResult(
            result.T_world_cam,
            Status.LOST if number == 5 else Status.OK,
            "dark & <stormy>" if number == 5 else "",
            keyframe=number % 10 == 1,
            entropy_bits=tuple(-10.0 + 0.1 * number + k for k in range(6)),
        )

    def last_points(self) -> tuple[torch.Tensor, torch.Tensor]:
        return torch.tensor([[10.0, 20.0], [30.5, 5.0]]), torch.tensor([0.5, 2.0])


@pytest.fixture(scope="module")
def run_html(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("run")
    sequence = open_sequence(write_recording(folder, "walk", frames=40))
    odometry = Chatty(torch.tensor([0.3, 0, 0, 0, 0.1, 0], dtype=torch.float64))
    snapshots: list[Snapshot] = []
    with RunFolder(folder / "out", "points = 24\n") as run_folder:
        done = run(odometry, watch(sequence, odometry, {3, 20, 39}, snapshots), run_folder.append)
        assert sequence.groundtruth is not None
        run_folder.finish(done, odometry, evaluate(done.trajectory(), sequence.groundtruth))
    assert [snapshot.timestamp for snapshot in snapshots] == [sequence.timestamps[i] for i in (3, 20, 39)]
    return run_page(folder / "out", "a <walk>", sequence.groundtruth, snapshots)


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    folder = tmp_path_factory.mktemp("comparison")
    recordings = [write_recording(folder, name, frames=40) for name in ("here", "there")]
    methods = {name: METHODS[name] for name in ("loses", "raises")}
    external = External("outside", recordings[0] / "groundtruth.txt")
    return compare(methods, [Source(each) for each in recordings], folder / "out", externals=[external])


def test_a_run_shows_all_there_is(run_html: str) -> None:
    for heading in ("Trajectory", "Error", "Status", "Certainty", "Time", "Points", "Doubts", "Configuration"):
        assert f">{heading}</h2>" in run_html
    assert "a &lt;walk&gt;" in run_html and "<walk>" not in run_html
    assert "dark &amp; &lt;stormy&gt;" in run_html
    assert "points = 24" in run_html and "40/40" not in run_html and "39/40" in run_html
    assert run_html.count("data:image/jpeg;base64,") == 3
    assert run_html.count(" bits</title></circle>") == 6


def test_a_reference_that_does_not_overlap_is_left_out_with_the_reason(tmp_path: Path) -> None:
    sequence = open_sequence(write_recording(tmp_path, "walk", frames=6))
    odometry = Chatty(torch.tensor([0.3, 0, 0, 0, 0.1, 0], dtype=torch.float64))
    with RunFolder(tmp_path / "out") as folder:
        folder.finish(run(odometry, sequence, folder.append), odometry)
    truth = sequence.groundtruth
    assert truth is not None
    html = run_page(tmp_path / "out", "walk", Trajectory(truth.timestamps + 500, truth.T_world_cam))
    assert "The ground truth is not shown." in html and "do not overlap" in html
    assert ">Error</h2>" not in html and ">Status</h2>" in html


def test_statuses_over_time_show_how_many_and_why() -> None:
    statuses = ["ok"] * 5 + ["weak", "lost", "lost"] + ["ok"] * 4
    reasons = [f"because {k}" if status != "ok" else "" for k, status in enumerate(statuses)]
    drawn = series.statuses_over_time([k / 30 for k in range(12)], statuses, reasons, 11 / 30)
    named = {trace.name: trace for trace in drawn.data if trace.mode == "lines"}
    assert set(named) == {"ok, 9 of 12", "weak, 1 of 12", "lost, 2 of 12"}
    assert list(named["lost, 2 of 12"].x) == [6 / 30, 8 / 30, None]
    marks = [text for trace in drawn.data if trace.mode == "markers" for text in trace.text]
    assert sorted(marks) == ["because 5", "because 6", "because 7"]


def test_figures_over_time_share_one_axis_and_ticks_have_room() -> None:
    times = [k / 30 for k in range(12)]
    stages = {"waiting": [0.02 + k for k in range(12)], "tracking": [900.0] * 12}
    drawn = [
        series.milliseconds_over_time(times, stages, times[-1]),
        series.statuses_over_time(times, ["ok"] * 12, [""] * 12, times[-1]),
        series.entropy_over_time(times, [[1.0] * 6] * 12, [], times[-1]),
    ]
    assert len({(f.layout.xaxis.range, f.layout.margin.l, f.layout.margin.r) for f in drawn}) == 1
    for low, high in ((0.01, 3000.0), (0.9, 1.1), (5.0, 80.0), (1.0, 1000.0)):
        shown = [tick for tick in figures.decades([low, high]) if low / 2 <= tick <= 2 * high]
        assert 1 <= len(shown) <= figures.MOST_TICKS


def test_a_comparison_shows_every_method_and_sequence(compared: Comparison) -> None:
    html = comparison_page(compared)
    for word in (
        ">Results</h2>",
        ">here</h2>",
        ">there</h2>",
        ">Methods</h2>",
        "the third frame was too much",
        "1 x dark",
    ):
        assert word in html
    assert html.count('class="plotly-graph-div"') == 1 + 2 * 4
    assert ">outside<" in html


@pytest.mark.parametrize("which", ["run", "comparison"])
def test_nothing_is_fetched(which: str, run_html: str, compared: Comparison) -> None:
    html = run_html if which == "run" else comparison_page(compared)
    without_scripts = re.sub(r"<script.*?</script>", "", html, flags=re.DOTALL)
    assert not re.search(r"""(src|href)\s*=\s*["'](?!#|data:)""", without_scripts)
    assert not re.search(r"<script[^>]+src=", html)
    assert "@import" not in without_scripts and "url(" not in without_scripts


def test_lines_are_laid_onto_the_reference_and_a_short_one_is_left_out() -> None:
    times = torch.arange(20, dtype=torch.float64) / 10
    twists = torch.stack([torch.stack([t, t**2, t**3, 0 * t, 0.2 * t, 0 * t]) for t in times])
    truth = Trajectory(times, exp(twists))
    moved = Trajectory(times, exp(torch.tensor([1.0, 2, 3, 0.3, 0.2, 0.1], dtype=torch.float64)) @ truth.T_world_cam)
    short = truth.at(torch.tensor([0, 1]))
    lines = figures.aligned([Line("moved", moved, "red"), Line("short", short, "blue")], truth)
    assert [line.name for line in lines] == ["moved"]
    torch.testing.assert_close(lines[0].trajectory.positions, truth.positions)
    drawn = figures.trajectories_from_above(lines, truth)
    assert [trace.name for trace in drawn.data] == ["reference", "moved"]


def test_a_camera_held_upright_is_seen_from_above() -> None:
    forward = torch.eye(4, dtype=torch.float64).repeat(5, 1, 1)
    forward[:, 2, 3] = torch.arange(5, dtype=torch.float64)  # along the optical axis
    forward[:, 0, 3] = 0.5 * torch.arange(5, dtype=torch.float64)  # and to the right
    trajectory = Trajectory(torch.arange(5, dtype=torch.float64), forward)
    trace = figures.trajectories_from_above([Line("walk", trajectory, "red")], None).data[0]
    assert list(trace.y) == [0, 1, 2, 3, 4]  # away from the viewer is up the page
    assert list(trace.x) == [0, 0.5, 1, 1.5, 2]


BROWSER = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)


@pytest.mark.skipif(BROWSER is None, reason="needs chromium or google-chrome")
@pytest.mark.parametrize("which", ["run", "comparison"])
def test_a_browser_draws_every_figure(which: str, run_html: str, compared: Comparison, tmp_path: Path) -> None:
    html = run_html if which == "run" else comparison_page(compared)
    page = tmp_path / "report.html"
    page.write_text(html, encoding="utf-8")
    flags = ["--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--enable-logging=stderr"]
    flags += ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--virtual-time-budget=20000"]
    command = [str(BROWSER), *flags, f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", page.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=180)
    said = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    assert not [line for line in said if re.search("error|uncaught|webgl", line, re.IGNORECASE)], said
    expected = html.count('class="plotly-graph-div"')
    assert expected > 3
    plots = re.split(r'class="plotly-graph-div', done.stdout)[1:]
    assert len(plots) == expected
    assert all("main-svg" in plot for plot in plots)
    assert done.stdout.count("<canvas") >= 1  # the figure in space
