"""The experiments in miniature: rendered, measured, decided, drawn, and not repeated."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from dask_cluster import dask_cluster

from idrgbdo_torch.commands.cli import main
from idrgbdo_torch.config import Config
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.experiments import NAMES, ablation, faults, fig3, fig6, fig7, fig8, frontier, run_experiment, table1
from idrgbdo_torch.experiments import events as events_of
from idrgbdo_torch.experiments.lab import Lab, interval, write_report
from idrgbdo_torch.experiments.paper import TABLE_1
from idrgbdo_torch.experiments.relatives import RELATIVES
from idrgbdo_torch.experiments.rendering import RenderTask, Take, plan_rendering
from idrgbdo_torch.experiments.setup import clips_of, paper_config, planned_films, recorded_clips, rendered_clips
from idrgbdo_torch.experiments.sweep import Workers, read_results
from idrgbdo_torch.experiments.task import Measured, Task, measure
from idrgbdo_torch.odometry import Status, TrackResult

TWO = Workers(jobs=2)
PAIR = "fr2_xyz,fr3_structure_texture_near"


FEW_METHODS = ["open3d-tensor-hybrid", "opencv-rgb", "dense", "features", "edges", "constant-velocity"]


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Even less than quick."""
    monkeypatch.setattr(fig3, "QUICK_POINTS", (24, 96))
    monkeypatch.setattr(fig6, "QUICK_FACTORS", (0.2, 1.0, 3.0))
    monkeypatch.setattr(ablation, "QUICK", ("no depth residual", "selection: rand", "selection: grid", "no window"))
    monkeypatch.setattr(table1, "others", lambda methods, quick: FEW_METHODS)


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    """Two rendered sequences of 36 small frames."""
    folder = tmp_path_factory.mktemp("experiments")
    clips = rendered_clips(PAIR, 36, True, folder / "cache", None, TWO, lambda progress: None, shrink=4)
    return Lab(clips, folder / "out", TWO, quick=True, seeds=2, paper=paper_config(None))


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def report(lab: Lab, name: str) -> list[str]:
    """Run an experiment and write it down; its findings."""
    done = run_experiment(name, lab)
    lab.out.mkdir(parents=True, exist_ok=True)
    written = write_report(done, name, lab.out)
    assert {path.suffix for path in written} == {".md", ".png", ".svg", ".pdf", ".tex", ".csv"}
    picture = cv2.imread(str(lab.out / f"{name}.png"))
    assert picture is not None and picture.std() > 5
    return list(done.findings)


def test_fig3_to_fig5_share_their_runs(lab: Lab) -> None:
    found = report(lab, "fig3")
    rows = rows_of(lab.out / "fig3.csv")
    assert [(row["mode"], int(row["points"])) for row in rows] == [
        (mode, points) for mode in fig3.MODES for points in fig3.QUICK_POINTS
    ]
    errors = {(row["mode"], row["points"]): float(row["accumulated K2FE m"]) for row in rows}
    assert 0 < errors["inf+grid", "24"] < errors["rand", "24"] < 1.0
    assert errors["rand", "96"] < errors["rand", "24"]
    assert len(found) == 4
    done = (lab.out / "results.jsonl").read_text()
    assert len(done.splitlines()) == 4 * 2 * 2 * 2
    assert not any(result["error"] for result in read_results(lab.out / "results.jsonl").values())
    report(lab, "fig4")
    report(lab, "fig5")
    assert (lab.out / "results.jsonl").read_text() == done
    by_mode = [row for row in rows_of(lab.out / "fig4.csv") if row["mode"] == "inf+grid"]
    reduction = [float(row["entropy reduction bits"]) for row in by_mode]
    assert 0 < reduction[0] < reduction[1]
    for row in by_mode:
        assert float(row["entropy bits"]) + float(row["entropy reduction bits"]) == pytest.approx(
            float(by_mode[0]["entropy bits"]) + reduction[0], abs=1e-3
        )


