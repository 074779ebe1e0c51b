"""`idrgbdo run` of several recordings: a folder each, one table and page, by several processes or a Dask cluster."""

from __future__ import annotations

import glob
import hashlib
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import __version__
from ..config import Config
from ..errors import IdRgbdoError
from ..text import configfile
from ..text.plain import plain
from .input import Input, open_input
from .output import answer
from .tasks_bar import tasks_bar

if TYPE_CHECKING:
    from .run import RunCommand

OUT = Path("runs") / "batch"
RESULTS, TABLE, PAGE = "results.jsonl", "batch.csv", "index.html"
SHOWN = 40  # rows, and failures, that are shown at the end; the files have all


@dataclass(frozen=True)
class Episode:
    """One of many recordings, to be tracked by some process that sees the same files."""

    path: Path  # absolute, as is the folder
    folder: Path  # of its run
    input: Input
    config: Config
    map_kind: str
    figures: bool = False

    @property
    def key(self) -> str:
        """A digest of all that makes a second run superfluous."""
        changed = self.path.stat().st_mtime_ns if self.path.exists() else 0
        parts = (self.path, self.folder.name, changed, self.input, configfile.dump(self.config), self.map_kind)
        return hashlib.sha256(repr((*parts, self.figures, __version__)).encode()).hexdigest()[:20]


def expanded(paths: Sequence[Path]) -> list[Path]:
    """The recordings that are meant, each once: a pattern stands for what it matches, by name.

    Raises IdRgbdoError for a pattern that matches nothing.
    """
    found: list[Path] = []
    for path in paths:
        if path.exists() or not glob.has_magic(str(path)):
            found.append(path)
            continue
        matches = sorted(glob.glob(str(path), recursive=True))
        if not matches:
            raise IdRgbdoError(f"sequences: nothing matches '{path}'; check the pattern")
        found += map(Path, matches)
    once: dict[Path, Path] = {}
    for path in found:
        once.setdefault(path.resolve(), path)
    return list(once.values())


def run_many(command: RunCommand, paths: Sequence[Path]) -> int:
    """Track what is not done yet, and show how all went; the exit status is 1 where some could not be tracked."""
    from ..experiments.sweep import Workers, read_results, sweep
    from .experiment import cores

    extras = command.extras
    for name, given in (("viewer", command.viewer), ("save_rrd", extras.save_rrd), ("odom_bag", extras.odom_bag)):
        if given:
            raise IdRgbdoError(f"{name}: is for one recording; leave it out, and see idrgbdo export for each run")
    out = (command.out or OUT).absolute()
    names = distinct_names(paths)
    _refuse_others(out)
    episodes = [
        Episode(path.absolute(), out / name, absolute(command.input), command.settings, command.map, command.figures)
        for path, name in zip(paths, names, strict=True)
    ]
    keys = [episode.key for episode in episodes]
    print(f"{len(episodes)} recordings into {plain(out)}", flush=True)
    results: Mapping[str, Mapping[str, Any]] = {}
    workers = Workers(extras.jobs or cores(), extras.cluster)
    try:
        tasks = dict(zip(keys, episodes, strict=True))
        _forget_what_is_gone(tasks, out / RESULTS)
        with tasks_bar("tracking") as on_progress:
            results = sweep(track_episode, tasks, out / RESULTS, workers, on_progress)
    finally:  # after Ctrl-C too: what is done is shown, and the same command goes on
        results = results or read_results(out / RESULTS)
        found = [_row(name, results.get(key, {})) for name, key in zip(names, keys, strict=True)]
        _write(out, found)
    failed = [row for row in found if row.get("error")]
    _show(out, found, failed)
    answer(folder=out, page=out / PAGE, table=out / TABLE, failed=len(failed), recordings=found)
    return 1 if failed else 0


