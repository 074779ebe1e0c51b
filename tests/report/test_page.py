"""The pages: everything in one file, nothing fetched, and every figure drawn by a real browser where there is one."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from comparison_methods import METHODS
from inspected import Inspected
from recordings import write_recording

from idrgbdo_torch.comparison import Comparison, External, Source, compare
from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.definitions.camera import Pinhole
from idrgbdo_torch.definitions.se3 import exp
from idrgbdo_torch.evaluation import absolute_error, evaluate
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.odometry import Status, TrackResult, run
from idrgbdo_torch.report import Glimpse, comparison_page, figures, run_page, watch
from idrgbdo_torch.report.charts import FREEDOMS
from idrgbdo_torch.report.figures import Line
from idrgbdo_torch.runs.folder import RunFolder
from idrgbdo_torch.tracker.mapping import Cloud
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


class Mapping(Inspected):
    """Has a map of 9 points, of its frames 0 and 6."""

    xyz = np.random.default_rng(1).uniform(-1.0, 1.0, (9, 3)).astype(np.float32)
    rgb = np.column_stack([np.arange(9)] * 3).astype(np.uint8)

    def maps(self) -> dict[int, Cloud]:
        time = np.where(np.arange(9) % 2, self._times[0], self._times[6])
        origin = np.column_stack([time, np.zeros((9, 2))])
        return {0: Cloud(self.xyz, self.rgb, np.zeros((9, 3), np.float32), origin)}


class Crowded(Inspected):
    """Tracks many points and has a large map."""

    def last_points(self) -> tuple[torch.Tensor, torch.Tensor]:
        grid = torch.rand(200, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(len(self._times)))
        return grid * torch.tensor([319.0, 239.0]), 3.0 * grid[:, 0]

    def maps(self) -> dict[int, Cloud]:
        rng = np.random.default_rng(0)
        xyz = rng.normal(size=(100_000, 3)).astype(np.float32)
        rgb = rng.integers(0, 255, (100_000, 3)).astype(np.uint8)
        return {0: Cloud(xyz, rgb, np.zeros_like(xyz), np.zeros((100_000, 3)))}


@pytest.fixture(scope="module")
def run_html(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("run")
    sequence = open_sequence(write_recording(folder, "walk", frames=40))
    odometry = Chatty(torch.tensor([0.3, 0, 0, 0, 0.1, 0], dtype=torch.float64))
    glimpses: list[Glimpse] = []
    with RunFolder(folder / "out", "points = 24\n") as run_folder:
        done = run(odometry, watch(sequence, odometry, glimpses), run_folder.append)
        assert sequence.groundtruth is not None
        run_folder.finish(done, odometry, evaluate(done.trajectory(), sequence.groundtruth))
    return run_page(folder / "out", "a <walk>", sequence.groundtruth, glimpses, sequence.camera)


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    folder = tmp_path_factory.mktemp("comparison")
    recordings = [write_recording(folder, name, frames=40) for name in ("here", "there")]
    methods = {name: METHODS[name] for name in ("loses", "raises")}
    external = External("outside", recordings[0] / "groundtruth.txt")
    return compare(methods, [Source(each) for each in recordings], folder / "out", externals=[external])


def data_of(html: str) -> dict[str, Any]:
    """What the scripts of a run's page read."""
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', html, re.DOTALL)
    assert found
    return dict(json.loads(found[1]))


def unpacked(text: str, kind: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), kind)


def test_a_run_shows_all_there_is(run_html: str) -> None:
    for heading in ("Map", "Error", "Certainty", "Time", "Doubts", "Configuration"):
        assert f">{heading}</h2>" in run_html
    assert "a &lt;walk&gt;" in run_html and "<walk>" not in run_html
    assert "dark &amp; &lt;stormy&gt;" in run_html and "<stormy>" not in run_html
    assert "points = 24" in run_html and "40/40" not in run_html and "39/40" in run_html
    assert "39 ok, 0 weak, 1 lost" in run_html
    data = data_of(run_html)
    status = unpacked(data["status"], "u1")
    assert len(status) == 40 and np.flatnonzero(status == 2).tolist() == [4]
    assert data["reasons"] == {"4": "dark & <stormy>"}
    assert unpacked(data["keyframes"], "<u4").tolist() == [0, 10, 20, 30]
    bits = next(chart for chart in data["charts"] if chart["unit"] == "bits")
    assert [one["name"] for one in bits["series"]] == list(FREEDOMS)
    np.testing.assert_allclose(unpacked(bits["series"][2]["values"], "<f4")[:3], [-7.9, -7.8, -7.7], rtol=1e-6)


def test_every_frame_has_its_points_and_image(run_html: str) -> None:
    kept = data_of(run_html)["scene"]["glimpses"]
    assert unpacked(kept["frame"], "<u4").tolist() == list(range(40))
    assert sorted(map(int, kept["images"])) == list(range(40))
    assert base64.b64decode(kept["images"]["3"]).startswith(b"\xff\xd8\xff")
    points = unpacked(kept["points"], "<u2").reshape(40, 2, 4)
    px, mm, bits = kept["steps"]
    np.testing.assert_allclose(points[7, :, :2] / px, [[10.0, 20.0], [30.5, 5.0]])
    np.testing.assert_allclose(points[7, :, 3] / bits, [0.5, 2.0])
    assert (points[7, :, 2] / mm > 0.1).all()