def test_table1_and_fig1(lab: Lab) -> None:
    few = replace(lab, seeds=1)
    found = report(few, "table1")
    rows = rows_of(few.out / "table1_rpe.csv")
    assert [row["sequence, RPE mm/s"] for row in rows] == PAIR.split(",")
    assert float(rows[0]["paper: ID-RGBDO"]) == 3.0 and rows[0]["paper: DVO"] == ""
    measured = ("ours-24", "ours-256", "paper-24", "dense", "open3d-tensor-hybrid", "opencv-rgb", "features", "edges")
    for name in measured:
        assert all(float(row[name]) > 0 for row in rows), name
    assert "ours-24" in found[0] and "dense" in found[1]
    assert {path.stem for path in few.out.glob("table1*.csv")} == {
        *("table1_rpe", "table1_rpe_deg", "table1_ate", "table1_lost", "table1_ms", "table1_total")
    }
    assert "ms with 24 points" in report(few, "fig1")[0]


def test_fig6_and_the_ablation(lab: Lab) -> None:
    few = replace(lab, clips=lab.clips[:1], seeds=1)
    assert [line[:9] for line in report(few, "fig6")] == ["bits: RPE", "bits: ATE"]
    keyframes = [float(row["keyframes %"]) for row in rows_of(few.out / "fig6.csv")]
    assert keyframes[0] > keyframes[-1]
    report(few, "ablation")
    rows = {row["switch"]: row for row in rows_of(few.out / "ablation.csv")}
    assert list(rows) == ["default", *ablation.QUICK, "all as printed"]
    assert float(rows["default"]["RPE x"]) == float(rows["default"]["K2FE x"]) == 1.0
    numbers = {(row["RPE x"], row["ATE x"], row["K2FE x"]) for row in rows.values()}
    assert len(numbers) == 6  # the switches do something


def test_the_frontier_is_what_nothing_beats(lab: Lab) -> None:
    found = report(replace(lab, clips=lab.clips[:1]), "frontier")
    assert [line.split(" is ")[0] for line in found] == list(frontier.PRESETS)
    rows = rows_of(lab.out / "frontier.csv")
    assert len(rows) == 3 + 4  # 24 tracked, three numbers refined; 256 of either
    best = [row for row in rows if row["on the frontier"]]
    errors = [float(row["RPE mm/s"]) for row in best]
    assert best[0] is rows[0] and errors == sorted(errors, reverse=True)
    assert min(errors) == min(float(row["RPE mm/s"]) for row in rows)
    settings = [
        frontier.Setting(str(k), rpe, 1.0, 1.0, ms, 0.0) for k, (rpe, ms) in enumerate([(3, 1), (2, 2), (2.5, 3)])
    ]
    assert [setting.name for setting in frontier.frontier(settings)] == ["0", "1"]
    assert [frontier.excess(setting, settings) for setting in settings] == [1.0, 1.0, 1.25]


def test_other_takes_are_other_films(tmp_path: Path) -> None:
    def film(take: Take, trajectories: Path | None) -> RenderTask:
        (task,) = plan_rendering(["fr1_xyz"], 5, tmp_path, trajectories, take=take)
        return task

    path = tmp_path / "freiburg1_xyz.txt"
    path.write_text("0 0 0 0 0 0 0 1\n9 1 0 0 0 0 0 1\n")
    first, later, look = (film(take, tmp_path) for take in (Take(), Take(later=3.0), Take(look=1)))
    assert (later.config.start - first.config.start, later.config.seed) == (3.0, first.config.seed)
    assert look.config.start == first.config.start and look.config.seed != first.config.seed
    assert len({task.folder for task in (first, later, look)}) == 3
    assert film(Take(later=3.0), None).config.start == 0.0  # a built-in path has no other stretches, but other looks
    assert film(Take(look=1), None).config.seed != film(Take(), None).config.seed


def test_cost_of_tracking_and_of_the_window() -> None:
    tracking = fig7.survey(5, (24, 192), shrink=4)
    assert tracking[1][1] > 1.2 * tracking[0][1] > 0  # more points cost more
    assert all(row[3] > row[2] for row in tracking)  # choosing and tracking cost more than choosing
    assert "times as much" in fig7.report(tracking).findings[0]
    window = fig8.survey(2, (24, 96), (4, 6), shrink=4)
    ms = {(row[0], row[1]): row[2] for row in window}
    assert ms[96, 6] > ms[24, 4] > 0
    assert fig8.report(window).figure is not None


