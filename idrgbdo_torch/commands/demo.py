"""`idrgbdo demo`: the main job on a sequence that is rendered on first use."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from .. import __version__
from ..config import Config
from ..synthetic.config import SynthConfig
from .input import Settings
from .output import Output

DEMO = SynthConfig(kind="desk", frames=90)


@dataclass(frozen=True)
class DemoCommand:
    """Render a short sequence on first use, track it, and show how well that went. Needs no file and no network."""

    out: Path | None = None  # folder for the results; else runs/demo/<time>
    config: Path | None = None  # TOML, or fast, accurate, paper; its values are the defaults of the flags
    viewer: bool = False  # watch it in Rerun, pip install "idrgbdo_torch[viewer]"
    save_rrd: Path | None = None  # the same into a file, for machines without a display
    output: Annotated[Output, arg(name="")] = field(default_factory=Output)
    settings: Settings = field(default_factory=Config)


def demo_folder() -> Path:
    """The demo's sequence, rendered unless it is in the cache."""
    from .synth import render

    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "idrgbdo"
    folder = cache / f"demo_{DEMO.kind}_{DEMO.frames}_{__version__}"
    if not (folder / "rgb.txt").exists():
        print(f"rendering {DEMO.frames} frames of a desk into {folder} (once)", flush=True)
        shutil.rmtree(folder, ignore_errors=True)  # what was not rendered to its end
        render(DEMO, folder)
    return folder


def demo(command: DemoCommand) -> int:
    """Track the demo's sequence, and say how to go on with one's own."""
    from ..datasets import open_sequence
    from ..report.viewer import open_viewer
    from ..runs.source import Reading
    from .observers import Viewing
    from .track import Job, track

    folder = demo_folder()
    with open_viewer("demo", command.viewer, command.save_rrd) as viewer:
        observers = [Viewing(viewer)] if viewer else []
        job = Job(open_sequence(folder), "demo", command.settings, reading=Reading(folder, {}))
        status = track(job, command.out, observers)
    if status == 0:
        print("now your own: idrgbdo run FOLDER_OF_COLOUR_AND_DEPTH_IMAGES (idrgbdo check looks at it first)")
    return status