def track_episode(episode: Episode) -> dict[str, Any]:
    """Track a recording, from where a killed process left it; its summary. Runs in any process, in any thread."""
    from ..runs.checkpoint import State
    from ..runs.source import Reading
    from ..tracker.id_rgbdo import IdRgbdo
    from .observers import Observer, Pictures
    from .track import Job, do

    sequence = open_input(episode.path, episode.input)
    reading = Reading(episode.path, asdict(episode.input))
    job = Job(sequence, episode.folder.name, episode.config, episode.map_kind, reading)
    resumed = True
    try:
        state = job.go_on(episode.folder)
    except IdRgbdoError:  # nothing there, or of other settings
        resumed, state = False, State(IdRgbdo(episode.config), [], [])
    before = len(state.records)
    observers: list[Observer] = [Pictures()] if episode.figures else []
    tracked = do(job, episode.folder, state, observers, resumed, terminal=False)
    return {**tracked.summary, "resumed_after": before, "warnings": list(sequence.warnings)}


def distinct_names(paths: Sequence[Path]) -> list[str]:
    """A name for each recording: its own, with as many of the folders above it as tell it from the others."""
    parts = [path.resolve().parts for path in paths]
    names = [own[-1] for own in parts]
    for depth in range(2, max(map(len, parts)) + 1):
        again = {name for name, count in Counter(names).items() if count > 1}
        if not again:
            break
        names = ["_".join(own[-depth:]) if name in again else name for name, own in zip(names, parts, strict=True)]
    return [name.replace("/", "").replace("\\", "") for name in names]


def _forget_what_is_gone(tasks: Mapping[str, Episode], path: Path) -> None:
    """A result whose folder was removed since is none: it is done again."""
    from ..experiments.sweep import append_result, read_results

    for key, result in read_results(path).items():
        if key in tasks and not result.get("error") and not (tasks[key].folder / "summary.json").exists():
            append_result(path, {"key": key, "error": "its folder is gone"})


def _refuse_others(out: Path) -> None:
    """Raises IdRgbdoError where a folder has files of the names of a batch that no batch wrote."""
    from ..experiments.sweep import read_results
    from ..report.batch_page import to_csv
    from ..runs.own import refuse_any
    from ..text.files import read_text

    found = [path for name in (RESULTS, TABLE, PAGE) if (path := out / name).exists()]
    own_table = out / TABLE in found and read_text(out / TABLE, "out").startswith(to_csv([]))
    if not own_table and not read_results(out / RESULTS):
        refuse_any(out, found, "batch")


def absolute(options: Input) -> Input:
    """The same options for a process that runs elsewhere."""
    camera, associations = (path and path.absolute() for path in (options.camera, options.associations))
    return replace(options, camera=camera, associations=associations)


def _row(name: str, result: Mapping[str, Any]) -> dict[str, Any]:
    row = {"recording": name, **result}
    if "error" in row:
        row["error"] = str(row["error"]).removeprefix(f"{IdRgbdoError.__name__}: ")
    return row


def _write(out: Path, found: Sequence[Mapping[str, Any]]) -> None:
    from ..report.batch_page import batch_page, to_csv
    from ..runs.writing import write_whole

    write_whole(out / TABLE, to_csv(found), make_folder=True)
    write_whole(out / PAGE, batch_page(out.name, found))


def _show(out: Path, found: Sequence[Mapping[str, Any]], failed: Sequence[Mapping[str, Any]]) -> None:
    """The recordings where they are few, the failures with their reasons, and where everything is."""
    from ..report.batch_page import COLUMNS, cells
    from ..report.terminal import show_table

    if len(found) <= SHOWN:
        rows = [COLUMNS, *(cells(row) for row in found)]
        widths = [max(len(plain(row[c])) for row in rows) for c in range(len(COLUMNS) - 1)]
        for row in rows:
            columns = zip(row, widths, strict=False)
            sys.stdout.write("  ".join(f"{plain(cell):<{width}}" for cell, width in columns).rstrip() + "\n")
    shown = [(row["recording"], row["error"]) for row in failed[:SHOWN]]
    more = [("...", f"{len(failed) - SHOWN} more")] if len(failed) > SHOWN else []
    done = f"{len(found) - len(failed)} of {len(found)}"
    rows_below = [("tracked", done), *shown, *more, ("results in", str(out)), ("look at", str(out / PAGE))]
    show_table("failed" if failed else "all recordings", rows_below)