def test_a_task_is_known_by_what_decides_its_result(lab: Lab) -> None:
    clip = lab.clips[0]
    task = Task(clip, config=Config())
    assert task.key == Task(replace(clip, folder=Path("/elsewhere"))).key
    others = [
        Task(clip, config=Config(), seed=1),
        Task(clip.shifted(1, 2), config=Config()),
        Task(clip, "opencv-rgb"),
        Task(clip, config=fig3.configured("grid", 24)),
        Task(lab.clips[1], config=Config()),
    ]
    assert len({task.key, *(other.key for other in others)}) == 6
    assert clip.shifted(2, 3).start == 2 and clip.shifted(2, 3).frames == clip.shifted(0, 3).frames == 34


def test_here_and_in_other_processes_the_numbers_are_the_same(lab: Lab) -> None:
    tasks = [Task(clip.shifted(seed, 2), config=fig3.configured("rand", 24), seed=seed)
             for clip in lab.clips for seed in range(2)]  # fmt: skip
    apart = lab.measure(tasks)
    for task, there in zip(tasks, apart, strict=True):
        here = measure(task)
        # but for rounding: torch sums in as many parts as it has threads
        assert (here["k2fe_mean_m"], here["ate_m"], here["rpe_m_per_s"]) == pytest.approx(
            (there.k2fe_mean_m, there.ate_m, there.rpe_m_per_s), rel=1e-9
        )
        assert here["frames"] == there.frames == 35


def test_a_cluster_gives_the_same_numbers(lab: Lab, tmp_path: Path) -> None:
    tasks = [Task(clip, config=Config(), seed=seed) for clip in lab.clips for seed in range(3)]

    def numbers(found: list[Measured]) -> list[tuple[float | None, ...]]:
        return [(run.ate_m, run.rpe_m_per_s, run.k2fe_mean_m, run.entropy_bits, run.keyframes) for run in found]

    with dask_cluster(tmp_path) as cluster:
        remote = replace(lab, workers=Workers(cluster=cluster.address), out=tmp_path / "remote")
        assert numbers(remote.measure(tasks)) == numbers(lab.measure(tasks))
    assert len((tmp_path / "remote" / "results.jsonl").read_text().splitlines()) == len(tasks)


def test_a_task_that_breaks_is_reported_not_raised(lab: Lab) -> None:
    gone = replace(lab.clips[0], folder=lab.out / "gone", digest="gone")
    (broken,) = lab.measure([Task(gone)])
    assert "expected a folder" in broken.error and broken.rpe_m_per_s is None


def point(mode: str, points: int, k2fe: float, half: float = 0.01) -> fig3.Point:
    return fig3.Point(mode, points, k2fe, half, 0.0, ())  # type: ignore[arg-type]


def test_fig3_says_what_the_numbers_say() -> None:
    good = {"rand": (1.0, 0.5), "grid": (0.8, 0.4), "inf": (0.6, 0.3), "inf+grid": (0.6, 0.3)}
    lines = fig3.findings([point(m, n, e) for m, es in good.items() for n, e in zip((24, 48), es, strict=True)])
    assert "2 of 2" in lines[0] and "2 of 2" in lines[1] and "do not overlap" in lines[2]
    assert lines[3].endswith("about 43 points")  # 1.0 to 0.5 from 24 to 48 passes 0.6 there
    bad = {**good, "inf+grid": (0.99, 0.2)}
    lines = fig3.findings([point(m, n, e) for m, es in bad.items() for n, e in zip((24, 48), es, strict=True)])
    assert "1 of 2 numbers of points (48)" in lines[0] and "1 of 2" in lines[1] and "OVERLAP" in lines[2]


