"""Many independent tasks over the processes of this machine or of a Dask cluster; what is done is not done again."""

from __future__ import annotations

import json
import os
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from ..errors import IdRgbdoError
from ..text.files import read_text

T = TypeVar("T")
Result = dict[str, Any]

RETRIES = 1  # of a task that raises
KILLS = 3  # times that a process may die with a task in it or beside it
AHEAD = 2  # tasks a worker has waiting, so that it never waits itself
IDLE_S = 600  # that processes wait for the next sweep
ONE_THREAD = {
    f"{library}_NUM_THREADS": "1" for library in ("OMP", "MKL", "OPENBLAS", "NUMBA", "NUMEXPR", "VECLIB_MAXIMUM")
} | {"OPENCV_FOR_THREADS_NUM": "1"}  # times of tasks side by side stay fair


@dataclass(frozen=True)
class Workers:
    """Where tasks run."""

    jobs: int = 1  # processes on this machine
    cluster: str = ""  # address of a Dask scheduler instead, whose workers see the same files


@dataclass(frozen=True)
class Progress:
    """How far a sweep is."""

    done: int
    total: int
    failed: int
    remaining_s: float | None  # None until the first task is done


def sweep(
    function: Callable[[T], Result],
    tasks: Mapping[str, T],
    path: Path,
    workers: Workers,
    on_progress: Callable[[Progress], None] = lambda progress: None,
) -> dict[str, Result]:
    """The result of function(task) for every task, by its key; those in the file `path` (JSON lines) are taken from it.

    Results are appended to the file as they arrive, so that an interrupted sweep goes on where it stopped. A task that
    raises is tried once more; then its result is {"error": why}, and the next call tries it again. function must be
    importable by name, and tasks picklable.
    """
    known = read_results(path)
    done = {key: known[key] for key in tasks if key in known and not known[key].get("error")}
    missing = {key: task for key, task in tasks.items() if key not in done}

    def on_result(key: str, result: Result) -> None:
        append_result(path, {"key": key, **result})
        done[key] = result

    run_tasks(function, missing, workers, on_result, on_progress)
    return done


def run_tasks(
    function: Callable[[T], Result],
    tasks: Mapping[str, T],
    workers: Workers,
    on_result: Callable[[str, Result], None],
    on_progress: Callable[[Progress], None] = lambda progress: None,
) -> None:
    """Call function(task) for every task on the workers, and on_result(key, result) as each arrives, here.

    The tasks start in their order. Where a local process dies, what was running is run again at the end, each task
    alone, so that the one that kills takes no other with it.
    """
    left = deque(tasks)
    suspects: deque[str] = deque()  # were running when a process died
    tries = dict.fromkeys(tasks, 0)
    kills = dict.fromkeys(tasks, 0)
    begin, done, failed = time.monotonic(), 0, 0
    while left or suspects:
        with _executor(workers) as (executor, capacity):
            running: dict[Future[Result], str] = {}
            broken = False
            while running or ((left or suspects) and not broken):
                while not broken and ((left and len(running) < capacity) or (suspects and not running)):
                    queue = left or suspects
                    key = queue.popleft()
                    try:
                        running[executor.submit(function, tasks[key])] = key
                    except BrokenExecutor:
                        queue.appendleft(key)
                        broken = True
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    key = running.pop(future)
                    error = _error_of(future)
                    if isinstance(error, BrokenExecutor):
                        broken = True
                        kills[key] += 1
                        if kills[key] < KILLS:
                            suspects.append(key)
                            continue
                    elif error is not None and tries[key] < RETRIES:
                        tries[key] += 1
                        left.append(key)
                        continue
                    done, failed = done + 1, failed + (error is not None)
                    on_result(key, future.result() if error is None else {"error": _sentence(error)})
                    remaining = (time.monotonic() - begin) / done * (len(tasks) - done)
                    on_progress(Progress(done, len(tasks), failed, remaining))


def _error_of(future: Future[Result]) -> BaseException | None:
    try:
        return future.exception()
    except CancelledError as error:
        raise IdRgbdoError("cluster: the scheduler dropped the tasks; see that it runs and call again") from error


def _sentence(error: BaseException) -> str:
    return f"{type(error).__name__}: " + " ".join(str(error).split())[:300]


@contextmanager
def _executor(workers: Workers) -> Iterator[tuple[Executor, int]]:
    """Something with submit(), and how many tasks to give it at a time."""
    if workers.cluster:
        with _dask_client(workers.cluster) as client:
            cores = sum(client.ncores().values())
            if cores == 0:
                raise IdRgbdoError(
                    f"cluster: no worker at '{workers.cluster}'; start one: dask worker {workers.cluster}"
                )
            yield client.get_executor(pure=False), AHEAD * cores
        return
    from joblib.externals.loky import get_reusable_executor

    pool = get_reusable_executor(max_workers=workers.jobs, timeout=IDLE_S, env=ONE_THREAD)
    finished = False
    try:
        yield pool, AHEAD * workers.jobs
        finished = True
    finally:
        if not finished:
            pool.shutdown(wait=True, kill_workers=True)


def _dask_client(address: str) -> Any:
    """A connection to a Dask scheduler. Raises IdRgbdoError without Dask, and where nobody answers."""
    try:
        from distributed import Client
    except ImportError as error:
        raise IdRgbdoError('cluster: needs Dask; pip install "idrgbdo-torch[cluster]"') from error
    try:
        return Client(address, timeout=10, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise IdRgbdoError(f"cluster: no Dask scheduler answers at '{address}' ({error}); check --cluster") from error


def read_results(path: Path) -> dict[str, Result]:
    """The results in a file by key, the last of equal keys. A line that a killed process left half written is none."""
    results: dict[str, Result] = {}
    if path.exists():
        for line in read_text(path, "out", "pass another --out").splitlines():
            try:
                result = json.loads(line)
                results[result.pop("key")] = result
            except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
                continue
    return results


def append_result(path: Path, result: Result) -> None:
    """Add a line, on the disk when this returns. Raises IdRgbdoError where the file cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("ab+") as file:
            end = file.seek(0, os.SEEK_END)
            torn = end > 0 and _last_byte(file) != b"\n"
            file.write((b"\n" if torn else b"") + json.dumps(result).encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise IdRgbdoError(f"out: cannot write '{path}': {error.strerror}; pass another --out") from error


def _last_byte(file: Any) -> bytes:
    file.seek(-1, os.SEEK_END)
    return bytes(file.read(1))
