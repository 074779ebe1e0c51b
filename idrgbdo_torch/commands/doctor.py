"""Is this installation in order? Versions, machine, optional parts, caches, and a short run on a rendered sequence."""

from __future__ import annotations

import importlib
import os
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Annotated

from tyro.conf import arg

from .. import __version__
from ..errors import IdRgbdoError
from ..synthetic.config import SynthConfig
from .output import Output, answer

NEEDED = {  # distribution: module
    "torch": "torch", "numpy": "numpy", "opencv-python-headless": "cv2", "numba": "numba", "scipy": "scipy",
    "tyro": "tyro", "rich": "rich", "plotly": "plotly", "joblib": "joblib",
}  # fmt: skip
EXTRAS = {"viewer": {"rerun-sdk": "rerun"}, "ros": {"rosbags": "rosbags"}, "cluster": {"distributed": "distributed"}}
FILM = SynthConfig(kind="desk", frames=20, width=160, height=120, fx=131.0, fy=131.0, cx=79.5, cy=59.5)
ATE_LIMIT_M = 0.005  # the self-test's path is 0.3 m long and usually tracked to 1 mm


@dataclass(frozen=True)
class DoctorCommand:
    """Show versions, machine, optional parts and caches, and test in seconds whether tracking works here."""

    self_test: bool = True  # render a tiny sequence and track it
    output: Annotated[Output, arg(name="")] = field(default_factory=Output)


def doctor(command: DoctorCommand) -> int:
    """Show each group as soon as it is known; the exit status is 1 where something is not in order."""
    groups = [versions, extras, decoders, machine, caches]
    items: list[Item] = []
    for group in groups:
        found = group()
        _show(found)
        items += found
    if command.self_test:
        items.append(self_test())
        _show(items[-1:])
    bad = [item for item in items if not item.good]
    print(f"not in order: {', '.join(item.name for item in bad)}" if bad else "all in order")
    answer(items=[asdict(item) for item in items])
    return 1 if bad else 0


@dataclass(frozen=True)
class Item:
    """One line of the"""

    name: str
    value: str
    good: bool = True
    advice: str = ""  # what to do where it is not good


def versions() -> list[Item]:
    """This package, Python, and every package that is needed; each is imported."""
    from ..tracker.open3d_loader import load_open3d

    python = f"{sys.version.split()[0]}, {sys.executable}"
    items = [
        Item("idrgbdo_torch", __version__),
        Item("python", python, sys.version_info >= (3, 11), "use 3.11 or newer"),
    ]
    items += [_package(distribution, module) for distribution, module in NEEDED.items()]
    try:
        version = str(load_open3d().__version__)
        return [*items, Item("open3d", version)]
    except IdRgbdoError as error:
        return [*items, Item("open3d", "cannot be imported", False, str(error))]


def extras() -> list[Item]:
    """The optional parts: what is there, and how to get what is not. One that is missing is no fault."""
    items = []
    for extra, packages in EXTRAS.items():
        found = [_package(distribution, module) for distribution, module in packages.items()]
        if all(item.good for item in found):
            value = ", ".join(f"{item.name} {item.value}" for item in found)
        else:
            value = f'not installed; pip install "idrgbdo_torch[{extra}]"'
        items.append(Item(f"extra {extra}", value))
    return items


def decoders() -> list[Item]:
    """What reads the two common kinds of image file. One that is missing is no fault: OpenCV reads them, slower."""
    return [
        Item("decoding PNG", _decoder("deflate", "deflate", "libdeflate")),
        Item("decoding JPEG", _decoder("simplejpeg", "simplejpeg", "libjpeg-turbo")),
    ]


def machine() -> list[Item]:
    """System, processor, and what torch makes of it."""
    import platform

    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    import torch

    threads = f"{torch.get_num_threads()} of torch on {usable} usable cores; tracking itself uses one"
    return [
        Item("system", platform.platform()),
        Item("processor", _processor()),
        Item("threads", threads),
    ]


def caches() -> list[Item]:
    """Where rendered demos and compiled kernels are kept, and whether they can be."""
    demos = demo_cache()
    kernels = Path(os.environ.get("NUMBA_CACHE_DIR") or Path(__file__).resolve().parent.parent / "kernels")
    kept = "else kernels are compiled anew in every process: set NUMBA_CACHE_DIR to a folder that can be written"
    return [
        Item("rendered demos", _size(demos), _writable(demos), f"make '{demos}' writable or set XDG_CACHE_HOME"),
        Item("compiled kernels", str(kernels), _writable(kernels), kept),
    ]


def demo_cache() -> Path:
    """The folder of rendered demos."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "idrgbdo"


def self_test() -> Item:
    """Render a tiny sequence, track it, and compare with the truth; seconds."""
    begin = perf_counter()
    from .. import odometry
    from ..evaluation import evaluate
    from ..synthetic import RenderedSequence
    from ..tracker.id_rgbdo import IdRgbdo

    film = RenderedSequence(FILM)
    frames = list(film)
    rendered = perf_counter()
    run = odometry.run(IdRgbdo(), frames)
    tracked = perf_counter()
    ate_m = evaluate(run.trajectory(), film.groundtruth).ate.rmse_m
    lost = run.statuses.count(odometry.Status.LOST)
    value = (
        f"{len(frames) - lost} of {len(frames)} frames tracked, ATE {1000 * ate_m:.1f} mm, "
        f"{tracked - rendered:.1f} s (rendering {rendered - begin:.1f} s)"
    )
    good = lost == 0 and ate_m <= ATE_LIMIT_M
    return Item(
        "self-test", value, good, f"expected no lost frame and at most {1000 * ATE_LIMIT_M:.0f} mm: please report"
    )


def _package(distribution: str, module: str) -> Item:
    """Its version, if it can be imported."""
    from importlib import metadata  # late: it takes a tenth of what --help does

    try:
        version = metadata.version(distribution)
        importlib.import_module(module)
    except (metadata.PackageNotFoundError, ImportError, OSError) as error:
        return Item(distribution, f"cannot be imported: {error}", False, f"pip install {distribution}")
    return Item(distribution, version)


def _decoder(distribution: str, module: str, library: str) -> str:
    item = _package(distribution, module)
    if item.good:
        return f"{library}, by {distribution} {item.value}; OpenCV for unusual files"
    return f"OpenCV; faster with {library}: {item.advice}"


def _processor() -> str:
    """The processor's name, where the system tells it."""
    import platform

    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8", errors="replace").splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _writable(folder: Path) -> bool:
    """Whether files can be made in a folder, or it itself in its nearest ancestor."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return os.access(folder, os.W_OK)


def _size(folder: Path) -> str:
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) if folder.exists() else 0
    return f"{folder}, {size / 1e6:.0f} MB"


def _show(items: list[Item]) -> None:
    for item in items:
        sys.stdout.write(f"  {'ok ' if item.good else 'BAD'}  {item.name:<23} {item.value}\n")
        if not item.good:
            sys.stdout.write(f"       {'':<23} {item.advice}\n")
    sys.stdout.flush()