def test_fig6_says_where_the_minimum_is() -> None:
    def levels(errors: list[float]) -> list[fig6.Level]:
        return [
            fig6.Level("bits", factor, 0.35 * factor, error, 0.1, error, 0.1, 5.0, 0.0)
            for factor, error in zip((0.5, 1.0, 2.0), errors, strict=True)
        ]

    assert "inside the range; the default 0.35 is at it" in fig6.findings(levels([1.2, 0.9, 1.1]))[0]
    assert "AT THE END OF the range; the default 0.35 is NOT AT it" in fig6.findings(levels([1.2, 1.0, 0.8]))[0]


def test_table1_says_who_is_ahead() -> None:
    def run(rpe: float | None, ms: float = 1.0, error: str = "") -> Measured:
        return Measured("s", "m", 0, error, 10, rpe_m_per_s=rpe, ms_median=ms)

    names = ["a", "b"]
    results = {
        ("ours-24", "a"): run(0.01), ("ours-24", "b"): run(0.02),
        ("ours-256", "a"): run(0.01), ("ours-256", "b"): run(0.04),
        ("dense", "a"): run(0.01, 40.0), ("dense", "b"): run(0.02, 10.0),
        ("opencv-rgb", "a"): run(None, error="it broke"), ("opencv-rgb", "b"): run(0.015),
    }  # fmt: skip
    lines = table1.findings(results, ["ours-24", "ours-256", "dense", "opencv-rgb"], names)
    assert lines[0].endswith("1 of 2 sequences (not on b)")
    assert "1 of 2 sequences (not on b), at 0.050 of its time (1 of 2" in lines[1]
    assert lines[-1] == "opencv-rgb broke on a: it broke"


def test_intervals() -> None:
    assert interval([2.0]) == (2.0, pytest.approx(float("nan"), nan_ok=True))
    mean, half = interval([1.0, 2.0, 3.0, 4.0])
    assert mean == 2.5 and half == pytest.approx(3.182 * 1.29099 / 2, rel=1e-3)


def test_every_switch_is_a_setting_that_differs_from_the_default() -> None:
    for name, changes in ablation.SWITCHES.items():
        assert ablation.switched(changes) != Config(), name
    assert set(ablation.QUICK) <= set(ablation.SWITCHES)


def test_the_relatives_are_those_of_table_1() -> None:
    assert [relative.name for relative in RELATIVES] == list(TABLE_1)


def test_recordings_in_a_folder(tmp_path: Path, make_recording: Callable[..., Path]) -> None:
    for name in ("rgbd_dataset_freiburg3_cabinet", "another", "rgbd_dataset_freiburg1_desk"):
        make_recording(name=name)
    (tmp_path / "no_recording").mkdir()
    clips = recorded_clips(tmp_path, "", 3)
    assert [clip.name for clip in clips] == ["fr1_desk", "fr3_cabinet", "another"]
    assert clips[0].length == 4 and clips[0].frames == 3
    assert [clip.name for clip in recorded_clips(tmp_path, "another", None)] == ["another"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["fig3"], "expected either --rendered or --data"),
        (["fig3", "--rendered", "--data", "."], "expected either --rendered or --data"),
        (["fig3", "--data", "nowhere"], "see idrgbdo download tum"),
        (["fig3", "--data", "."], "no recording with rgb.txt"),
        (["fig3", "--rendered", "--sequences", "fr9"], "no rendered sequence 'fr9'"),
        (["fig3", "--rendered", "--trajectories", "."], "leave it out"),
    ],
)
def test_wrong_calls(
    arguments: list[str],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["experiment", *arguments, "--cache", str(tmp_path / "cache")]) == 1
    assert words in capsys.readouterr().err


def test_the_command(lab: Lab, capsys: pytest.CaptureFixture[str]) -> None:
    folder = lab.clips[0].folder.parent
    call = ["experiment", "fig5", "--data", str(folder), "--quick", "--seeds", "2", "--jobs", "2"]
    assert main([*call, "--out", str(lab.out)]) == 0
    shown = capsys.readouterr()
    assert "| fr2_xyz | 24 |" in shown.out and "fig5.csv" in shown.out
    assert np.isfinite([float(row["mean K2FE mm"]) for row in rows_of(lab.out / "fig5.csv")]).all()
    index = (lab.out / "results.md").read_text()
    assert "`idrgbdo experiment fig5 --quick --seeds 2 --data FOLDER`" in index and "## Fig. 5" in index
    assert set(NAMES) > {"fig5"}


