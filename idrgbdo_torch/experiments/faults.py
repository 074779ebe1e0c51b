"""What a real camera's faults cost: error against the size of each, for ours and for every other method."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any

from ..config import Config
from ..errors import IdRgbdoError
from ..synthetic import FaultConfig
from ..synthetic.sequence import write_camera
from .drawing import SERIES, new_figure
from .lab import Cell, Lab, Report, Table
from .rendering import RenderTask, render_missing, with_faults
from .table1 import FEW, MANY, others, with_points
from .task import Clip, Measured, Task, content_digest

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FILMS, QUICK_FILMS = 3, 1  # of the lab's
LIBRARIES = ("open3d", "opencv")
NAMED = " named"  # behind a method that reads a camera.toml which names the fault
METRICS = {"RPE mm/s": "rpe_m_per_s", "ATE mm": "ate_m"}


@dataclass(frozen=True)
class Fault:
    """A field of FaultConfig, the sizes to film, and how they are shown."""

    field: str
    sizes: tuple[float, ...]
    unit: str
    shown: float = 1.0  # times a size
    nameable: bool = True  # in camera.toml


FAULTS = {
    "rolling shutter": Fault("readout_ms", (10.0, 30.0), "ms readout"),
    "late depth": Fault("depth_delay_ms", (10.0, 20.0), "ms"),
    "focal length": Fault("focal", (0.005, 0.01), "%", 100.0),
    "principal point": Fault("center_px", (2.0, 5.0), "px"),
    "depth scale": Fault("depth_scale", (0.01, 0.02), "%", 100.0),
    "depth scale with distance": Fault("depth_growth", (0.005, 0.01), "% a m", 100.0),
    "misregistration": Fault("misregistration_px", (1, 3), "px"),
    "exposure jumps": Fault("exposure_jump", (0.15, 0.3), "%", 100.0, nameable=False),
    "stereo sensor": Fault("stereo", (0.5, 1.0), "of a D435's", nameable=False),
    "time-of-flight sensor": Fault("tof", (0.5, 1.0), "of an Azure Kinect's", nameable=False),
}
Case = tuple[str, float]  # fault and size; ("", 0.0) without any
CLEAN: Case = ("", 0.0)
Errors = Mapping[tuple[str, Case], Mapping[str, float]]  # by method and case: metric, mean over the films


def run(lab: Lab) -> Report:
    """Film with each fault, run all methods, ours also with the fault named in camera.toml. Raises IdRgbdoError for
    recordings, whose faults nobody can set.
    """
    if not lab.films:
        raise IdRgbdoError("faults: expected rendered films, got recordings; pass --rendered instead of --data")
    errors = survey(lab)
    methods = list(dict.fromkeys(method for method, _ in errors))
    cases = list(dict.fromkeys(case for _, case in errors))
    tables = {
        f"faults_{title.split()[0].lower()}": Table(
            (f"fault, {title}", "size", *methods),
            tuple(
                (case[0] or "none", _size(case), *(errors.get((m, case), {}).get(title) for m in methods))
                for case in cases
            ),
        )
        for title in METRICS
    }
    return Report(
        f"Faults of a real camera, {lab.source}", tables, tuple(findings(errors)), lambda: draw(errors, methods)
    )


def survey(lab: Lab) -> Errors:
    """Every method on every film with every fault."""
    from ..comparison.shipped import shipped_methods

    films = lab.films[: QUICK_FILMS if lab.quick else FILMS]
    plan = {
        (film.relative.name, (name, size)): with_faults(film, _only(fault.field, size))
        for film in films
        for name, fault in FAULTS.items()
        for size in fault.sizes[-1 if lab.quick else 0 :]
    }
    with lab.progress("rendering") as on_progress:
        render_missing(list(plan.values()), lab.workers, on_progress)
    ours = {f"ours-{count}": with_points(Config(), count) for count in (FEW, MANY)}
    tasks: list[tuple[str, Case, Task]] = []
    for case, clip, named in _clips(lab.clips[: len(films)], plan):
        if named:
            tasks += [(method + NAMED, case, Task(clip, "ours", config)) for method, config in ours.items()]
            continue
        tasks += [(method, case, Task(clip, "ours", config)) for method, config in ours.items()]
        tasks += [(method, case, Task(clip, method)) for method in others(shipped_methods(), lab.quick)]
    clips = tuple(dict.fromkeys(task.clip for _, _, task in tasks))
    measured = replace(lab, clips=clips).measure([task for _, _, task in tasks])
    results: dict[tuple[str, Case], list[Measured]] = {}
    for (method, case, _), one in zip(tasks, measured, strict=True):
        results.setdefault((method, case), []).append(one)
    return {key: _means(several) for key, several in results.items()}


def _clips(clean: Sequence[Clip], plan: Mapping[tuple[str, Case], RenderTask]) -> Iterator[tuple[Case, Clip, bool]]:
    """Case, clip, and whether its camera.toml names the fault."""
    for clip in clean:
        yield CLEAN, clip, False
    lengths = {clip.name: clip.length for clip in clean}
    for (film, (name, size)), task in plan.items():
        folders = [task.folder, *([named_copy(task)] if FAULTS[name].nameable else [])]
        for folder in folders:
            told = folder is not task.folder
            title = f"{film}, {name} {size:g}{NAMED if told else ''}"
            yield (name, size), Clip(title, folder, content_digest(folder), lengths[film]), told


def _only(field: str, size: float) -> FaultConfig:
    settings: dict[str, Any] = {field: size}
    return FaultConfig(**settings)


def named_copy(film: RenderTask) -> Path:
    """A folder in the film's with the same images, whose camera.toml names the fault."""
    folder = film.folder / "named"
    if not (folder / "rgb.txt").exists():
        folder.mkdir(exist_ok=True)
        write_camera(replace(film.config, faults=replace(film.config.faults, named=True)), folder)
        (folder / "groundtruth.txt").write_bytes((film.folder / "groundtruth.txt").read_bytes())
        for kind in ("depth", "rgb"):
            lines = (film.folder / f"{kind}.txt").read_text().replace(f" {kind}/", f" ../{kind}/")
            (folder / f"{kind}.txt").write_text(lines)
    return folder


