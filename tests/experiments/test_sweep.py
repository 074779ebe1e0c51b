"""The sweep over processes and over a Dask cluster: nothing lost, nothing twice."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from dask_cluster import Cluster, dask_cluster
from sweep_tasks import Job, calls_of, square

from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.experiments.sweep import Progress, Workers, append_result, read_results, sweep

TWO = Workers(jobs=2)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Where calls are counted."""
    (tmp_path / "log").mkdir()
    return tmp_path / "log"


def jobs(log: Path, count: int, **trouble: str) -> dict[str, Job]:
    """count jobs; trouble by the key, such as job3."""
    return {f"job{n}": Job(n, log, trouble.get(f"job{n}", "")) for n in range(count)}


def squares(results: dict[str, dict[str, object]]) -> dict[str, object]:
    return {key: result.get("square") for key, result in results.items()}


def test_every_task_runs_once_in_a_process_with_one_thread(tmp_path: Path, log: Path) -> None:
    seen: list[Progress] = []
    results = sweep(square, jobs(log, 7), tmp_path / "r.jsonl", TWO, seen.append)
    assert squares(results) == {f"job{n}": n**2 for n in range(7)}
    assert {result["threads"] for result in results.values()} == {"1"}
    assert calls_of(log) == dict.fromkeys(range(7), 1)
    assert [progress.done for progress in seen] == list(range(1, 8))
    assert seen[-1].total == 7 and seen[-1].remaining_s == 0.0 and seen[0].remaining_s is not None
    assert {key: r["square"] for key, r in read_results(tmp_path / "r.jsonl").items()} == squares(results)


def test_a_second_call_does_only_what_is_missing(tmp_path: Path, log: Path) -> None:
    path = tmp_path / "r.jsonl"
    append_result(path, {"key": "job1", "square": 1})
    with path.open("a") as file:
        file.write('{"key": "job2", "squ')  # a process was killed while it wrote
    assert squares(sweep(square, jobs(log, 3), path, TWO)) == {"job0": 0, "job1": 1, "job2": 4}
    assert calls_of(log) == {0: 1, 2: 1}
    assert sweep(square, jobs(log, 3), path, TWO) == sweep(square, jobs(log, 3), path, TWO)
    assert calls_of(log) == {0: 1, 2: 1}
    assert [len(line) > 0 for line in path.read_text().splitlines()] == [True] * 4


def test_a_task_that_raises_is_tried_once_more_and_then_reported(tmp_path: Path, log: Path) -> None:
    path, seen = tmp_path / "r.jsonl", list[Progress]()
    results = sweep(square, jobs(log, 4, job1="once", job2="always"), path, TWO, seen.append)
    assert squares(results) == {"job0": 0, "job1": 1, "job2": None, "job3": 9}
    assert results["job2"]["error"] == "RuntimeError: it never works"
    assert calls_of(log) == {0: 1, 1: 2, 2: 2, 3: 1}
    assert seen[-1].failed == 1
    again = sweep(square, jobs(log, 4), path, TWO)  # whatever was wrong is repaired
    assert squares(again) == {f"job{n}": n**2 for n in range(4)}
    assert calls_of(log) == {0: 1, 1: 2, 2: 3, 3: 1}


def test_a_process_that_dies_takes_no_other_task_with_it(tmp_path: Path, log: Path) -> None:
    results = sweep(square, jobs(log, 6, job1="kill once", job3="kill"), tmp_path / "r.jsonl", TWO)
    assert squares(results) == {"job0": 0, "job1": 1, "job2": 4, "job3": None, "job4": 16, "job5": 25}
    assert "error" in results["job3"]
    assert calls_of(log)[3] in (2, 3)  # it may have waited beside the one that died first


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """Two workers."""
    with dask_cluster(tmp_path_factory.mktemp("dask")) as running:
        yield running


def test_a_dask_cluster_gives_the_same_results(tmp_path: Path, log: Path, cluster: Cluster) -> None:
    tasks = jobs(log, 8, job1="once", job2="always")
    remote = sweep(square, tasks, tmp_path / "remote.jsonl", Workers(cluster=cluster.address))
    for path in log.iterdir():
        path.unlink()
    assert remote == sweep(square, tasks, tmp_path / "local.jsonl", TWO)


def test_killing_a_dask_worker_in_the_middle_loses_nothing(tmp_path: Path, log: Path, cluster: Cluster) -> None:
    tasks = {key: Job(job.number, log, "slow") for key, job in jobs(log, 10).items()}

    def kill_at_third(progress: Progress) -> None:
        if progress.done == 3:
            cluster.workers[0].send_signal(signal.SIGKILL)

    path = tmp_path / "r.jsonl"
    results = sweep(square, tasks, path, Workers(cluster=cluster.address), kill_at_third)
    assert cluster.workers[0].wait(10) == -signal.SIGKILL
    assert squares(results) == {f"job{n}": n**2 for n in range(10)}
    assert sorted(read_results(path)) == sorted(tasks)
    assert len(path.read_text().splitlines()) == 10


def test_a_cluster_that_is_not_there_is_said_in_one_line(tmp_path: Path, log: Path) -> None:
    with pytest.raises(IdRgbdoError, match="check --cluster"):
        sweep(square, jobs(log, 1), tmp_path / "r.jsonl", Workers(cluster="nonsense://here"))