def test_poses_map_and_reference_lie_in_one_upright_world(tmp_path: Path) -> None:
    sequence = open_sequence(write_recording(tmp_path, "walk", frames=12))
    odometry = Mapping(torch.tensor([0.3, 0, 0, 0, 0.1, 0], dtype=torch.float64))
    with RunFolder(tmp_path / "out") as folder:
        folder.finish(run(odometry, sequence, folder.append), odometry)
    assert sequence.groundtruth is not None
    drawn = data_of(run_page(tmp_path / "out", "walk", sequence.groundtruth))["scene"]
    poses = unpacked(drawn["poses"], "<f4").reshape(-1, 3, 4)
    np.testing.assert_allclose(poses[:, 2, 1].mean(), -1.0, atol=1e-3)  # the image's down axis points down
    estimate = odometry.trajectory()
    apart = torch.cdist(estimate.positions, torch.from_numpy(odometry.xyz).double())
    packed = drawn["map"]
    xyz = np.array(packed["low"]) + packed["step"] * unpacked(packed["xyz"], "<u2").reshape(-1, 3)
    assert packed["total"] == len(xyz) == 9
    order = np.lexsort(unpacked(packed["rgb"], "u1").reshape(-1, 3).T[:1])  # red numbers the points
    np.testing.assert_allclose(np.linalg.norm(poses[:, None, :, 3] - xyz[order], axis=2), apart, atol=1e-3)
    seen = unpacked(packed["frame"], "<u4")
    assert (np.diff(seen.astype(int)) >= 0).all() and set(seen) == {0, 6}
    line = unpacked(drawn["lines"]["reference"], "<f4").reshape(-1, 3)
    ate = absolute_error(estimate, sequence.groundtruth)
    np.testing.assert_allclose(np.linalg.norm(line[:12] - poses[:, :, 3], axis=1), ate.errors_m, atol=1e-5)


def test_a_frame_whose_time_came_twice_has_a_pose(tmp_path: Path) -> None:
    sequence = open_sequence(write_recording(tmp_path, "walk", frames=6))
    odometry = Chatty(torch.tensor([0.3, 0, 0, 0, 0.1, 0], dtype=torch.float64))
    with RunFolder(tmp_path / "out") as folder:
        folder.finish(run(odometry, sequence, folder.append), odometry)
    path = tmp_path / "out" / "frames.csv"
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join([*lines[:4], lines[3], *lines[4:]]))
    data = data_of(run_page(tmp_path / "out", "walk"))
    poses = unpacked(data["scene"]["poses"], "<f4").reshape(-1, 12)
    assert len(poses) == len(unpacked(data["times"], "<f4")) == 7
    np.testing.assert_array_equal(poses[2], poses[3])
    assert (poses[3] != poses[4]).any()


def test_a_long_run_leaves_a_small_page(tmp_path: Path) -> None:
    """1000 frames of texture that compresses badly, with 64 points each."""
    rng = np.random.default_rng(0)
    camera = Pinhole(width=320, height=240, fx=250.0, fy=250.0, cx=159.5, cy=119.5)
    coarse = torch.from_numpy(rng.integers(0, 255, (60, 80)).astype(np.float32))
    gray = coarse.repeat_interleave(4, 0).repeat_interleave(4, 1)
    frames = [RgbdFrame(k / 30, gray, torch.full((240, 320), 2.0), camera) for k in range(1000)]
    odometry, glimpses = Crowded(), list[Glimpse]()
    with RunFolder(tmp_path) as folder:
        folder.finish(run(odometry, watch(frames, odometry, glimpses), folder.append), odometry)
    html = run_page(tmp_path, "long", None, glimpses, camera)
    assert len(html) < 5_000_000
    kept = data_of(html)["scene"]["glimpses"]
    assert len(unpacked(kept["frame"], "<u4")) == 1000
    assert sorted(map(int, kept["images"])) == list(range(0, 1000, 8))


def test_what_is_kept_does_not_depend_on_a_break(tmp_path: Path) -> None:
    camera = Pinhole(width=16, height=12, fx=12.0, fy=12.0, cx=7.5, cy=5.5)
    frames = [RgbdFrame(k / 30, torch.zeros(12, 16), torch.ones(12, 16), camera) for k in range(2100)]
    whole, parts = list[Glimpse](), list[Glimpse]()
    assert len(list(watch(frames, Inspected(), whole))) == 2100
    list(watch(frames[:777], Inspected(), parts))
    list(watch(frames[777:], Inspected(), parts, first=777))
    assert [(one.number, len(one.jpeg)) for one in whole] == [(one.number, len(one.jpeg)) for one in parts]
    assert [one.number for one in whole] == list(range(0, 2100, 4))
    assert [one.number for one in whole if len(one.jpeg)] == list(range(0, 2100, 16))


