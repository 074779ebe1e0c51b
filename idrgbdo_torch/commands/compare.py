"""What `idrgbdo compare` asks for and does."""

from __future__ import annotations

import difflib
import importlib
import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, UseAppendAction, arg

from ..errors import IdRgbdoError
from ..text.configfile import Count, Index, Positive
from .output import Output, answer

if TYPE_CHECKING:
    from ..comparison import Comparison, Progress
    from ..comparison.methods import Method


WRITTEN = (".md", ".csv", ".json", ".tex", ".svg", ".pdf")
_imported: dict[Path, str] = {}  # SHA-256 of the files of --add that this process has imported


@dataclass(frozen=True)
class CompareCommand:
    """Run methods over recordings and lay accuracy, losses, speed and memory side by side. A second call goes on."""

    sequences: Positional[tuple[Path, ...]]  # as for `idrgbdo run`
    methods: str = "all"  # names with commas between; `list` shows them
    add: Path | None = None  # Python file whose METHODS come as well
    external: UseAppendAction[tuple[str, ...]] = ()  # NAME[@SEQUENCE]=FILE: a trajectory of another program, TUM text
    out: Path = Path("comparison")  # folder for tables, page and runs
    seeds: Count = 1  # runs of each method that is random
    overwrite: bool = False  # do again what is done
    camera: Path | None = None  # of all recordings, as for `idrgbdo run`; else their own
    depth_scale: Positive | None = None  # depth values per metre; else the camera file's or the format's
    format: str | None = None  # as for `idrgbdo run`; else it is recognised
    start: Index = 0  # frames left out at the beginning
    every: Count = 1  # take every n-th frame
    max_frames: Count | None = None  # stop after so many
    output: Annotated[Output, arg(name="")] = field(default_factory=Output)


def compare(command: CompareCommand) -> int:
    """Run what is missing, write the tables, show the first of them."""
    from ..comparison import Source, parse_external
    from ..comparison import compare as compare_methods
    from ..comparison.table import to_csv, to_json, to_latex, to_markdown
    from ..experiments.comparison_figures import draw_figures
    from ..report import comparison_page
    from ..report.terminal import show_table
    from ..runs.writing import write_whole

    known = known_methods(command.add)
    if command.methods == "list":
        show_table("methods", [(name, method.description) for name, method in known.items()])
        return 0
    if not command.sequences:
        raise IdRgbdoError("sequences: expected the folder of a recording, got none; name at least one")
    chosen = choose(known, command.methods)
    frames = (command.start, command.every, command.max_frames)
    reading = (command.format, command.camera, command.depth_scale)
    sources = [Source(folder, *frames, *reading) for folder in command.sequences]
    _refuse_others(command.out)
    with _progress_bar() as on_progress:
        comparison = compare_methods(
            chosen,
            sources,
            command.out,
            seeds=command.seeds,
            externals=[parse_external(text) for text in command.external],
            overwrite=command.overwrite,
            on_progress=on_progress,
        )
    writers = (
        ("comparison.md", to_markdown),
        ("comparison.csv", to_csv),
        ("comparison.json", to_json),
        ("comparison.tex", to_latex),
        ("report.html", comparison_page),
    )
    for name, write in writers:
        write_whole(command.out / name, write(comparison), make_folder=True)
    figures = draw_figures(comparison, command.out)
    _show(comparison)
    without = [] if figures else [("figures", 'none: pip install "idrgbdo_torch[experiments]"')]
    show_table("results", [("in", str(command.out)), *without])
    answer(folder=command.out, figures=figures, **json.loads(to_json(comparison)))
    return 0


def _refuse_others(out: Path) -> None:
    """Raises IdRgbdoError where a folder has files of the names of a comparison that no comparison wrote."""
    from ..comparison.outcome import RESULTS, read_outcomes
    from ..runs.own import refuse_any

    found = [*out.glob(RESULTS), *out.glob("report.html")]
    found += [path for path in out.glob("comparison.*") if path.suffix in WRITTEN]
    if not read_outcomes(out):
        refuse_any(out, found, "comparison")