def _means(several: Sequence[Measured]) -> dict[str, float]:
    """Mean of each metric in mm; a metric that a film lacks is left out."""
    out = {}
    for title, field in METRICS.items():
        values = [getattr(one, field) for one in several]
        if all(value is not None for value in values):
            out[title] = 1000.0 * fmean(values)
    return out


def _size(case: Case) -> Cell:
    if case == CLEAN:
        return ""
    fault = FAULTS[case[0]]
    return f"{case[1] * fault.shown:g} {fault.unit}"


def findings(errors: Errors) -> Iterator[str]:
    """What the largest size of each fault costs 24 points."""
    few = f"ours-{FEW}"
    for name, fault in FAULTS.items():
        case = (name, fault.sizes[-1])
        for metric in METRICS:
            clean = errors[few, CLEAN].get(metric)
            blind = errors[few, case].get(metric)
            if not clean or blind is None:
                continue
            told = errors.get((few + NAMED, case), {}).get(metric)
            known = f", {told / clean:.1f} where camera.toml names it" if told is not None else ""
            costs = {
                method: more - errors[method, CLEAN][metric]
                for (method, other), found in errors.items()
                if other == case and method.startswith(LIBRARIES)
                if (more := found.get(metric)) is not None and metric in errors[method, CLEAN]
            }
            best = min(costs.items(), key=lambda item: item[1], default=None)
            rival = f"; it adds {blind - clean:.2f}, to {best[0]} {best[1]:.2f}" if best else ""
            yield f"{name}, {_size(case)}: {blind / clean:.1f} times the {metric} of {FEW} points{known}{rival}"


def draw(errors: Errors, methods: Sequence[str]) -> Figure:
    """One plot a fault: RPE against size."""
    metric = next(iter(METRICS))
    figure = new_figure(5, 2, 3.4, 3.0)
    for axes, (name, fault) in zip(figure.axes, FAULTS.items(), strict=False):
        for method in methods:
            ours = method.startswith("ours")
            base = method.removesuffix(NAMED)
            points = [(0.0, errors[base, CLEAN].get(metric))]
            points += [
                (size * fault.shown, errors[method, (name, size)].get(metric))
                for size in fault.sizes
                if (method, (name, size)) in errors
            ]
            if len(points) > 1:
                color = SERIES[0 if str(FEW) in base else 1] if ours else "#b8bfc7"
                style = "--" if method.endswith(NAMED) else "-"
                axes.plot(*zip(*points, strict=True), style, color=color, marker="o", markersize=3, label=method,
                          zorder=3 if ours else 1, linewidth=1.6 if ours else 0.8)  # fmt: skip
        axes.set(title=name, xlabel=fault.unit, yscale="log")
    figure.axes[0].set_ylabel(metric)
    figure.axes[0].legend(frameon=False, fontsize=5)
    return figure