def test_ours_beside_what_is_published_for_the_recordings(
    tmp_path: Path, lab: Lab, capsys: pytest.CaptureFixture[str]
) -> None:
    data, out = tmp_path / "data", tmp_path / "out"
    shutil.copytree(lab.clips[0].folder, data / "rgbd_dataset_freiburg1_desk2")
    assert main(["experiment", "table1", "--tum", str(data), "--out", str(out), "--jobs", "2"]) == 0
    rows = {row["sequence, RPE mm/s"]: row for row in rows_of(out / "table1_published.csv")}
    assert float(rows["fr1_desk2"]["ours-24"]) > 0 and rows["fr1_desk"]["ours-24"] == ""
    assert [float(rows["fr1_desk2"][f"{name} (published)"]) for name in ("DVO odometry", "ORB-SLAM3")] == [55.0, 35.9]
    assert float(rows["fr1_desk"]["ID-RGBDO (published)"]) == 29.0
    assert "dense" not in rows["fr1_desk"] and len(rows) == 21
    assert "DVO odometry: Kerl, Sturm, Cremers" in capsys.readouterr().out
    assert r"\toprule" in (out / "table1.tex").read_text()
    assert main(["experiment", "fig3", "--tum", str(data)]) == 1
    assert "tum: is for table1" in capsys.readouterr().err


def test_faults_are_filmed_named_and_compared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faults, "FAULTS", {name: faults.FAULTS[name] for name in ("depth scale", "exposure jumps")})
    monkeypatch.setattr(faults, "others", lambda methods, quick: ["opencv-rgb"])
    films = planned_films("fr3_structure_texture_near", 36, True, tmp_path / "cache", None, shrink=4)
    clips = clips_of(films, TWO, lambda progress: None)
    small = Lab(clips, tmp_path / "out", TWO, films=films, quick=True)
    found = report(small, "faults")
    rows = {row["fault, RPE mm/s"]: row for row in rows_of(small.out / "faults_rpe.csv")}
    assert list(rows) == ["none", "depth scale", "exposure jumps"]
    scale = rows["depth scale"]
    assert scale["size"] == "2 %"
    assert float(scale["ours-24 named"]) == pytest.approx(float(rows["none"]["ours-24"]), rel=0.25)
    assert scale["opencv-rgb"] and not rows["exposure jumps"]["ours-24 named"]
    assert len(found) == 4 and "where camera.toml names it" in found[0] and "opencv-rgb" in found[0]
    with pytest.raises(IdRgbdoError, match="pass --rendered"):
        run_experiment("faults", replace(small, films=()))


def test_events_end_where_the_view_is_known(lab: Lab) -> None:
    done = run_experiment("events", lab)
    (events, each) = done.tables.values()
    assert len(done.findings) == 4 and len(events.rows) == 2 and len(each.rows) == 20
    found = [row for row in each.rows if row[2] is not None]
    assert len(found) >= 16 and sum(bool(row[-1]) for row in found) >= 14
    assert [row[4] for row in events.rows] == [0, 0]  # wrong recoveries
    shown, returns = events_of.play(36)
    assert len(returns) == 10 and {s.event for s in shown} == {"", *events_of.FRAMES} - {"jump"}


def test_a_segment_that_begins_anew_is_measured_from_its_begin() -> None:
    def pose(x: float) -> torch.Tensor:
        T = torch.eye(4, dtype=torch.float64)
        T[0, 3] = x
        return T

    said = [(0.0, 0), (0.1, 0), (5.0, 1), (5.1, 1), (0.4, 0), (5.35, 1)]  # m, segment
    results = [TrackResult(T_world_cam=pose(x), status=Status.OK, segment=segment) for x, segment in said]
    errors = events_of.within_segments(results, [pose(0.1 * n).numpy() for n in range(len(said))])
    assert [round(metres, 6) for metres, _ in errors] == [0.0, 0.0, 0.0, 0.0, 0.0, 0.05]