def known_methods(add: Path | None) -> dict[str, Method]:
    """The baselines, ours, and those of a Python file. Raises IdRgbdoError for a file without METHODS."""
    from ..comparison.shipped import shipped_methods

    methods = shipped_methods()
    if add is None:
        return methods
    if not add.is_file():
        raise IdRgbdoError(f"add: expected a Python file with a dictionary METHODS, found none at '{add}'")
    folder = str(add.resolve().parent)
    if folder not in sys.path:
        sys.path.insert(0, folder)  # so that the process in which a method runs can import it too
    try:
        from hashlib import sha256

        digest = sha256(add.read_bytes()).hexdigest()
        if _is_at(add) and _imported.get(add.resolve(), digest) != digest:
            del sys.modules[add.stem]  # edited since
        module = importlib.import_module(add.stem)
    except (OSError, SyntaxError, ImportError, AttributeError, LookupError, TypeError, ValueError, NameError) as error:
        raise IdRgbdoError(f"add: '{add}' cannot be imported ({type(error).__name__}: {error}); correct it") from error
    _imported[add.resolve()] = digest
    extra = getattr(module, "METHODS", None)
    if not isinstance(extra, dict) or not _is_at(add):
        raise IdRgbdoError(f"add: expected a dictionary METHODS in '{add}', found none; see the README")
    mark = f"# {add.name}, SHA-256 {digest}\n"
    return {
        **methods,
        **{name: replace(method, settings=partial(_marked, method.settings, mark)) for name, method in extra.items()},
    }


def _marked(settings: Callable[[], str], mark: str) -> str:
    """A method's settings and what its file was: the results of an edited file are other results."""
    return mark + settings()


def _is_at(path: Path) -> bool:
    """Whether the module of that file's name came from that file."""
    return Path(getattr(sys.modules.get(path.stem), "__file__", None) or "").resolve() == path.resolve()


def choose(known: dict[str, Method], names: str) -> dict[str, Method]:
    """The named methods, or all. Raises IdRgbdoError for an unknown name."""
    if names == "all":
        return known
    chosen = {}
    for name in filter(None, (part.strip() for part in names.split(","))):
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"did you mean '{near[0]}'?" if near else f"the methods are {', '.join(known)}"
            raise IdRgbdoError(f"methods: no method '{name}'; {hint}")
        chosen[name] = known[name]
    return chosen


def _show(comparison: Comparison) -> None:
    """The tables on a terminal; elsewhere as Markdown, which is as wide as it needs to be."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from ..comparison.table import LEGEND, provenance, tables, to_markdown
    from ..text.plain import plain

    if not sys.stdout.isatty():
        sys.stdout.write("".join(plain(line) + "\n" for line in to_markdown(comparison).splitlines()))
        return
    console = Console()
    for table in tables(comparison):
        grid = Table(title=escape(plain(table.title)), title_justify="left")
        for number, title in enumerate(table.columns):
            grid.add_column(escape(plain(title)), justify="left" if number == 0 else "right", overflow="fold")
        for row in table.rows:
            grid.add_row(*(escape(plain(cell)) for cell in row))
        console.print(grid)
    console.print(LEGEND, provenance(comparison), sep="\n", markup=False, highlight=False)


@contextmanager
def _progress_bar() -> Iterator[Callable[[Progress], None]]:
    """A bar over the frames of the run at hand, with the run's number; on a terminal only."""
    if not sys.stdout.isatty():
        yield lambda progress: None
        return
    from rich.markup import escape
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    from ..text.plain import plain

    with Bar(TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()) as bar:
        task = bar.add_task("")

        def show(progress: Progress) -> None:
            title = plain(f"{progress.job}/{progress.jobs} {progress.sequence}: {progress.method}")
            if progress.frame == 0:
                bar.reset(task)
            bar.update(task, description=escape(title), completed=progress.frame, total=progress.frames)

        yield show
