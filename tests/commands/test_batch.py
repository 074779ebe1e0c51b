"""Many recordings in one call: a folder each, one table and page, failures with reasons, nothing lost with a worker."""

from __future__ import annotations

import csv
import json
import shutil
import signal
from dataclasses import asdict, replace
from pathlib import Path

import pytest
import torch
from dask_cluster import dask_cluster

from idrgbdo_torch.commands.batch import Episode, distinct_names, expanded, track_episode
from idrgbdo_torch.commands.cli import main
from idrgbdo_torch.commands.input import Input, open_input
from idrgbdo_torch.commands.track import Job
from idrgbdo_torch.config import Config
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.experiments.sweep import Progress, Workers, sweep
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.odometry import TrackResult, run
from idrgbdo_torch.report import Glimpse
from idrgbdo_torch.runs import checkpoint
from idrgbdo_torch.runs.checkpoint import Checkpoints, State
from idrgbdo_torch.runs.source import Reading
from idrgbdo_torch.synthetic import SynthConfig, synth
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo
from idrgbdo_torch.trajectory import read_tum

FILM = SynthConfig(kind="desk", frames=16, width=160, height=120, fx=131.0, fy=131.0, cx=79.5, cy=59.5, samples=1)


@pytest.fixture(scope="module")
def episodes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of six rendered recordings and of something else."""
    folder = tmp_path_factory.mktemp("episodes")
    for number in range(6):
        synth(replace(FILM, seed=number), folder / f"ep{number}")
    (folder / "notes").mkdir()
    return folder


def poses(folder: Path) -> torch.Tensor:
    return read_tum(folder / "trajectory.txt").T_world_cam


def test_a_pattern_stands_for_what_it_matches_and_every_recording_counts_once(episodes: Path) -> None:
    found = expanded(
        [episodes / "ep3", Path(f"{episodes}/ep[0-3]"), episodes / "." / "notes" / ".." / "ep1", Path("nowhere")]
    )
    assert found == [episodes / "ep3", *(episodes / f"ep{n}" for n in range(3)), Path("nowhere")]
    with pytest.raises(IdRgbdoError, match="nothing matches"):
        expanded([Path(f"{episodes}/none*")])


def test_recordings_of_one_name_are_told_apart_by_the_folders_above() -> None:
    paths = [Path("/d/a/1/rgbd"), Path("/d/b/1/rgbd"), Path("/d/b/2/rgbd"), Path("/d/desk.bag")]
    assert distinct_names(paths) == ["a_1_rgbd", "b_1_rgbd", "2_rgbd", "desk.bag"]


def test_several_recordings_make_a_folder_each_one_table_one_page_and_say_what_failed(
    episodes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    command = ["run", f"{episodes}/ep[01]", str(episodes / "notes"), "--out", str(out), "--jobs", "2", "--map", "none"]
    assert main([*command, "--json"]) == 1
    answer = json.loads(capsys.readouterr().out)
    assert (answer["status"], answer["failed"], answer["page"]) == (1, 1, str(out / "index.html"))
    assert [row["recording"] for row in answer["recordings"]] == ["ep0", "ep1", "notes"]
    assert answer["recordings"][0]["evaluation"]["ate_rmse_m"] < 0.01
    assert answer["recordings"][2]["error"].startswith("sequence: ") and "notes" in answer["recordings"][2]["error"]
    for name in ("ep0", "ep1"):
        assert len(poses(out / name)) == FILM.frames and (out / name / "report.html").exists()
    rows = list(csv.DictReader((out / "batch.csv").open()))
    assert [row["frames"] for row in rows] == ["16", "16", ""] and rows[2]["note"]
    page = (out / "index.html").read_text()
    assert 'href="ep0/report.html"' in page and 'href="notes' not in page and len(page) < 100_000
    before = {name: (out / name / "summary.json").stat().st_mtime_ns for name in ("ep0", "ep1")}
    assert main(command) == 1  # goes on: only what failed is tried again
    shown = capsys.readouterr().out
    assert {name: (out / name / "summary.json").stat().st_mtime_ns for name in before} == before
    assert "2 of 3" in shown and "notes" in shown
    shutil.rmtree(out / "ep0")
    assert main(command) == 1  # and what is gone
    assert len(poses(out / "ep0")) == FILM.frames
    assert (out / "ep1" / "summary.json").stat().st_mtime_ns == before["ep1"]


def test_what_is_for_one_recording_is_refused_for_several(episodes: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", f"{episodes}/ep*", "--odom-bag", "all.mcap"]) == 1
    assert "odom_bag: is for one recording" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["index.html", "batch.csv", "results.jsonl"])
def test_files_that_no_batch_wrote_are_never_replaced(
    episodes: Path, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).write_text("mine\n")
    assert main(["run", str(episodes / "*"), "--out", str(tmp_path)]) == 1
    assert f"'{name}' that no batch wrote" in capsys.readouterr().err
    assert [path.read_text() for path in tmp_path.iterdir()] == ["mine\n"]


def test_a_process_that_was_killed_is_followed_by_one_that_goes_on(episodes: Path, tmp_path: Path) -> None:
    path, whole, folder = episodes / "ep0", tmp_path / "whole", tmp_path / "killed"
    track_episode(Episode(path, whole, Input(), Config(), "none"))
    folder.mkdir()
    sequence, odometry = open_input(path, Input()), IdRgbdo()
    job = Job(sequence, "killed", Config(), "none", Reading(path, asdict(Input())))
    records = run(odometry, [sequence.read(index) for index in range(9)]).records
    Checkpoints(folder, job.identity(), [Glimpse]).write(State(odometry, list(records), []))
    result = track_episode(Episode(path, folder, Input(), Config(), "none"))
    assert (result["resumed_after"], result["frames"]) == (9, FILM.frames)
    torch.testing.assert_close(poses(folder), poses(whole), rtol=0, atol=1e-9)
    assert not (folder / checkpoint.NAME).exists()


def test_a_process_that_is_killed_halfway_goes_on(
    episodes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = track_episode(Episode(episodes / "ep0", tmp_path / "whole", Input(), Config(), "none"))
    monkeypatch.setattr(checkpoint, "LEAST_S", 0.0)
    monkeypatch.setattr(checkpoint, "SHARE", 0.0)
    track, left = IdRgbdo.track, iter(range(9))

    def dies(self: IdRgbdo, frame: RgbdFrame) -> TrackResult:
        if next(left, None) is None:
            raise KeyboardInterrupt
        return track(self, frame)

    episode = Episode(episodes / "ep0", tmp_path / "killed", Input(), Config(), "none")
    with monkeypatch.context() as killed:
        killed.setattr(IdRgbdo, "track", dies)
        with pytest.raises(KeyboardInterrupt):
            track_episode(episode)
    again = track_episode(episode)
    assert 0 < again["resumed_after"] <= 9 and again["frames"] == whole["frames"] == FILM.frames
    torch.testing.assert_close(poses(episode.folder), poses(tmp_path / "whole"), rtol=0, atol=1e-9)


def test_figures_are_drawn_for_several_recordings_too(episodes: Path, tmp_path: Path) -> None:
    track_episode(Episode(episodes / "ep0", tmp_path / "drawn", Input(), Config(), "none", figures=True))
    assert list((tmp_path / "drawn" / "figures").glob("*.png"))


def test_a_dask_worker_that_is_killed_loses_nothing(episodes: Path, tmp_path: Path) -> None:
    tasks = {
        f"ep{n}": Episode(episodes / f"ep{n}", tmp_path / "out" / f"ep{n}", Input(), Config(), "none") for n in range(6)
    }
    (tmp_path / "dask").mkdir()
    with dask_cluster(tmp_path / "dask") as cluster:

        def kill_at_first(progress: Progress) -> None:
            if progress.done == 1:
                cluster.workers[0].send_signal(signal.SIGKILL)

        results = sweep(track_episode, tasks, tmp_path / "r.jsonl", Workers(cluster=cluster.address), kill_at_first)
        assert cluster.workers[0].wait(10) == -signal.SIGKILL
    assert {name: result.get("error") for name, result in results.items()} == dict.fromkeys(tasks)
    alone = tmp_path / "alone"
    track_episode(Episode(episodes / "ep5", alone, Input(), Config(), "none"))
    torch.testing.assert_close(poses(tmp_path / "out" / "ep5"), poses(alone), rtol=0, atol=1e-9)
    for name in tasks:
        assert len(poses(tmp_path / "out" / name)) == FILM.frames