def test_a_reference_that_does_not_overlap_is_left_out_with_the_reason(tmp_path: Path) -> None:
    sequence = open_sequence(write_recording(tmp_path, "walk", frames=6))
    odometry = Chatty(torch.tensor([0.3, 0, 0, 0, 0.1, 0], dtype=torch.float64))
    with RunFolder(tmp_path / "out") as folder:
        folder.finish(run(odometry, sequence, folder.append), odometry)
    truth = sequence.groundtruth
    assert truth is not None
    html = run_page(tmp_path / "out", "walk", Trajectory(truth.timestamps + 500, truth.T_world_cam))
    assert "The ground truth is not shown." in html and "do not overlap" in html
    assert ">Error</h2>" not in html and ">Map</h2>" in html


def test_ticks_of_a_logarithmic_axis_have_room() -> None:
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


def dumped(html: str, folder: Path, *more: str) -> str:
    """The page as a browser has it after its scripts; fails for anything bad that it says."""
    page = folder / "report.html"
    page.write_text(html, encoding="utf-8")
    flags = ["--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--enable-logging=stderr"]
    flags += ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--virtual-time-budget=20000", *more]
    command = [str(BROWSER), *flags, f"--user-data-dir={folder / 'profile'}", "--dump-dom", page.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=180)
    said = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    assert not [line for line in said if re.search("error|uncaught|webgl", line, re.IGNORECASE)], said
    return done.stdout


@pytest.mark.skipif(BROWSER is None, reason="needs chromium or google-chrome")
def test_a_browser_draws_every_figure_of_a_comparison(compared: Comparison, tmp_path: Path) -> None:
    html = comparison_page(compared)
    expected = html.count('class="plotly-graph-div"')
    assert expected > 3
    drawn = dumped(html, tmp_path)
    plots = re.split(r'class="plotly-graph-div', drawn)[1:]
    assert len(plots) == expected
    assert all("main-svg" in plot for plot in plots)
    assert drawn.count("<canvas") >= 1  # the figure in space


# walks through the page as a person does, and writes what is seen then into the page
VISIT = """<script>
const settled = () => new Promise(done => setTimeout(done, 200));
const colors = canvas => {
  const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data, seen = new Set();
  for (let k = 0; k < data.length; k += 4) seen.add(data[k] << 16 | data[k + 1] << 8 | data[k + 2]);
  return seen.size;
};
(async () => {
  const out = {}, by = id => document.getElementById(id), click = id => by(id).click(), text = id => by(id).textContent;
  for (let k = 0; k < 30 && Math.min(...[...document.querySelectorAll("canvas")].map(colors)) < 3; k++) await settled();
  out.end = text("about");
  out.colors = {};
  document.querySelectorAll("canvas").forEach((c, k) => { out.colors[c.id || "chart" + k] = colors(c); });
  out.wide = document.documentElement.scrollWidth > window.innerWidth;
  click("doubt"); await settled();
  out.doubt = [text("state"), text("reason"), by("slider").value];
  by("slider").value = 10;
  by("slider").dispatchEvent(new Event("input")); await settled();
  out.ten = [text("about"), document.querySelector(".legend b").textContent];
  click("view-above"); await settled(); out.above = player.scene.pitch;
  click("view-behind"); await settled();
  document.querySelector("[data-layer=keyframes]").click(); await settled(); out.layers = player.scene.shown;
  click("play");
  for (let k = 0; k < 30 && player.frame < 39; k++) await settled();
  out.played = player.frame;
  document.body.append(Object.assign(document.createElement("pre"), {id: "visit", textContent: JSON.stringify(out)}));
})();
</script>"""


@pytest.mark.skipif(BROWSER is None, reason="needs chromium or google-chrome")
@pytest.mark.parametrize("width", [1400, 420])
def test_a_browser_shows_a_run_and_the_slider_moves_all_of_it(run_html: str, tmp_path: Path, width: int) -> None:
    drawn = dumped(run_html.replace("</body>", VISIT + "</body>"), tmp_path, f"--window-size={width},900")
    found = re.search(r'<pre id="visit">(.*?)</pre>', drawn, re.DOTALL)
    assert found, "a script stopped"
    seen = json.loads(unescape(found[1]))
    assert seen["end"].startswith("frame 39 of 40 · 1.30 s") and "2 points" in seen["end"]
    assert len(seen["colors"]) == 3 + run_html.count("data-chart=") > 5
    assert min(seen["colors"].values()) >= 3, seen["colors"]
    assert not seen["wide"]
    assert seen["doubt"] == ["lost", "dark & <stormy>", "4"]
    assert "frame 10 of 40" in seen["ten"][0] and "keyframe" in seen["ten"][0] and float(seen["ten"][1]) >= 0
    assert seen["above"] > 1.5 and seen["layers"] == {"keyframes": False}
    assert seen["played"] == 39
